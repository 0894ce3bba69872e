"""Two robots that see each other know how they stand."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from protocol.config import SightingConfig
from protocol.messages import Sighting
from protocol.pose import IDENTITY, Pose2
from robot.team.beacon import Beacon
from robot.team.evidence import Kind
from robot.team.journal import LogName
from robot.team.meetings import EVERY_TICKS, MOST, Meetings, relative_pose

ONE, TWO = LogName("r1", 0), LogName("r2", 0)
poses = st.builds(
    Pose2, st.floats(-50, 50), st.floats(-50, 50), st.floats(-math.pi, math.pi, exclude_max=True)
)


def sight(observer: Pose2, other: Pose2, name: str) -> Sighting:
    there = observer.inverse() @ other
    return Sighting(
        robot=name,
        range_m=math.hypot(there.x, there.y),
        bearing_rad=math.atan2(there.y, there.x),
    )


def beacon(at: Pose2, sightings: tuple[Sighting, ...]) -> Beacon:
    return Beacon(0, 3, at, np.full(3, 0.01), None, False, (), {}, sightings)


@given(poses, poses)
def test_sightings_both_ways_give_the_relative_pose(a: Pose2, b: Pose2) -> None:
    if a.distance_to(b) < 0.1:
        return
    found = (a.inverse() @ b).inverse() @ relative_pose(sight(a, b, "r2"), sight(b, a, "r1"))
    assert math.hypot(found.x, found.y) < 1e-9 * (1.0 + a.distance_to(b))
    assert abs(found.theta) < 1e-9


@given(poses, poses, poses, poses)
def test_a_meeting_becomes_a_link_between_anchors(
    a: Pose2, b: Pose2, anchor_a: Pose2, anchor_b: Pose2
) -> None:
    if a.distance_to(b) < 0.1:
        return
    meetings = Meetings(ONE, SightingConfig())
    meetings.remember(40, 2, anchor_a.inverse() @ a, (sight(a, b, "r2"),))
    link = meetings.hear("r2", 40, beacon(anchor_b.inverse() @ b, (sight(b, a, "r1"),)))
    assert link is not None and link.evidence.kind is Kind.SIGHTING
    assert (link.of, link.log, link.to) == (2, TWO, 3)
    missed = (anchor_a.inverse() @ anchor_b).inverse() @ link.T_of_to
    assert np.abs(missed.log()).max() < 1e-6
    assert (np.linalg.eigvalsh(link.information) > 0.0).all()


def test_who_was_not_seen_at_that_tick_or_does_not_see_back_makes_no_link() -> None:
    a, b = IDENTITY, Pose2(3.0, 0.0, 1.0)
    meetings = Meetings(ONE, SightingConfig())
    meetings.remember(40, 0, a, (sight(a, b, "r2"),))
    seen_back = (sight(b, a, "r1"),)
    assert meetings.hear("r2", 41, beacon(b, seen_back)) is None
    assert meetings.hear("r2", 40, beacon(b, ())) is None
    assert meetings.hear("r3", 40, beacon(b, seen_back)) is None


def test_one_of_two_writes_it_down_and_not_for_ever() -> None:
    a, b = IDENTITY, Pose2(3.0, 0.0, 1.0)
    later = Meetings(TWO, SightingConfig())
    later.remember(40, 0, b, (sight(b, a, "r1"),))
    assert later.hear("r1", 40, beacon(a, (sight(a, b, "r2"),))) is None
    first = Meetings(ONE, SightingConfig())
    found = []
    for tick in range(0, 1000, 5):
        first.remember(tick, 0, a, (sight(a, b, "r2"),))
        if first.hear("r2", tick, beacon(b, (sight(b, a, "r1"),))) is not None:
            found.append(tick)
    assert len(found) == MOST
    # Two at once, of a glimpse too; then now and then.
    assert np.diff(found)[0] == 5
    assert min(np.diff(found)[1:]) >= EVERY_TICKS
