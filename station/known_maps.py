"""Files of known maps: those that `earshot slam` saves, and map_server's."""

from pathlib import Path

import numpy as np

from maps.grid import read_map
from protocol.config import BodyConfig, LidarConfig
from protocol.errors import EarshotError
from protocol.pose import IDENTITY
from robot.jobs import Jobs
from robot.localisation.known_map import KnownMap, KnownMapError
from robot.localisation.localiser import Localiser
from robot.perception.odometry import STILL
from robot.perception.scan import LaserScan, beam_angles
from robot.slam.graph import GraphSlam
from robot.slam.saved_map import SavedMap, SavedMapError


class KnownMapFileError(EarshotError):
    """A file in which no robot can be localised; the message names it and says why."""


def read_known_map(path: Path) -> KnownMap:
    """The map in a file: a map_server .yaml, or a saved map (docs/map-format.md).

    Raises KnownMapFileError, and MapFileError for a map_server file that cannot be read.
    """
    try:
        if path.suffix in (".yaml", ".yml"):
            return KnownMap.of_grid(read_map(path))
        saved = SavedMap.decode(path.read_bytes())
        return KnownMap.of_submaps(saved.submaps, saved.graph.nodes)
    except OSError as error:
        raise KnownMapFileError(f"{path}: cannot be read ({error.strerror})") from error
    except (SavedMapError, KnownMapError) as error:
        raise KnownMapFileError(f"{path}: {error}") from error


def load_kernels() -> None:
    """Compile, or load, all that localisation in a known map calls."""
    lidar = LidarConfig()
    scan = LaserScan(np.full(lidar.beams, 2.0), beam_angles(lidar), lidar.max_range_m)
    engine = GraphSlam(lidar, BodyConfig(), IDENTITY, Jobs())
    engine.step(0, STILL, scan)
    saved = SavedMap.of(engine)
    known = KnownMap.of_submaps(saved.submaps, saved.graph.nodes)
    Localiser(known, lidar, None).step(0, STILL, scan)
