"""Meetings: two robots that see each other know how their frames lie, whatever the walls look like.

A beacon tells whom its sender sees, at which range and bearing. Who sees the sender at the same
tick has the pose of the other in its own frame: the position by its own sighting, the heading by
both bearings. The identity comes with the sighting, so no look-alike place can be taken for it.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from protocol.config import SightingConfig
from protocol.messages import Sighting
from protocol.pose import FloatArray, Pose2, wrap_angle
from robot.slam.gaussian import carry, invert_spd
from robot.team.beacon import Beacon
from robot.team.entries import Link
from robot.team.evidence import Evidence, Kind
from robot.team.hypothesis import MIN_SIGHTINGS
from robot.team.journal import LogName

# Beacons come a few ticks late.
REMEMBERED_TICKS = 30
# Sightings right after one another err the same way; but those that it takes are worth having of a
# glimpse too.
EVERY_TICKS = 15
# Enough for one pair.
MOST = 12
# What the poses of both in their anchors' frames err by, besides what they say.
FLOOR = np.diag([0.02**2, 0.02**2, 0.005**2])


@dataclass(frozen=True, slots=True)
class Moment:
    """Where this robot was at a tick, relative to one of its anchors, and whom it saw."""

    tick: int
    anchor: int
    T_anchor_base: Pose2
    sightings: tuple[Sighting, ...]


class Meetings:
    """Remembers whom this robot saw, until beacons tell who saw it."""

    def __init__(self, own: LogName, sensor: SightingConfig) -> None:
        self._own = own
        self._sensor = sensor
        self._moments: deque[Moment] = deque(maxlen=REMEMBERED_TICKS)
        self._last: dict[LogName, tuple[int, int]] = {}

    def remember(
        self, tick: int, anchor: int, T_anchor_base: Pose2, sightings: Sequence[Sighting]
    ) -> None:
        """Note where this robot is and whom it sees."""
        if sightings:
            self._moments.append(Moment(tick, anchor, T_anchor_base, tuple(sightings)))

    def hear(self, sender: str, sent_tick: int, beacon: Beacon) -> Link | None:
        """A link to the sender of a beacon, if the two saw each other when it was sent.

        Of two robots one writes it down, and of a long meeting a few moments are enough.
        """
        log = LogName(sender, beacon.incarnation)
        last_tick, count = self._last.get(log, (-EVERY_TICKS, 0))
        least = EVERY_TICKS if count >= MIN_SIGHTINGS else 1
        if log < self._own or sent_tick - last_tick < least or count >= MOST:
            return None
        moment = next((m for m in self._moments if m.tick == sent_tick), None)
        seen = _of(moment.sightings, sender) if moment else None
        back = _of(beacon.sightings, self._own.robot)
        if moment is None or seen is None or back is None:
            return None
        self._last[log] = (sent_tick, count + 1)
        T_base_mate = relative_pose(seen, back)
        T_of_to = moment.T_anchor_base @ T_base_mate @ beacon.T_anchor_base.inverse()
        covariance = self._covariance(seen, back) + np.diag(beacon.sigma**2) + FLOOR
        information = invert_spd(carry(covariance, beacon.T_anchor_base.inverse()))
        return Link(
            moment.anchor, log, beacon.anchor, T_of_to, information, Evidence(Kind.SIGHTING)
        )

    def _covariance(self, seen: Sighting, back: Sighting) -> FloatArray:
        """Covariance (3×3) of the other's pose, tangent space there."""
        along = self._sensor.sigma_range_m
        across = self._sensor.sigma_bearing_rad * seen.range_m
        turn = math.sqrt(2.0) * self._sensor.sigma_bearing_rad
        # The line of sight in the other's frame points along its own bearing.
        c, s = math.cos(back.bearing_rad), math.sin(back.bearing_rad)
        axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        # The own bearing moves the position and turns the heading by the same angle.
        sigma = np.diag([along**2, across**2, turn**2])
        shared = -across * self._sensor.sigma_bearing_rad
        sigma[1, 2] = sigma[2, 1] = shared
        return np.asarray(axes @ sigma @ axes.T, dtype=np.float64)


def relative_pose(seen: Sighting, back: Sighting) -> Pose2:
    """The pose of a robot from where it is seen, and where it sees the one that sees it."""
    turn = wrap_angle(seen.bearing_rad + math.pi - back.bearing_rad)
    return seen.place @ Pose2(0.0, 0.0, turn)


def _of(sightings: Sequence[Sighting], robot: str) -> Sighting | None:
    return next((sighting for sighting in sightings if sighting.robot == robot), None)
