"""Which alignment is right where a building repeats itself: the place that does not tells."""

from dataclasses import replace

import numpy as np
import pytest

from maps.library import load_map, varied
from protocol.config import LidarConfig
from protocol.pose import IDENTITY, FloatArray, Pose2
from robot.perception.returns import noise_model
from robot.perception.scan import perceive
from robot.slam.engine import Anchor, Keyframe
from robot.team.demands import CLEAN, CLEAR, FEW, demands_on
from robot.team.entries import Hello, decode_entry, encode_entry
from robot.team.hypothesis import Hypothesis
from robot.team.joint import JointGraph
from robot.team.journal import LogName
from robot.team.log_map import LogMap, Overlap, choose_scans, draw_log, lay_over
from robot.team.rivals import Laid, cleanest, may_be_rival
from world.lidar import Lidars
from world.noise import Noise
from world.terrain import Terrain

WORLD = "rows:width_m=60"
CONFIG = varied(WORLD)
assert CONFIG is not None
NEXT_ROOM = Pose2(CONFIG.room_width_m + CONFIG.wall_m, 0.0, 0.0)
MIDDLE_M = 0.5 * CONFIG.height_m
# Ways along the corridor: one from where the hall is in sight, one where nothing but rooms is.
PAST_THE_HALL, PAST_ROOMS = np.arange(8.0, 50.0, 0.9), np.arange(20.0, 34.0, 0.9)


def drawn(way: FloatArray, seed: int) -> LogMap:
    """The map of a robot that drove along the corridor and looked both ways, in the world."""
    lidar, noise, terrain = LidarConfig(), Noise(seed), Terrain(load_map(WORLD))
    name, lidars = LogName("r1", seed), Lidars(lidar, ("r1",), 0.2)
    start = Pose2(float(way[0]) + 0.1 * seed, MIDDLE_M, 0.0)
    graph = JointGraph()
    graph.add(name, Hello(None, lidar.beams, lidar.angle_min_rad, lidar.increment_rad, 12.0, 0.2))
    graph.add(name, Anchor(0, IDENTITY, np.eye(3) * 1e6))
    for k, x in enumerate((way - way[0]).tolist()):
        T_anchor = Pose2(x, 0.0, np.pi * (k % 2))
        (seen,) = lidars.scan(terrain, (start @ T_anchor).to_array()[None], k, noise)
        keyframe = Keyframe(k, k, 0, T_anchor, np.eye(3) * 1e-5, perceive(seen, lidar).ranges)
        graph.add(name, decode_entry(encode_entry(keyframe), k))
    log, anchors = graph.log(name), start.to_array()[None]
    assert log is not None
    return draw_log(log, choose_scans(log, anchors, noise_model(lidar)), anchors)


def laid(maps: tuple[LogMap, LogMap], worth: float, T_a_b: Pose2) -> Laid:
    hypothesis = Hypothesis((), worth, 5, 0, 0.9, {})
    return Laid(hypothesis, lay_over(*maps, T_a_b), T_a_b)


@pytest.fixture(scope="module")
def hall() -> tuple[LogMap, LogMap]:
    return drawn(PAST_THE_HALL, 1), drawn(PAST_THE_HALL, 2)


@pytest.fixture(scope="module")
def rooms() -> tuple[LogMap, LogMap]:
    return drawn(PAST_ROOMS, 1), drawn(PAST_ROOMS, 2)


@pytest.mark.parametrize("worth", [2.0, 4.5])
def test_one_place_that_does_not_fit_outweighs_all_rooms_that_do(
    hall: tuple[LogMap, LogMap], worth: float
) -> None:
    right = laid(hall, 5.0, IDENTITY)
    assert right.overlap.gone_m < 1.0
    for T_wrong in (NEXT_ROOM, NEXT_ROOM.inverse()):
        wrong = laid(hall, worth, T_wrong)
        # By shares the maps agree: most of what they have in common are rooms.
        assert wrong.overlap.crossing < 0.01 and wrong.overlap.hits > 0.95
        assert wrong.overlap.gone_m > 5.0
        assert not wrong.rivals(right)
        assert right.rivals(wrong)


@pytest.mark.parametrize("worth", [2.0, 4.5])
def test_where_nothing_but_rooms_was_seen_it_stays_open(
    rooms: tuple[LogMap, LogMap], worth: float
) -> None:
    one, other = laid(rooms, 5.0, IDENTITY), laid(rooms, worth, NEXT_ROOM)
    assert other.rivals(one)
    assert laid(rooms, worth, IDENTITY).rivals(laid(rooms, 5.0, NEXT_ROOM))


def test_maps_that_hardly_touch_rule_nothing_out(hall: tuple[LogMap, LogMap]) -> None:
    """Where little is shared little can be gone."""
    right, wrong = laid(hall, 5.0, IDENTITY), laid(hall, 4.5, NEXT_ROOM)
    little = replace(right.overlap, walls_m=0.4 * wrong.overlap.walls_m)
    assert wrong.rivals(replace(right, overlap=little))


def test_walls_that_lie_a_little_off_are_not_gone(rooms: tuple[LogMap, LogMap]) -> None:
    drifted = laid(rooms, 5.0, Pose2(0.0, 0.12, 0.0))
    assert drifted.overlap.hits < 0.8 and drifted.overlap.gone_m < 2.5


def test_walls_rather_than_worth_say_which_is_right(hall: tuple[LogMap, LogMap]) -> None:
    """More rooms may match by a wrong one."""
    right, wrong = laid(hall, 4.0, IDENTITY), laid(hall, 8.0, NEXT_ROOM)
    assert cleanest([wrong, right]) is right
    assert wrong.is_refuted(right) and not right.is_refuted(wrong)
    assert cleanest([wrong]) is None and cleanest([]) is None


def overlap(walls_m: float, hits: float = 0.9, gone_m: float = 0.2) -> Overlap:
    return Overlap(0.2, hits, 0.002, walls_m, 0.002, 0.9, gone_m)


def test_another_alignment_by_which_little_is_shared_but_nothing_is_wrong_leaves_it_open() -> None:
    """As of two robots in two equal halves of a building, which share nothing but the middle."""
    halves = Laid(Hypothesis((), 9.0, 9, 0, 0.3, {}), overlap(150.0, hits=0.99), IDENTITY)
    middle = Laid(Hypothesis((), 0.7, 1, 0, 1.0, {}), overlap(22.0), NEXT_ROOM)
    assert may_be_rival(middle.hypothesis, halves.hypothesis)
    assert middle.rivals(halves)
    for other in (overlap(12.0), overlap(22.0, hits=0.72), overlap(22.0, gone_m=3.2)):
        assert not replace(middle, overlap=other).rivals(halves)


def test_of_maps_that_disagree_in_nothing_little_wall_is_enough() -> None:
    one = Hypothesis((), 0.9, 1, 0, 0.7, {})
    assert demands_on(one, 0.0, overlap(17.0)) is CLEAN
    assert demands_on(one, 0.0, overlap(17.0, gone_m=2.0)) is FEW
    assert demands_on(one, 0.0, overlap(12.0)) is FEW
    assert demands_on(one, 0.0, replace(overlap(17.0), faced=0.5)) is FEW
    assert not CLEAN.are_met_by(replace(one, ambiguity=0.95), rival=0.0)
    assert demands_on(replace(one, places=3, worth=2.0), 0.0, overlap(40.0)) is CLEAR


def test_what_one_robot_saw_change_is_suffered_and_what_both_contradict_is_not() -> None:
    """As two runs in one building with people and glass, and two rings of corridors."""
    one = Hypothesis((), 1.5, 4, 0, 0.78, {})
    changed = Overlap(0.98, 0.83, 0.052, 72.0, 0.032, 0.98, 9.0)
    assert demands_on(one, 0.2, changed) is CLEAR and CLEAR.suit(changed)
    assert not CLEAR.suit(replace(changed, crossing_mean=0.048))
    assert not CLEAR.are_met_by(replace(one, ambiguity=0.97), 0.2)
