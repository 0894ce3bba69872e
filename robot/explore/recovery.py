"""What to do when the way is blocked: make room, back up, turn to the open, give the goal up.

A robot is stuck when it wants to move and has not got anywhere for some seconds. Of two robots
that block each other the one with the shorter way out of the other's path goes there. Should they
disagree on that, the one with the larger name does, then the one with the smaller name, turn and
turn about: nothing is blocked for ever.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.explore.follower import bearing_to
from robot.explore.policy import Teammate
from robot.explore.retreat import Retreat

STUCK_S, STUCK_M = 4.0, 0.12
FORGIVEN_M = 1.0  # so far from where it was stuck a robot starts counting anew
MEETING_M, MEETING_RAD = 1.3, math.radians(80.0)
FRESH_TICKS = 25
GIVE_WAY_S, WAIT_S, BACK_S, TURN_S = 25.0, 4.0, 2.5, 2.5
PASSED_M, PASSED_S = 1.2, 1.0
WAY_IS_FREE_M = 1.6
MOST_MEETINGS, MOST_WAITS = 6, 2


class Kind(Enum):
    """The behaviours, each ended by its own time limit at the latest."""

    GIVE_WAY = "giving way to"
    WAIT = "waiting for"
    BACK_UP = "backing up"
    TURN = "turning to the open"
    GIVE_UP = "giving this goal up"


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """A behaviour under way: until when (tick), for whom, to which heading."""

    kind: Kind
    until: int
    mate: str = ""
    heading: float = 0.0


class Recovery:
    """Notices that the robot is stuck and chooses what to do about it."""

    def __init__(self, name: str, tick_s: float) -> None:
        self._name = name
        self._tick_s = tick_s
        self._places: deque[tuple[int, float, float]] = deque()
        self._gaps: deque[float] = deque(maxlen=round(PASSED_S / tick_s) + 1)
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
        while self._places[0][0] < tick - span:
            self._places.popleft()
        if self._places[0][0] > tick - span:
            return False
        return all(math.hypot(x - pose.x, y - pose.y) < STUCK_M for _, x, y in self._places)

    def begin(self, tick: int, pose: Pose2, points: FloatArray, mate: Teammate | None) -> Manoeuvre:
        """Choose a behaviour; `points` (n×2) is the scan in the robot's frame, `mate` the
        teammate in the way, if one is: whoever then makes room, first both wait."""
        self._places.clear()
        self._attempts += 1
        self._stuck_at = pose
        # One that stands there finished gets out of the way soon or cannot.
        most = MOST_WAITS if mate is not None and mate.goal is None else MOST_MEETINGS
        if mate is not None and self._attempts <= most:
            self.manoeuvre = Manoeuvre(Kind.WAIT, self._after(tick, WAIT_S), mate.name)
        elif mate is None and self._attempts % 3 == 1:
            self.manoeuvre = Manoeuvre(Kind.BACK_UP, self._after(tick, BACK_S))
        elif mate is None and self._attempts % 3 == 2:
            heading = pose.theta + widest_direction(points)
            self.manoeuvre = Manoeuvre(Kind.TURN, self._after(tick, TURN_S), heading=heading)
        else:
            self._attempts = 0
            self.manoeuvre = Manoeuvre(Kind.GIVE_UP, tick)
        return self.manoeuvre

    def make_room(self, tick: int, retreat: Retreat, obliging: bool) -> bool:
        """Give way if it is on this robot to do so; an `obliging` one does whenever it can."""
        if len(retreat.way) < 2 or not (obliging or self._is_mine(retreat)):
            return False
        self._gaps.clear()
        self.manoeuvre = Manoeuvre(Kind.GIVE_WAY, self._after(tick, GIVE_WAY_S), retreat.mate)
        return True

    def is_over(
        self, tick: int, pose: Pose2, arrived: bool, teammates: tuple[Teammate, ...]
    ) -> bool:
        """Whether the behaviour under way has done what it can."""
        manoeuvre = self.manoeuvre
        if manoeuvre is None or tick >= manoeuvre.until:
            return True
        mate = next((m for m in teammates if m.name == manoeuvre.mate), None)
        gap = math.inf if mate is None else pose.distance_to(mate.pose)
        self._gaps.append(gap)
        if manoeuvre.kind is Kind.TURN:
            return abs(math.remainder(manoeuvre.heading - pose.theta, math.tau)) < 0.2
        if manoeuvre.kind is Kind.WAIT:
            return gap > WAY_IS_FREE_M
        # The other has passed when it is some way off and getting farther.
        return (
            manoeuvre.kind is Kind.GIVE_WAY
            and arrived
            and gap > PASSED_M
            and len(self._gaps) == self._gaps.maxlen
            and gap > self._gaps[0] + 0.1
        )

    def end(self) -> None:
        """The behaviour is over, or was overtaken by events."""
        self.manoeuvre = None
        self._places.clear()
        self._gaps.clear()

    def _is_mine(self, retreat: Retreat) -> bool:
        larger = self._name > retreat.mate
        if self._attempts % 3 == 1:
            if math.isclose(retreat.cost, retreat.mate_cost, rel_tol=0.1):
                return larger
            return retreat.cost < retreat.mate_cost
        return larger == (self._attempts % 3 == 2)

    def _after(self, tick: int, seconds: float) -> int:
        return tick + round(seconds / self._tick_s)


def blocking_teammate(
    pose: Pose2, ahead: FloatArray, teammates: tuple[Teammate, ...]
) -> Teammate | None:
    """The nearest teammate in the way towards a point (2, m), if one is."""
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
