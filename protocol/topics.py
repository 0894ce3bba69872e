"""The one table of keys: what travels where, under which schema, and what a reader must keep.

Keys are spelt here alone. They are relative to the namespace of the run, which the bus prefixes
to every key of a session, so that two runs on one network never hear each other. What belongs to
a robot lies under `robot/<name>/`: a router's access control can then say that a robot may touch
its own subtree and nothing else, which makes the range gate a property of the network.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Literal

from protocol.config import RobotConfig
from protocol.messages import (
    Action,
    Ended,
    HeardFrame,
    LiveRadio,
    LiveScore,
    MapReply,
    RadioFrame,
    Report,
    Sense,
    Tally,
    TrajectoryReply,
    Truth,
)
from protocol.model import Message

Party = Literal["world", "robot", "station"]


class Style(Enum):
    """How a topic is used: published, asked for (queryable), or the presence of its owner."""

    PUBLISH = "publish"
    QUERY = "query"
    PRESENCE = "presence"


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the table.

    `key` holds `{robot}` where the robot's name goes. `keep` is what a slow reader may lose:
    of `latest` topics everything but the newest, of `every` nothing. What is `reliable` makes
    its sender wait when the network is congested; what is not is dropped then.
    """

    name: str
    key: str
    style: Style
    source: Party
    target: Party
    schema: type[Message] | None
    keep: Literal["latest", "every"]
    reliable: bool
    rate: str

    def key_for(self, robot: str = "") -> str:
        """The key, spelt for one robot; topics of the world take no name."""
        if ("{robot}" in self.key) != bool(robot):
            raise ValueError(f"topic {self.name} {'takes no' if robot else 'needs a'} robot name")
        return self.key.format(robot=robot)


SENSE = Topic(
    "sense",
    "robot/{robot}/sense",
    Style.PUBLISH,
    "world",
    "robot",
    Sense,
    keep="latest",
    reliable=True,
    rate="every tick",
)
ACT = Topic(
    "act",
    "robot/{robot}/act",
    Style.PUBLISH,
    "robot",
    "world",
    Action,
    keep="latest",
    reliable=True,
    rate="once for every sense answered",
)
RADIO_OUT = Topic(
    "radio-out",
    "robot/{robot}/radio/out",
    Style.PUBLISH,
    "robot",
    "world",
    RadioFrame,
    keep="every",
    reliable=True,
    rate="before the act that counts them",
)
RADIO_IN = Topic(
    "radio-in",
    "robot/{robot}/radio/in",
    Style.PUBLISH,
    "world",
    "robot",
    HeardFrame,
    keep="every",
    reliable=True,
    rate="before the sense that counts them",
)
REPORT = Topic(
    "report",
    "robot/{robot}/report",
    Style.PUBLISH,
    "robot",
    "station",
    Report,
    keep="every",
    reliable=True,
    rate="each simulated second",
)
ENDED = Topic(
    "ended",
    "robot/{robot}/ended",
    Style.PUBLISH,
    "world",
    "robot",
    Ended,
    keep="every",
    reliable=True,
    rate="once, at the end of the run",
)
CONFIG = Topic(
    "config",
    "robot/{robot}/config",
    Style.QUERY,
    "world",
    "robot",
    RobotConfig,
    keep="every",
    reliable=True,
    rate="when a robot starts",
)
MAP = Topic(
    "map",
    "robot/{robot}/map",
    Style.QUERY,
    "robot",
    "station",
    MapReply,
    keep="every",
    reliable=True,
    rate="when asked",
)
EXACT_MAP = Topic(
    "exact-map",
    "robot/{robot}/map/exact",
    Style.QUERY,
    "robot",
    "station",
    MapReply,
    keep="every",
    reliable=True,
    rate="when asked, as at the end of a run: drawn anew from the journal alone",
)
TRAJECTORY = Topic(
    "trajectory",
    "robot/{robot}/trajectory",
    Style.QUERY,
    "robot",
    "station",
    TrajectoryReply,
    keep="every",
    reliable=True,
    rate="when asked",
)
TALLY = Topic(
    "tally",
    "robot/{robot}/tally",
    Style.QUERY,
    "robot",
    "station",
    Tally,
    keep="every",
    reliable=True,
    rate="when asked, as at the end of a run: what it sent and received",
)
ROBOT_ALIVE = Topic(
    "robot-alive",
    "robot/{robot}/alive",
    Style.PRESENCE,
    "robot",
    "world",
    None,
    keep="latest",
    reliable=True,
    rate="while the robot is ready",
)
WORLD_ALIVE = Topic(
    "world-alive",
    "world/alive",
    Style.PRESENCE,
    "world",
    "robot",
    None,
    keep="latest",
    reliable=True,
    rate="while the world runs",
)
TRUTH = Topic(
    "truth",
    "world/truth",
    Style.PUBLISH,
    "world",
    "station",
    Truth,
    keep="latest",
    reliable=False,
    rate="every tick, while someone listens",
)
RADIO = Topic(
    "radio",
    "world/radio",
    Style.PUBLISH,
    "world",
    "station",
    LiveRadio,
    keep="latest",
    reliable=False,
    rate="each simulated second, while someone listens",
)
SCORE = Topic(
    "score",
    "world/score",
    Style.PUBLISH,
    "world",
    "station",
    LiveScore,
    keep="latest",
    reliable=False,
    rate="each simulated second, while someone listens",
)

TOPICS: tuple[Topic, ...] = (
    SENSE,
    ACT,
    RADIO_OUT,
    RADIO_IN,
    REPORT,
    ENDED,
    CONFIG,
    MAP,
    EXACT_MAP,
    TRAJECTORY,
    TALLY,
    ROBOT_ALIVE,
    WORLD_ALIVE,
    TRUTH,
    RADIO,
    SCORE,
)
