"""What the world has of a robot when a run is over: its answers, and how the wire between did."""

from collections import Counter
from dataclasses import dataclass

from pydantic import Field

from protocol.messages import MapReply, Tally, TrajectoryReply
from protocol.model import Model
from protocol.topics import ACT, RADIO_IN, RADIO_OUT, REPORT, SENSE

TOLD = (SENSE, RADIO_IN)  # what robots are told without asking
SPOKEN = (RADIO_OUT, ACT, REPORT)  # what robots say without being asked

Counts = Counter[tuple[str, str]]  # by topic and robot


class WireCount(Model):
    """Messages of one topic between the world and one robot: put on the wire, and taken from it."""

    sent: int = Field(ge=0)
    received: int = Field(ge=0)


@dataclass(slots=True)
class LastWords:
    """What one robot answered at the end; None for what it did not."""

    map: MapReply | None = None
    trajectory: TrajectoryReply | None = None
    wire: dict[str, WireCount] | None = None

    @property
    def complete(self) -> bool:
        return self.map is not None and self.trajectory is not None and self.wire is not None


def compare(robot: str, tally: Tally, sent: Counts, received: Counts) -> dict[str, WireCount]:
    """By topic, what one side sent against what the other received; `sent` and `received` are the
    world's counts when the tally came, which all that it counts as sent came before."""
    told = {
        topic.name: WireCount(
            sent=sent[topic.name, robot], received=tally.received.get(topic.name, 0)
        )
        for topic in TOLD
    }
    spoken = {
        topic.name: WireCount(
            sent=tally.sent.get(topic.name, 0), received=received[topic.name, robot]
        )
        for topic in SPOKEN
    }
    return told | spoken
