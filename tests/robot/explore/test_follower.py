"""The follower: it touches nothing, wherever obstacles are, and gets where the path leads."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.config import BodyConfig
from protocol.pose import IDENTITY, FloatArray, Pose2
from robot.explore.follower import NEAR_M, Follower
from robot.explore.follower_kernels import best_velocity, steady_points
from robot.explore.planner import NO_PATH

BODY = BodyConfig()
DT = 0.1
NOBODY = np.empty((0, 2))


class Body:
    """A drive that does what it is told within its limits, as the world's does."""

    def __init__(self, pose: Pose2) -> None:
        self.pose, self.speed = pose, (0.0, 0.0)

    def move(self, forward: float, turn: float) -> None:
        a, b = BODY.max_acceleration_mps2 * DT, BODY.max_turn_acceleration_rps2 * DT
        v = self.speed[0] + min(max(forward - self.speed[0], -a), a)
        w = self.speed[1] + min(max(turn - self.speed[1], -b), b)
        self.speed = (v, w)
        self.pose = self.pose @ Pose2.exp(np.array([v * DT, 0.0, w * DT]))

    def near(self, obstacles: FloatArray) -> FloatArray:
        points = self.pose.inverse().apply(obstacles)
        inside: FloatArray = points[np.hypot(*points.T) < NEAR_M]
        return inside


def _line(*points: tuple[float, float]) -> FloatArray:
    pieces = [
        np.linspace(a, b, max(2, round(math.dist(a, b) / 0.1) + 1)) for a, b in pairwise(points)
    ]
    return np.concatenate(pieces)


def _follow(
    path: FloatArray, start: Pose2, obstacles: FloatArray, ticks: int
) -> tuple[Follower, list[Pose2], FloatArray]:
    follower, body = Follower(BODY), Body(start)
    follower.follow(path)
    poses, commands = [start], []
    for _ in range(ticks):
        command = follower.step(body.pose, body.near(obstacles), NOBODY, body.speed, DT)
        body.move(command.forward_mps, command.turn_rps)
        poses.append(body.pose)
        commands.append((command.forward_mps, command.turn_rps))
    return follower, poses, np.array(commands)


def test_in_the_open_it_reaches_full_speed_and_stops_at_the_end() -> None:
    path = _line((0.0, 0.0), (4.0, 0.0), (4.0, 3.0))
    follower, poses, commands = _follow(path, Pose2(0.0, 0.0, 0.0), NOBODY, 160)
    assert commands[:, 0].max() == pytest.approx(BODY.max_speed_mps)
    assert follower.arrived
    assert np.hypot(poses[-1].x - 4.0, poses[-1].y - 3.0) < 0.25
    assert np.all(commands[-5:] == 0.0)
    away = [np.hypot(*(path - [p.x, p.y]).T).min() for p in poses]
    assert max(away) < 0.25


def test_commands_are_smooth_along_a_bend() -> None:
    angles = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 60)
    path = np.stack([2.0 * np.cos(angles), 2.0 + 2.0 * np.sin(angles)], axis=-1)
    _, _, commands = _follow(path, Pose2(0.0, 0.0, 0.0), NOBODY, 120)
    driving = commands[15:100]
    assert np.abs(np.diff(driving[:, 0])).max() <= BODY.max_acceleration_mps2 * DT + 1e-9
    assert np.abs(np.diff(driving[:, 1])).max() <= 0.25
    # No weaving: the turn rate of a bend to the left never changes sides.
    assert driving[:, 1].min() > -0.05


def test_with_the_path_behind_it_turns_on_the_spot() -> None:
    _, poses, commands = _follow(_line((0.0, 0.0), (-3.0, 0.0)), Pose2(0, 0, 0), NOBODY, 20)
    assert np.abs(commands[:12, 0]).max() < 0.05
    assert abs(math.remainder(poses[-1].theta - math.pi, math.tau)) < 0.5


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_it_never_touches_anything(seed: int) -> None:
    """Paths are straight through whatever stands there; the robot must stop or get round."""
    rng = np.random.default_rng(seed)
    obstacles = rng.uniform([0.0, -2.0], [6.0, 2.0], (30, 2))
    obstacles = obstacles[np.hypot(*obstacles.T) > BODY.radius_m + 0.02]
    start = Pose2(0.0, 0.0, float(rng.uniform(-math.pi, math.pi)))
    _, poses, _ = _follow(_line((0.0, 0.0), (6.0, 0.0)), start, obstacles, 120)
    for pose in poses:
        assert np.hypot(*(obstacles - [pose.x, pose.y]).T).min() > BODY.radius_m


@settings(max_examples=40, deadline=None)
@given(st.floats(1.0, 3.0), st.floats(-0.4, 0.4), st.floats(-math.pi, math.pi), st.floats(0.0, 1.2))
def test_two_robots_never_touch_each_other(
    gap: float, aside: float, heading: float, delay: float
) -> None:
    """Both drive to where the other is, one some time after the other."""
    bodies = [Body(Pose2(0.0, 0.0, 0.0)), Body(Pose2(gap, aside, heading))]
    followers = [Follower(BODY), Follower(BODY)]
    followers[0].follow(_line((0.0, 0.0), (gap + 2.0, aside)))
    for tick in range(80):
        if tick == round(delay / DT):
            followers[1].follow(_line((gap, aside), (-2.0, 0.0)))
        commands = []
        for me, mate in ((0, 1), (1, 0)):
            where = np.array([[bodies[mate].pose.x, bodies[mate].pose.y]])
            seen = bodies[me].pose.inverse().apply(where)
            commands.append(followers[me].step(bodies[me].pose, NOBODY, seen, bodies[me].speed, DT))
        for body, command in zip(bodies, commands, strict=True):
            body.move(command.forward_mps, command.turn_rps)
        assert bodies[0].pose.distance_to(bodies[1].pose) > 2.0 * BODY.radius_m


def test_a_wall_too_near_is_left_and_never_approached() -> None:
    """A scan may say that the robot is nearer to a wall than it may be."""
    wall = np.stack([np.linspace(-1.0, 3.0, 200), np.full(200, -0.205)], axis=-1)
    _, poses, _ = _follow(_line((0.0, 0.0), (0.5, 0.3), (3.0, 0.3)), Pose2(0, 0, 0), wall, 100)
    assert min(p.y for p in poses) > -0.005
    assert poses[-1].x > 2.0


def test_standing_it_stands() -> None:
    follower = Follower(BODY)
    follower.follow(NO_PATH)
    command = follower.step(Pose2(0, 0, 0), NOBODY, NOBODY, (0.0, 0.0), DT)
    assert (command.forward_mps, command.turn_rps) == (0.0, 0.0)
    moving = follower.step(Pose2(0, 0, 0), NOBODY, NOBODY, (0.5, 0.0), DT)
    assert moving.forward_mps < 0.5


def test_backing_up_stops_before_a_wall() -> None:
    wall = np.stack([np.full(100, -0.6), np.linspace(-1.0, 1.0, 100)], axis=-1)
    follower, body = Follower(BODY), Body(Pose2(0.0, 0.0, 0.0))
    for _ in range(60):
        command = follower.drive((-0.15, 0.0), body.near(wall), NOBODY, body.speed, DT)
        body.move(command.forward_mps, command.turn_rps)
    assert -0.4 < body.pose.x < -0.3


def test_neighbouring_beams_steady_each_other_close_by_only() -> None:
    rng = np.random.default_rng(2)
    angles = np.linspace(-0.5, 0.5, 41)
    ranges = 0.3 + rng.normal(0.0, 0.01, 41)
    ranges[[3, 9]] = np.nan, np.inf
    points = steady_points(ranges, angles, NEAR_M, 0.015, 0.06)
    found = np.hypot(*points.T)
    assert found.min() > ranges[np.isfinite(ranges)].min()
    assert np.abs(found - 0.3).max() < 0.02
    pole = np.full(41, np.inf)
    pole[20] = 1.0
    points = steady_points(pole, angles, NEAR_M, 0.015, 0.06)
    np.testing.assert_allclose(points, [[1.0, 0.0]], atol=1e-12)


def test_an_edge_is_where_its_own_beams_end() -> None:
    angles = np.linspace(-0.5, 0.5, 41)
    ranges = np.where(angles < 0.0, 0.25, 2.0)  # the wall ends straight ahead
    points = steady_points(ranges, angles, NEAR_M, 0.015, 0.06)
    np.testing.assert_allclose(np.hypot(*points.T), 0.25, atol=1e-12)
    last = angles[angles < 0.0].max()
    assert abs(math.atan2(points[-1, 1], points[-1, 0]) - last) * 0.25 < 0.03


def test_a_corner_that_points_at_the_robot_keeps_its_tip() -> None:
    angles = np.linspace(-0.5, 0.5, 41)
    ranges = 0.25 + 0.2 * np.abs(angles)
    points = steady_points(ranges, angles, NEAR_M, 0.0, 0.06)
    assert np.hypot(*points.T).min() == pytest.approx(0.25)


def test_braking_in_a_bend_stays_on_its_arc() -> None:
    """Nothing is safe any more: the turn fades with the speed, as the arc needs it to."""
    ring = np.linspace(-math.pi, math.pi, 60)
    walls = 0.23 * np.stack([np.cos(ring), np.sin(ring)], axis=-1)
    follower, speed = Follower(BODY), (0.5, 1.0)
    follower.follow(_line((0.0, 0.0), (3.0, 0.0)))
    for _ in range(3):
        command = follower.step(Pose2(0, 0, 0), walls, NOBODY, speed, DT)
        assert command.forward_mps == pytest.approx(speed[0] - BODY.max_acceleration_mps2 * DT)
        assert command.turn_rps / command.forward_mps == pytest.approx(2.0)
        speed = (command.forward_mps, command.turn_rps)
    assert follower.step(Pose2(0, 0, 0), walls, NOBODY, (0.1, 0.2), DT).forward_mps == 0.0


def test_boxed_in_it_says_that_nothing_is_safe() -> None:
    ring = np.linspace(-math.pi, math.pi, 60)
    obstacles = np.stack(
        [0.25 * np.cos(ring), 0.25 * np.sin(ring), np.full(60, 0.2), np.full(60, 0.2)], axis=-1
    )
    speeds, turns = np.array([0.4, 0.5]), np.array([0.0])
    forward, turn, safe = best_velocity(
        obstacles, speeds, turns, 0.5, 0.0, 1.0, 0.0, 0.6, 1.5, 1.0, DT, 0.01, 0.07, 1.2, 0.25
    )
    assert (forward, turn, safe) == (0.0, 0.0, False)


def test_the_tightest_spot_ahead_is_where_the_scan_comes_nearest_to_the_path() -> None:
    follower = Follower(BodyConfig())
    follower.follow(_line((0.0, 0.0), (3.0, 0.0)))
    posts = np.array([[0.6, 0.21], [0.6, -0.21], [0.0, 0.1], [1.5, 0.0]])
    assert follower.tightest(IDENTITY, posts) == pytest.approx((0.6, 0.0))
    assert follower.tightest(IDENTITY, np.empty((0, 2))) == pytest.approx((0.25, 0.0))
