"""Occupancy grids: the one map type that the world, the robots and the station share.

Cells are int8 as in ROS: −1 unknown, 0 free … 100 occupied, in percent. Row 0 has the lowest y
(images have it at the top: reading and writing flips them), column 0 the lowest x. Files are ROS
map_server pairs (YAML + PGM or PNG, trinary).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import yaml

from maps.pixels import MapFileError, pgm_bytes, read_pixels, write_whole
from protocol.pose import FloatArray

__all__ = [
    "FREE",
    "OCCUPIED",
    "UNKNOWN",
    "BoolArray",
    "CellArray",
    "IntArray",
    "MapFileError",
    "OccupancyGrid",
    "read_map",
    "write_map",
]

CellArray = npt.NDArray[np.int8]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

FREE = 0
OCCUPIED = 100
UNKNOWN = -1

# map_server's grey values and the thresholds that read them back as the same three states.
# With free_thresh 0.25, which many tools write, unknown (205) would be read as free.
PIXEL_OCCUPIED, PIXEL_UNKNOWN, PIXEL_FREE = 0, 205, 254
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
REQUIRED_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """An axis-aligned grid. (origin_x, origin_y) is the lower left corner of cell (0, 0), in m."""

    cells: CellArray
    resolution: float
    origin_x: float
    origin_y: float

    @property
    def free(self) -> BoolArray:
        return (self.cells >= 0) & (self.cells < 50)

    @property
    def occupied(self) -> BoolArray:
        return self.cells >= 50

    @property
    def known(self) -> BoolArray:
        return self.cells >= 0

    def to_cells(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows and columns of n×2 points (m); they may lie outside the grid."""
        columns = np.floor((points[:, 0] - self.origin_x) / self.resolution).astype(np.int64)
        rows = np.floor((points[:, 1] - self.origin_y) / self.resolution).astype(np.int64)
        return rows, columns

    def to_points(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Centres (n×2, m) of cells."""
        return np.stack(
            [
                self.origin_x + (columns + 0.5) * self.resolution,
                self.origin_y + (rows + 0.5) * self.resolution,
            ],
            axis=-1,
        )

    def inside(self, rows: IntArray, columns: IntArray) -> BoolArray:
        height, width = self.cells.shape
        found: BoolArray = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return found


def read_map(path: Path) -> OccupancyGrid:
    """Read a map_server YAML file and its image.

    Raises MapFileError, with one line that says what is wrong, on anything unexpected.
    """
    settings = _read_settings(path)
    resolution = _number(path, settings, "resolution")
    if not 1e-4 <= resolution <= 100.0:
        raise MapFileError(f"{path}: resolution must be in metres per cell, got {resolution}")
    origin_x, origin_y = _origin(path, settings)
    occupied_above = _number(path, settings, "occupied_thresh")
    free_below = _number(path, settings, "free_thresh")
    if not 0.0 <= free_below < occupied_above <= 1.0:
        raise MapFileError(
            f"{path}: expected 0 <= free_thresh < occupied_thresh <= 1, "
            f"got {free_below} and {occupied_above}"
        )
    if settings.get("mode", "trinary") != "trinary":
        raise MapFileError(f"{path}: mode must be trinary, got {settings['mode']!r}")
    image = settings.get("image")
    if not isinstance(image, str) or not image:
        raise MapFileError(f"{path}: image must name the image file, got {image!r}")
    pixels = read_pixels(path.parent / image)
    shade = pixels if _number(path, settings, "negate") else 255 - pixels
    levels = np.arange(256) / 255.0
    states = np.full(256, UNKNOWN, dtype=np.int8)
    states[levels > occupied_above] = OCCUPIED
    states[levels < free_below] = FREE
    cells = np.ascontiguousarray(states[shade][::-1])
    return OccupancyGrid(cells, resolution, origin_x, origin_y)


def write_map(grid: OccupancyGrid, path: Path) -> None:
    """Write `path` (.yaml) and the image beside it (.pgm), in map_server's trinary form.

    Each file appears whole or not at all, the image first. Raises MapFileError when the grid
    has no cells or the folder cannot be written.
    """
    if path.suffix not in (".yaml", ".yml"):
        raise MapFileError(f"{path}: a map is written as NAME.yaml, with NAME.pgm beside it")
    if grid.cells.size == 0:
        raise MapFileError(f"{path}: a grid without cells cannot be written")
    pixels = np.full(grid.cells.shape, PIXEL_UNKNOWN, dtype=np.uint8)
    pixels[grid.free] = PIXEL_FREE
    pixels[grid.occupied] = PIXEL_OCCUPIED
    image = path.with_suffix(".pgm")
    settings = {
        "image": image.name,
        "resolution": float(grid.resolution),
        "origin": [float(grid.origin_x), float(grid.origin_y), 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESHOLD,
        "free_thresh": FREE_THRESHOLD,
        "mode": "trinary",
    }
    text = yaml.safe_dump(settings, sort_keys=False, default_flow_style=None)
    write_whole(image, pgm_bytes(pixels[::-1]))
    write_whole(path, text.encode())


def _read_settings(path: Path) -> dict[str, object]:
    try:
        text = path.read_text(encoding="utf-8")
        settings = yaml.safe_load(text)
    except OSError as error:
        raise MapFileError(f"{path}: cannot read the map ({error.strerror})") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise MapFileError(f"{path}: not a YAML file ({first})") from error
    if not isinstance(settings, dict):
        raise MapFileError(f"{path}: expected the keys of a map_server YAML file")
    missing = [key for key in REQUIRED_KEYS if key not in settings]
    if missing:
        raise MapFileError(f"{path}: lacks {', '.join(missing)}")
    return settings


def _number(path: Path, settings: dict[str, object], key: str) -> float:
    value = settings[key]
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise MapFileError(f"{path}: {key} must be a number, got {value!r}")
    return float(value)


def _origin(path: Path, settings: dict[str, object]) -> tuple[float, float]:
    origin = settings["origin"]
    if not isinstance(origin, list) or len(origin) not in (2, 3):
        raise MapFileError(f"{path}: origin must be [x, y, 0.0], got {origin!r}")
    numbers = [_number(path, {"origin": value}, "origin") for value in origin]
    if any(numbers[2:]):
        raise MapFileError(f"{path}: an origin that is rotated ({origin}) is not supported")
    return numbers[0], numbers[1]
