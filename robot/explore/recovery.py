"""What to do when the way is blocked: make room, back up, turn to the open, give the goal up.

A robot is stuck when it wants to move and has not got anywhere for some seconds. Between two
robots that block each other the one with the larger name gives way; should that not help (it may
have no way back) the other one does, turn and turn about, so that nothing is blocked for ever.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.explore.follower import bearing_to
from robot.explore.policy import Teammate
from robot.explore.trail import Trail

STUCK_S, STUCK_M = 4.0, 0.12
FORGIVEN_M = 1.0  # so far from where it was stuck a robot starts counting anew
MEETING_M, MEETING_RAD = 1.3, math.radians(80.0)
FRESH_TICKS = 20
GIVE_WAY_S, WAIT_S, BACK_S, TURN_S = 12.0, 4.0, 2.5, 2.5
BACK_UP_MPS, TURN_RPS = -0.15, 0.8
KEEP_AWAY_M = 1.6


class Kind(Enum):
    """The behaviours, each ended by its own time limit at the latest."""

    GIVE_WAY = "giving way to"
    WAIT = "waiting for"
    BACK_UP = "backing up"
    TURN = "turning to the open"
    GIVE_UP = "giving this goal up"


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """A behaviour under way: until when (tick), for whom, along which path, to which heading."""

    kind: Kind
    until: int
    mate: str = ""
    path: FloatArray | None = None
    heading: float = 0.0


class Recovery:
    """Notices that the robot is stuck and chooses what to do about it."""

    def __init__(self, name: str, tick_s: float) -> None:
        self._name = name
        self._tick_s = tick_s
        self._places: deque[tuple[int, float, float]] = deque()
        self._attempts = 0
        self._stuck_at: Pose2 | None = None
        self.manoeuvre: Manoeuvre | None = None

    def is_stuck(self, tick: int, pose: Pose2, wants_to_move: bool) -> bool:
        """Whether the robot has wanted to move for `STUCK_S` and stayed within `STUCK_M`."""
        if self._stuck_at is not None and pose.distance_to(self._stuck_at) > FORGIVEN_M:
            self._stuck_at, self._attempts = None, 0
        if not wants_to_move:
            self._places.clear()
            return False
        self._places.append((tick, pose.x, pose.y))
        span = round(STUCK_S / self._tick_s)
        while self._places and self._places[0][0] < tick - span:
            self._places.popleft()
        if self._places[0][0] > tick - span:
            return False
        return all(math.hypot(x - pose.x, y - pose.y) < STUCK_M for _, x, y in self._places)

    def begin(
        self,
        tick: int,
        pose: Pose2,
        ahead: FloatArray,
        points: FloatArray,
        trail: Trail,
        teammates: tuple[Teammate, ...],
    ) -> Manoeuvre:
        """Choose a behaviour; `ahead` (2) is where the robot wanted to go next (m), `points`
        (n×2) the scan in the robot's frame."""
        self._places.clear()
        self._attempts += 1
        self._stuck_at = pose
        mate = blocking_teammate(pose, ahead, teammates)
        if mate is not None:
            self.manoeuvre = self._meet(tick, pose, trail, mate)
        elif self._attempts % 3 == 1:
            self.manoeuvre = Manoeuvre(Kind.BACK_UP, self._after(tick, BACK_S))
        elif self._attempts % 3 == 2:
            heading = pose.theta + widest_direction(points)
            self.manoeuvre = Manoeuvre(Kind.TURN, self._after(tick, TURN_S), heading=heading)
        else:
            self.manoeuvre = Manoeuvre(Kind.GIVE_UP, tick)
        return self.manoeuvre

    def make_room(self, tick: int, pose: Pose2, trail: Trail, mate: Teammate) -> Manoeuvre:
        """Give way to a teammate whatever the names are: this robot has no goal of its own."""
        path = trail.to_room(pose, mate.pose, KEEP_AWAY_M)
        self.manoeuvre = Manoeuvre(Kind.GIVE_WAY, self._after(tick, GIVE_WAY_S), mate.name, path)
        return self.manoeuvre

    def _meet(self, tick: int, pose: Pose2, trail: Trail, mate: Teammate) -> Manoeuvre:
        if self._attempts >= 6:
            self._attempts = 0
            return Manoeuvre(Kind.GIVE_UP, tick, mate.name)
        mine_to_yield = (self._name > mate.name) == (self._attempts % 4 in (1, 2))
        if mine_to_yield:
            return self.make_room(tick, pose, trail, mate)
        return Manoeuvre(Kind.WAIT, self._after(tick, WAIT_S), mate.name)

    def end(self) -> None:
        """The behaviour is over, or was overtaken by events."""
        self.manoeuvre = None
        self._places.clear()

    def _after(self, tick: int, seconds: float) -> int:
        return tick + round(seconds / self._tick_s)


def blocking_teammate(
    pose: Pose2, ahead: FloatArray, teammates: tuple[Teammate, ...]
) -> Teammate | None:
    """The nearest teammate in the way towards a point, if one is."""
    way = bearing_to(pose, float(ahead[0]), float(ahead[1]))
    blocking = [
        mate
        for mate in teammates
        if mate.age_ticks <= FRESH_TICKS
        and pose.distance_to(mate.pose) <= MEETING_M
        and abs(math.remainder(bearing_to(pose, mate.pose.x, mate.pose.y) - way, math.tau))
        <= MEETING_RAD
    ]
    return min(blocking, key=lambda mate: (pose.distance_to(mate.pose), mate.name), default=None)


def widest_direction(points: FloatArray) -> float:
    """The direction (rad, robot frame) in which the scan (n×2) leaves the widest room."""
    directions = np.arange(16) * (2.0 * np.pi / 16) - np.pi
    if len(points) == 0:
        return 0.0
    ahead = 0.5 * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    gaps = np.hypot(*(points[None, :, :] - ahead[:, None, :]).transpose(2, 0, 1)).min(axis=1)
    return float(directions[int(np.argmax(gaps))])
