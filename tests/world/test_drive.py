"""Drives: limits, arcs, contacts, and encoders that count what wheels did and not what happened."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from maps.grid import OccupancyGrid
from maps.library import load_map
from protocol.config import BodyConfig
from protocol.pose import FloatArray, Pose2
from world.drive import Drives
from world.noise import Noise
from world.starts import draw_starts
from world.terrain import Terrain

EXACT = BodyConfig(encoder_noise=0.0, slip_rate_hz=0.0, metres_per_count=1e-6)
FIELD = Terrain(OccupancyGrid(np.zeros((400, 400), dtype=np.int8), 0.05, -10.0, -10.0))
TICK_S = 0.1


def drives_at(*starts: tuple[float, float, float], body: BodyConfig = EXACT) -> Drives:
    names = [f"r{i}" for i in range(len(starts))]
    return Drives(FIELD, body, names, np.array(starts))


def run(drives: Drives, command: tuple[float, float], ticks: int, seed: int = 0) -> None:
    noise, commands = Noise(seed), np.tile(command, (len(drives.poses), 1))
    for tick in range(ticks):
        drives.step(commands, tick, TICK_S, noise)


def lowest_gap(terrain: Terrain, point: FloatArray) -> float:
    """The distance from a point to the nearest solid cell (m), by looking at all of them."""
    rows, columns = np.nonzero(terrain.solid)
    x, y = terrain.to_cells(point[:2])
    gap_x = np.maximum(np.maximum(columns - x, x - columns - 1.0), 0.0)
    gap_y = np.maximum(np.maximum(rows - y, y - rows - 1.0), 0.0)
    return float(np.hypot(gap_x, gap_y).min()) * terrain.cell


def test_speed_and_acceleration_stay_within_the_body() -> None:
    drives = drives_at((0.0, 0.0, 0.0))
    seen = []
    for tick in range(20):
        drives.step(np.array([[9.0, -9.0]]), tick, TICK_S, Noise(0))
        seen.append(drives.velocities[0].copy())
    changes = np.diff([[0.0, 0.0], *seen], axis=0)
    assert np.abs(changes[:, 0]).max() <= EXACT.max_acceleration_mps2 * TICK_S + 1e-12
    assert np.abs(changes[:, 1]).max() <= EXACT.max_turn_acceleration_rps2 * TICK_S + 1e-12
    assert seen[-1] == pytest.approx([EXACT.max_speed_mps, -EXACT.max_turn_rate_rps])


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.3, -1.5])
def test_a_tick_is_an_exact_arc(turn: float) -> None:
    drives = drives_at((0.5, -1.0, 2.0))
    run(drives, (0.5, turn), 10)
    before, velocity = Pose2.from_array(drives.poses[0]), drives.velocities[0]
    run(drives, (0.5, turn), 1)
    expected = before @ Pose2.exp(np.array([velocity[0] * TICK_S, 0.0, turn * TICK_S]))
    assert drives.poses[0] == pytest.approx(expected.to_array(), abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 6))
def test_no_command_drives_a_disc_into_anything(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    terrain = Terrain(load_map("rooms-small"))
    body = BodyConfig()
    starts = draw_starts(terrain, rng, count, body.radius_m, np.zeros((0, 2)))
    drives = Drives(terrain, body, [f"r{i}" for i in range(count)], starts)
    commands = np.zeros((count, 2))
    for tick in range(60):
        if tick % 8 == 0:
            commands = rng.uniform(-1.0, 1.0, (count, 2)) * [1.0, 2.0] + [0.3, 0.0]
        drives.step(commands, tick, TICK_S, Noise(seed))
        for i, pose in enumerate(drives.poses):
            assert lowest_gap(terrain, pose) >= body.radius_m - 1e-9
            for other in drives.poses[:i]:
                assert math.hypot(*(other - pose)[:2]) >= 2.0 * body.radius_m - 1e-9


def test_a_robot_stops_at_the_wall_and_its_wheels_go_on() -> None:
    drives = drives_at((9.0, 0.0, 0.0))
    run(drives, (0.6, 0.0), 50)
    assert drives.poses[0] == pytest.approx([10.0 - EXACT.radius_m, 0.0, 0.0], abs=1e-4)
    counted = drives.encoders[0] * EXACT.metres_per_count
    assert counted.min() > 2.0


def test_a_contact_is_one_collision_however_long_it_lasts() -> None:
    drives = drives_at((9.0, 0.0, 0.0))
    run(drives, (0.6, 0.0), 80)
    assert drives.collisions.tolist() == [1]
    run(drives, (-0.6, 0.0), 20)
    run(drives, (0.6, 0.0), 60)
    assert drives.collisions.tolist() == [2]


def test_pushing_again_at_the_same_spot_is_the_same_contact() -> None:
    drives = drives_at((9.0, 0.0, 0.0))
    run(drives, (0.6, 0.0), 40)
    run(drives, (0.0, 0.0), 20)
    run(drives, (0.6, 0.0), 10)
    assert drives.collisions.tolist() == [1]


def test_a_held_robot_turns_on_the_spot_and_gets_away() -> None:
    drives = drives_at((9.0, 0.0, 0.0))
    run(drives, (0.6, 0.0), 40)
    held = drives.poses[0].copy()
    run(drives, (0.0, 1.0), 30)
    assert drives.poses[0, :2] == pytest.approx(held[:2], abs=1e-5)
    assert drives.poses[0, 2] > 2.0
    run(drives, (0.6, 0.0), 20)
    assert math.hypot(*(drives.poses[0] - held)[:2]) > 0.5


def test_robots_stop_at_each_other_and_who_drives_is_counted() -> None:
    drives = drives_at((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    for tick in range(40):
        drives.step(np.array([[0.6, 0.0], [0.0, 0.0]]), tick, TICK_S, Noise(0))
    gap = drives.poses[1, 0] - drives.poses[0, 0]
    assert gap == pytest.approx(2.0 * EXACT.radius_m, abs=1e-4)
    assert drives.collisions.tolist() == [1, 0]
    assert drives.poses[1].tolist() == pytest.approx([1.0, 0.0, 0.0])


def test_exact_encoders_tell_the_exact_motion() -> None:
    drives = drives_at((0.0, 0.0, 0.0))
    run(drives, (0.4, 0.7), 30)
    left, right = drives.encoders[0] * EXACT.metres_per_count
    turned = (right - left) / EXACT.wheel_base_m
    assert turned == pytest.approx(drives.poses[0, 2], abs=1e-4)


def test_encoders_count_in_whole_ticks_of_the_wheel() -> None:
    body = EXACT.model_copy(update={"metres_per_count": 0.0005})
    drives = drives_at((0.0, 0.0, 0.0), body=body)
    run(drives, (0.3, 0.0), 37)
    travelled = drives.poses[0, 0]
    assert (drives.encoders[0] == math.floor(travelled / 0.0005 + 1e-9)).all()


def test_wheels_that_stand_count_nothing() -> None:
    drives = drives_at((0.0, 0.0, 0.0), body=BodyConfig(slip_rate_hz=10.0))
    run(drives, (0.0, 0.0), 50)
    assert drives.encoders.tolist() == [[0, 0]]


def test_encoder_noise_is_a_share_of_each_increment() -> None:
    body = EXACT.model_copy(update={"encoder_noise": 0.03})
    drives = drives_at(*[(x, y, 0.0) for x in range(-8, 4) for y in range(-8, 9)], body=body)
    run(drives, (0.5, 0.0), 20)
    before = drives.encoders
    run(drives, (0.5, 0.0), 1, seed=7)
    steps = (drives.encoders - before) * body.metres_per_count / (0.5 * TICK_S) - 1.0
    count = steps.size
    assert abs(steps.mean()) < 4.0 * 0.03 / math.sqrt(count)
    assert steps.std() == pytest.approx(0.03, rel=4.0 / math.sqrt(2.0 * count))


def test_slips_are_as_frequent_and_as_large_as_told() -> None:
    body = EXACT.model_copy(update={"slip_rate_hz": 0.5, "slip_m": 0.02})
    names = [f"r{i}" for i in range(200)]
    starts = np.array([[-8.0 + 0.5 * (i % 16), -8.0 + i // 16, 0.0] for i in range(200)])
    drives, plain = Drives(FIELD, body, names, starts), Drives(FIELD, EXACT, names, starts)
    commands, ticks = np.tile([0.05, 0.0], (200, 1)), 100
    for tick in range(ticks):
        drives.step(commands, tick, TICK_S, Noise(3))
        plain.step(commands, tick, TICK_S, Noise(3))
    extra = (drives.encoders - plain.encoders) * body.metres_per_count
    # A compound Poisson sum: variance = rate · time · σ².
    variance = body.slip_rate_hz * ticks * TICK_S * body.slip_m**2
    assert extra.std() == pytest.approx(math.sqrt(variance), rel=0.15)
    assert abs(extra.mean()) < 4.0 * math.sqrt(variance / extra.size)
