"""The way a robot came: where it fits, because it was there."""

from collections import deque

import numpy as np

from protocol.pose import FloatArray, Pose2

STEP_M = 0.10
LENGTH = 150
PASSING_M = 0.75  # room beside a robot in which another one gets past it


class Trail:
    """Breadcrumbs each 0.1 m over the last 15 m: position and room around it."""

    def __init__(self) -> None:
        self._crumbs: deque[tuple[float, float, float]] = deque(maxlen=LENGTH)

    def step(self, pose: Pose2, room_m: float) -> None:
        """Note where the robot is, and the distance from its centre to the nearest obstacle."""
        if self._crumbs:
            x, y, _ = self._crumbs[-1]
            if (pose.x - x) ** 2 + (pose.y - y) ** 2 < STEP_M**2:
                return
        self._crumbs.append((pose.x, pose.y, room_m))

    def back(self, pose: Pose2, length_m: float) -> FloatArray:
        """The way back (n×2, m) for about that length, from where the robot is."""
        count = max(1, round(length_m / STEP_M))
        crumbs = list(self._crumbs)[-count:][::-1]
        return np.array([(pose.x, pose.y), *((x, y) for x, y, _ in crumbs)])

    def to_room(self, pose: Pose2, away_from: Pose2, at_least_m: float) -> FloatArray:
        """The way back (n×2, m) to the first place where another robot gets past, at least that
        far from it; all of the trail if there is none."""
        way = [(pose.x, pose.y)]
        for x, y, room in reversed(self._crumbs):
            way.append((x, y))
            gap = ((x - away_from.x) ** 2 + (y - away_from.y) ** 2) ** 0.5
            if room >= PASSING_M and gap >= at_least_m:
                break
        return np.array(way)
