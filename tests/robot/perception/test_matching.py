"""Scan matching and search against poses that are known exactly."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.config import LidarConfig
from protocol.pose import IDENTITY, Pose2
from robot.perception.field import RESOLUTION_M, CorrelationField
from robot.perception.matching import match_facing, match_returns
from robot.perception.returns import Returns, describe_returns, noise_model
from robot.perception.scan import LaserScan, beam_angles
from robot.perception.search import Blocks, Pyramid, Window, rotations, search
from robot.perception.search_kernels import NODES_PER_CELL
from robot.perception.walls import Walls

LIDAR = LidarConfig(noise="none")
HERE = Pose2(2.0, 2.5, 0.3)


def returns_of(scan: LaserScan, lidar: LidarConfig = LIDAR) -> Returns:
    return describe_returns(scan, noise_model(lidar), 20.0)


def field_at(
    world: Any,
    poses: list[Pose2],
    lidar: LidarConfig = LIDAR,
    rng: np.random.Generator | None = None,
) -> CorrelationField:
    """A field in the world's own frame, drawn from scans at true poses."""
    field = CorrelationField.around(12.0)
    for pose in poses:
        field.draw(pose, returns_of(world.scan(pose, lidar, rng), lidar))
    return field


def error(found: Pose2, truth: Pose2) -> tuple[float, float]:
    off = truth.inverse() @ found
    return math.hypot(off.x, off.y), abs(off.theta)


@settings(max_examples=25, deadline=None)
@given(
    dx=st.floats(-0.06, 0.06),
    dy=st.floats(-0.06, 0.06),
    turn=st.floats(-0.03, 0.03),
    x=st.floats(1.0, 2.6),
    y=st.floats(1.7, 3.5),
)
def test_a_match_finds_the_true_pose(
    room: Any, dx: float, dy: float, turn: float, x: float, y: float
) -> None:
    field = field_at(room, [HERE, Pose2(2.6, 2.2, 0.0)])
    truth = Pose2(x, y, 0.2)
    match = match_returns(field, returns_of(room.scan(truth, LIDAR)), truth @ Pose2(dx, dy, turn))
    metres, radians = error(match.T_field_base, truth)
    assert metres < 0.01
    assert radians < 0.003
    assert match.score > 0.8


def test_fields_have_no_half_cell_bias(room: Any) -> None:
    """Matches of scans from all over a cell err to all sides: an offset of the grid would show."""
    rng = np.random.default_rng(4)
    field = field_at(room, [Pose2(2.0 + 0.11 * i, 2.5 - 0.07 * i, 0.4 * i) for i in range(8)])
    offsets = []
    for _ in range(40):
        truth = Pose2(rng.uniform(1.5, 2.8), rng.uniform(2.0, 3.0), rng.uniform(-3.0, 3.0))
        found = match_returns(field, returns_of(room.scan(truth, LIDAR)), truth).T_field_base
        offsets.append([found.x - truth.x, found.y - truth.y])
    assert np.abs(np.mean(offsets, axis=0)).max() < 0.002


def test_a_mirrored_scan_draws_the_mirrored_field(room: Any) -> None:
    """What turns walls the same way round in every scan turns a whole map."""
    modern = LidarConfig()
    scan = room.scan(HERE, modern, np.random.default_rng(7))
    beams = np.arange(len(scan.ranges))
    mirrored = LaserScan(scan.ranges[-beams], scan.angles, scan.max_range_m)
    fields = [CorrelationField.around(12.0), CorrelationField.around(12.0)]
    fields[0].draw(HERE, returns_of(scan, modern))
    fields[1].draw(Pose2(HERE.x, -HERE.y, -HERE.theta), returns_of(mirrored, modern))
    apart = fields[0].nodes.astype(int) - fields[1].nodes[::-1].astype(int)
    assert np.abs(apart).max() <= 2


@pytest.mark.parametrize("turn", [0.0, 0.5 * math.pi])
def test_walls_along_the_grid_do_not_draw_the_pose_to_its_nodes(room: Any, turn: float) -> None:
    """Wherever between two rows of nodes a wall lies, the pose is found: an error here is the same
    in every scan of a straight corridor, and bends the map."""
    errors = []
    for step in range(8):
        truth = Pose2(2.0 + 0.4 * RESOLUTION_M * step, 2.5 + 0.3 * RESOLUTION_M * step, turn)
        returns = returns_of(room.scan(truth, LIDAR))
        field = CorrelationField.around(12.0)
        field.draw(truth, returns)
        start = truth @ Pose2(0.011, -0.008, 0.004)
        errors.append(error(match_returns(field, returns, start).T_field_base, truth))
    assert np.max(errors, axis=0)[0] < 0.002
    assert np.max(errors, axis=0)[1] < 0.001


def test_noisy_scans_match_to_a_centimetre(room: Any) -> None:
    lidar = LidarConfig(noise="modern")
    rng = np.random.default_rng(5)
    poses = [Pose2(1.5 + 0.2 * i, 2.5, 0.1 * i) for i in range(10)]
    field = field_at(room, poses, lidar, rng)
    errors = []
    for i in range(30):
        truth = Pose2(1.6 + 0.05 * i, 2.6, 0.5)
        returns = returns_of(room.scan(truth, lidar, rng), lidar)
        found = match_returns(field, returns, truth @ Pose2(0.03, -0.03, 0.01)).T_field_base
        errors.append(error(found, truth))
    metres, radians = np.sqrt(np.mean(np.square(errors), axis=0))
    assert metres < 0.012
    assert radians < 0.004


def test_the_prior_decides_what_the_scan_does_not_hold(corridor: Any) -> None:
    """In a corridor without ends the pose along it is the odometry's, the rest the walls'."""
    lidar = LidarConfig(noise="none", max_range_m=8.0)
    field = field_at(corridor, [Pose2(0.0, 0.0, 0.0), Pose2(1.0, 0.0, 0.0)], lidar)
    truth, prior = Pose2(0.5, 0.0, 0.0), Pose2(0.55, 0.04, 0.01)
    information = np.diag([1e3, 1e3, 1e3])
    match = match_returns(field, returns_of(corridor.scan(truth, lidar), lidar), prior, information)
    assert match.T_field_base.x == pytest.approx(0.55, abs=0.01)
    assert match.T_field_base.y == pytest.approx(0.0, abs=0.005)
    assert match.T_field_base.theta == pytest.approx(0.0, abs=0.002)
    assert match.information[0, 0] < 0.02 * match.information[1, 1]


@pytest.mark.parametrize("fill", [np.nan, np.inf])
def test_a_scan_without_returns_leaves_the_prior(room: Any, fill: float) -> None:
    blind = LaserScan(np.full(LIDAR.beams, fill), beam_angles(LIDAR), LIDAR.max_range_m)
    match = match_returns(field_at(room, [HERE]), returns_of(blind), HERE)
    assert match.T_field_base == HERE
    assert match.reason == "few returns"
    assert not match.converged
    assert not match.information.any()


def test_matching_outside_the_field_is_harmless(room: Any) -> None:
    far = Pose2(500.0, -300.0, 1.0)
    match = match_returns(field_at(room, [HERE]), returns_of(room.scan(HERE, LIDAR)), far)
    assert match.T_field_base == far
    assert match.score == 0.0


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.2, -2.9])
def test_the_search_finds_a_pose_over_all_rotations(room: Any, turn: float) -> None:
    field = field_at(room, [HERE, Pose2(5.5, 2.5, 0.0), Pose2(4.0, 3.0, 0.0)]).cropped()
    truth = Pose2(4.2, 2.1, turn)
    returns = returns_of(room.scan(truth, LIDAR))
    window = Window(Pose2(3.6, 2.7, 0.0), 1.5, math.pi)
    peak = search(Pyramid.of(Blocks.of(field), 1.5), returns.thinned(100), window, 0.3)
    assert peak is not None
    metres, radians = error(peak.pose, truth)
    assert metres < 0.06
    assert radians < 0.02
    # Turned by half, the room differs in its three short walls alone.
    assert peak.runner_up < 0.97 * peak.score
    refined = match_returns(field, returns, peak.pose)
    assert error(refined.T_field_base, truth)[0] < 0.01


def test_the_search_equals_brute_force(room: Any) -> None:
    """Branch and bound may not miss what trying every cell finds."""
    field = field_at(room, [HERE])
    returns = returns_of(room.scan(Pose2(2.3, 2.3, 0.3), LIDAR)).thinned(40)
    centre, half = Pose2(2.0, 2.6, 0.3), 0.6
    peak = search(Pyramid.of(Blocks.of(field), half), returns, Window(centre, half, 0.01), 0.0)
    assert peak is not None
    level = Pyramid.of(Blocks.of(field), half).levels[0]
    best = 0.0
    for angle in rotations(returns.points, Window(centre, half, 0.01)):
        points = Pose2(centre.x, centre.y, angle).apply(returns.points)
        cells = np.floor((points - field.origin) / RESOLUTION_M + 0.5) // NODES_PER_CELL
        for row in range(-6, 7):
            for column in range(-6, 7):
                r = (cells[:, 1] + row).astype(int)
                c = (cells[:, 0] + column).astype(int)
                best = max(best, float(level[r, c].astype(float).sum()))
    assert peak.score == pytest.approx(best / (255.0 * len(returns)))


def test_a_symmetric_place_is_called_ambiguous(square: Any) -> None:
    """In an empty square room a turn by 90° is as good: the runner-up must say so."""
    field = field_at(square, [Pose2(0.0, 0.0, 0.0)])
    returns = returns_of(square.scan(Pose2(0.1, 0.05, 0.0), LIDAR)).thinned(80)
    peak = search(Pyramid.of(Blocks.of(field), 0.5), returns, Window(IDENTITY, 0.5, math.pi), 0.3)
    assert peak is not None
    assert peak.runner_up > 0.9 * peak.score


def test_a_pose_that_is_known_is_not_found_again(room: Any) -> None:
    field = field_at(room, [HERE])
    returns = returns_of(room.scan(HERE, LIDAR)).thinned(80)
    pyramid, window = Pyramid.of(Blocks.of(field), 0.5), Window(HERE, 0.5, 0.3)
    assert search(pyramid, returns, window, 0.3, share=1.0, known=HERE) is None
    away = HERE @ Pose2(0.2, 0.0, 0.0)
    peak = search(pyramid, returns, window, 0.3, share=1.0, known=away)
    assert peak is not None
    assert error(peak.pose, HERE)[0] < 0.05


@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_a_part_of_a_field_is_enough_for_its_window(room: Any, turn: float) -> None:
    """Near the edge of the field too, where a window reaches beyond it."""
    field = field_at(room, [HERE]).cropped()
    returns = returns_of(room.scan(HERE, LIDAR)).thinned(80)
    window = Window(HERE @ Pose2(0.3, -0.2, turn), 0.6, 0.4 + turn)
    whole = search(Pyramid.of(Blocks.of(field), 0.6), returns, window, 0.3)
    part = Pyramid.of(Blocks.under(field, returns.points, window), 0.6)
    assert search(part, returns, window, 0.3) == whole
    assert part.levels[0].size <= Blocks.of(field).maxima.size


def test_thinning_spreads_over_the_weight() -> None:
    values = np.zeros((50, 6))
    values[:, 0] = np.arange(50.0)
    values[:, 4] = np.where(np.arange(50) < 10, 1.0, 0.25)
    few = Returns.unlinked(values).thinned(20)
    # Twenty parts of one weight each: half of them are the ten heavy ones.
    assert few.values[:, 0].tolist() == [*range(10), *range(11, 50, 4)]
    values[:, 4] = 0.5
    assert len(Returns.unlinked(values).thinned(500)) == 50
    values[:, 4] = 0.0
    assert len(Returns.unlinked(values).thinned(20)) == 0
    assert len(Returns.unlinked(values[:0]).thinned(20)) == 0


def test_nothing_to_find_is_none(room: Any) -> None:
    empty = Pyramid.of(Blocks.of(CorrelationField.around(5.0)), 1.0)
    returns = returns_of(room.scan(HERE, LIDAR)).thinned(80)
    assert search(empty, returns, Window(IDENTITY, 1.0, 1.0), 0.3) is None
    nothing = Returns.unlinked(np.empty((0, 6)))
    assert search(empty, nothing, Window(IDENTITY, 1.0, 1.0), 0.3) is None


# A wall with a door in it, as two stretches.
DOOR = (((-3.0, 2.0), (-0.5, 2.0)), ((0.5, 2.0), (3.0, 2.0)))


def wall(start: tuple[float, float], end: tuple[float, float], normal: tuple[float, float]) -> Any:
    """Surfaces (n×6) 5 cm apart."""
    count = round(math.dist(start, end) / 0.05)
    ends = np.array([start, end])
    points = ends[0] + np.linspace(0.0, 1.0, count)[:, None] * (ends[1] - ends[0])
    rest = np.broadcast_to([*normal, 1.0, 0.0], (count, 4))
    return np.ascontiguousarray(np.concatenate([points, rest], axis=1))


def surfaces(*walls: Any) -> Returns:
    return Returns.unlinked(np.concatenate(walls))


def test_the_two_sides_of_a_wall_do_not_draw_a_match() -> None:
    """One robot saw a room, another through its door no more than the end of it, and a partition
    6 cm thick from behind."""
    field, here = CorrelationField.around(8.0), Pose2(0.0, -2.0, 0.0)
    partition = wall((-3.0, 2.0), (3.0, 2.0), (0.0, -1.0))  # as seen from here
    sides = [wall((x, -2.0), (x, 2.0), (-np.sign(x), 0.0)) for x in (-3.0, 3.0)]
    end = wall((-3.0, -2.0), (3.0, -2.0), (0.0, 1.0))
    drawn = surfaces(partition, *sides, end)
    field.draw(here, drawn)
    walls = Walls(drawn.moved(here))
    behind = wall((-3.0, 0.06), (3.0, 0.06), (0.0, 1.0))
    through_the_door = wall((-0.5, -4.0), (0.5, -4.0), (0.0, 1.0))
    jambs = [wall((x, -4.0), (x, -3.0), (-np.sign(x), 0.0)) for x in (-3.0, 3.0)]
    seen = surfaces(behind, through_the_door, *jambs)
    assert match_returns(field, seen, IDENTITY).T_field_base.y < -0.03
    facing = match_facing(field, walls, seen, IDENTITY)
    # Of walls alone, drawn in nodes 25 mm apart; the partition drew it off by 60 mm.
    assert abs(facing.T_field_base.y) < 0.004 and facing.score > 0.8
    assert walls.faced(IDENTITY, seen) < 0.7
    assert walls.faced(IDENTITY, seen, least=len(seen) + 1) == 1.0


def test_a_match_on_the_wrong_side_of_a_wall_finds_the_right_one() -> None:
    """Through a door one robot saw part of the room in which another saw the wall from inside: that
    the ground before it is known to be free does not tell its sides apart."""
    field = CorrelationField.around(8.0)
    outside = [wall(ends, other, (0.0, -1.0)) for ends, other in DOOR]
    end = wall((-0.8, 5.0), (0.8, 5.0), (0.0, -1.0))
    cupboard = wall((0.8, 4.2), (0.8, 5.0), (-1.0, 0.0))
    field.draw(IDENTITY, surfaces(*outside, end, cupboard))
    walls = Walls(surfaces(*outside, end, cupboard))
    inside = [wall((a[0], 2.15), (b[0], 2.15), (0.0, 1.0)) for a, b in DOOR]
    seen = surfaces(*inside, wall((-3.0, 5.0), (3.0, 5.0), (0.0, -1.0)), cupboard)
    wrong = Pose2(0.0, -0.15, 0.0)
    assert match_returns(field, seen, wrong).T_field_base.y < -0.1
    assert abs(match_facing(field, walls, seen, wrong).T_field_base.y) < 0.003


def test_walls_face_who_saw_them() -> None:
    seen = surfaces(wall((0.0, 1.0), (2.0, 1.0), (0.0, -1.0)))
    both = surfaces(seen.values, wall((0.0, 1.05), (2.0, 1.05), (0.0, 1.0)))
    other = surfaces(
        wall((0.0, 1.05), (2.0, 1.05), (0.0, 1.0)), wall((0.0, 3.0), (1.0, 3.0), (0, 1))
    )
    same, behind = Walls(seen).sides(IDENTITY, other)
    assert not same.any() and behind.sum() == 40
    same, behind = Walls(both).sides(IDENTITY, other)
    assert same.sum() == 40 and not behind.any()
    assert Walls(surfaces(np.empty((0, 6)))).faced(IDENTITY, other) == 1.0
