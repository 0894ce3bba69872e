"""Goals that are not gone to any more, so that exploration ends whatever the building is like."""

import numpy as np

from protocol.pose import FloatArray, Pose2

VISITED_M = 0.30
SAME_GOAL_M = 1.0
MOST_RETURNS = 5
PATIENCE_S = 90.0  # longer than two robots take to get out of each other's way
NEARER_M = 0.5


class Refusals:
    """Places seen from already, and goals given up: those that the robot could not reach, turned
    back to again and again, or did not get nearer to for `PATIENCE_S`. The latter are tried
    once more when nothing else is left, and so are the spots where the way to one was blocked:
    until then, what lies behind such a spot is not tried goal by goal."""

    def __init__(self, tick_s: float) -> None:
        self._patience = round(PATIENCE_S / tick_s)
        self.seen: list[Pose2] = []
        self.given_up: list[Pose2] = []
        self._blocked: list[tuple[float, float]] = []
        self._retried = False
        self._returns: list[tuple[Pose2, int]] = []
        self._goal: Pose2 | None = None
        self._nearest_m = np.inf
        self._nearest_tick = 0

    def places(self) -> FloatArray:
        """All of them (n×2, m)."""
        refused = [(place.x, place.y) for place in (*self.seen, *self.given_up)]
        return np.array(refused, dtype=np.float64).reshape(-1, 2)

    def note_seen(self, place: Pose2) -> None:
        """What is unknown in spite of a robot there stays so."""
        if not any(known.distance_to(place) <= VISITED_M for known in self.seen):
            self.seen.append(place)

    def blocked(self) -> FloatArray:
        """Spots (n×2, m) that could not be driven through."""
        return np.array(self._blocked, dtype=np.float64).reshape(-1, 2)

    def give_up(self, goal: Pose2, blocked_at: tuple[float, float] | None = None) -> None:
        """`blocked_at` (m): the spot on the way where it went no farther, if it is known."""
        self.given_up.append(goal)
        if blocked_at is not None:
            self._blocked.append(blocked_at)

    def retry(self) -> bool:
        """Give every goal a second chance, once; False if there is none to give."""
        if not self.given_up or self._retried:
            return False
        self.given_up, self._blocked, self._returns, self._retried = [], [], [], True
        return True

    def returns_too_often(self, before: Pose2 | None, goal: Pose2) -> bool:
        """Count how often the robot turned to a goal after it had left it for another."""
        if before is not None and before.distance_to(goal) <= SAME_GOAL_M:
            return False
        for place, (other, count) in enumerate(self._returns):
            if other.distance_to(goal) <= SAME_GOAL_M:
                self._returns[place] = (other, count + 1)
                return count >= MOST_RETURNS
        self._returns.append((goal, 0))
        return False

    def is_stalled(self, tick: int, goal: Pose2, remaining_m: float) -> bool:
        """Whether the way that remains to a goal has not become shorter for too long."""
        same = self._goal is not None and self._goal.distance_to(goal) <= SAME_GOAL_M
        if not same or remaining_m < self._nearest_m - NEARER_M:
            self._goal, self._nearest_m, self._nearest_tick = goal, remaining_m, tick
        return tick - self._nearest_tick > self._patience
