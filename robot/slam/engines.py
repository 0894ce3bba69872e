"""The SLAM engines by name. A new one is a file with its class, and a line here."""

from protocol.config import BodyConfig, LidarConfig
from protocol.errors import EarshotError
from protocol.pose import Pose2
from robot.jobs import Jobs
from robot.slam.dead_reckoning import DeadReckoning
from robot.slam.engine import Engine
from robot.slam.graph import GraphSlam

ENGINES: dict[str, type[GraphSlam] | type[DeadReckoning]] = {
    "graph": GraphSlam,
    "dead-reckoning": DeadReckoning,
}


class UnknownEngineError(EarshotError):
    """A robot was told to run a SLAM engine that does not exist."""


def make_engine(
    name: str, lidar: LidarConfig, body: BodyConfig, start: Pose2, jobs: Jobs
) -> Engine:
    """The engine of that name for a robot that starts at `start` in its map frame.

    Raises UnknownEngineError, which lists the known names.
    """
    engine = ENGINES.get(name)
    if engine is None:
        known = ", ".join(sorted(ENGINES))
        raise UnknownEngineError(f"no SLAM engine is called {name!r}; known are: {known}")
    return engine(lidar, body, start, jobs)
