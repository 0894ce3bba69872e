"""What the world tells whoever listens: truth each tick, radio and score each simulated second.

Nothing is put together while nobody listens, and nothing of it reaches a robot: the router's
access control gives these topics to the operator alone.
"""

from collections.abc import Mapping

from protocol.bus import Bus
from protocol.messages import FrameCount, GridPatch, LiveRadio, LiveScore, MapReply, Report, Truth
from protocol.pose import Pose2
from protocol.topics import RADIO, SCORE, TRUTH
from world.frames import frame_of
from world.ledger import DROPPED, Counts
from world.reception import Watcher
from world.referee import Referee
from world.simulation import Simulation

EVERY_S = 1.0


class Broadcasts:
    """A watcher that publishes what it sees and passes it on to another."""

    def __init__(self, simulation: Simulation, bus: Bus, watcher: Watcher) -> None:
        self._simulation = simulation
        self._bus = bus
        self._watcher = watcher
        self._referee: Referee | None = None
        self._maps: dict[str, GridPatch] = {}
        self._frames: dict[str, Pose2] = {}
        self._coverage: float | None = None
        self._next_stamp = 0.0

    def started(self, simulation: Simulation) -> None:
        self._watcher.started(simulation)

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        self._watcher.ticked(simulation, reports)
        if self._bus.is_heard(TRUTH):
            self._bus.publish(TRUTH, self._truth())
        if simulation.stamp < self._next_stamp:
            return
        self._next_stamp = simulation.stamp + EVERY_S
        if self._bus.is_heard(RADIO):
            self._bus.publish(RADIO, self._radio())
        if self._bus.is_heard(SCORE):
            self._bus.publish(SCORE, self._score())

    def mapped(self, robot: str, reply: MapReply) -> None:
        self._watcher.mapped(robot, reply)
        self._maps[robot] = reply.own
        self._frames[robot] = frame_of(self._simulation, robot)
        self._coverage = None

    def _truth(self) -> Truth:
        simulation = self._simulation
        return Truth(
            tick=simulation.tick,
            stamp=simulation.stamp,
            robots=simulation.names,
            poses=simulation.poses,
            links=simulation.links,
        )

    def _radio(self) -> LiveRadio:
        ledger = self._simulation.ledger
        ended = ledger.ended.sum(axis=(0, 1))
        return LiveRadio(
            tick=self._simulation.tick,
            stamp=self._simulation.stamp,
            robots=self._simulation.names,
            links=self._simulation.links,
            offered=_count(ledger.offered.sum(axis=(0, 1))),
            delivered=_count(ledger.delivered.sum(axis=(0, 1))),
            dropped={verdict.name.lower(): _count(ended[verdict]) for verdict in DROPPED},
            in_flight=_count(ledger.in_flight.sum(axis=(0, 1))),
        )

    def _score(self) -> LiveScore:
        simulation = self._simulation
        if self._coverage is None and self._maps:
            self._referee = self._referee or Referee(simulation)
            self._coverage = self._referee.coverage(self._maps, self._frames)
        return LiveScore(
            tick=simulation.tick,
            stamp=simulation.stamp,
            coverage=self._coverage,
            collisions=sum(simulation.collisions.values()),
            alive=simulation.alive,
            finished=simulation.finished,
        )


def _count(amount: Counts) -> FrameCount:
    return FrameCount(frames=int(amount[0]), bytes=int(amount[1]))
