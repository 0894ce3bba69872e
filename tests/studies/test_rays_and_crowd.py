"""The benchmarks of the world measure what they say, and their check would find a fault."""

from typing import Any

import pytest

from maps.building import BuildingConfig
from maps.library import load_map
from studies import crowd, gate, rays
from world import ray_kernels


def test_no_beam_differs_from_the_walk() -> None:
    found = rays.measure(load_map("office"), poses=50, rounds=1, seed=0)
    assert found["beams"] == 50 * rays.BEAMS
    assert found["beams_that_differ"] == 0
    assert found["ratio"] == found["earshot_mbeams_per_s"] / found["plain_walk_mbeams_per_s"]


def test_a_caster_that_is_off_by_a_cell_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = ray_kernels.cast_rays

    def off(*arguments: Any) -> None:
        exact(*arguments)
        arguments[-1][0] += 1.0

    monkeypatch.setattr(ray_kernels, "cast_rays", off)
    found = rays.measure(load_map("office"), poses=10, rounds=1, seed=0)
    assert 0 < found["beams_that_differ"] <= 10


def test_the_window_has_its_size_on_small_and_large_maps() -> None:
    for name in ("rooms-small", "office"):
        grid = load_map(name)
        found = rays.window(grid)
        assert found.cells.shape == (rays.SIDE, rays.SIDE)
        assert found.free.sum() == grid.free.sum()


def test_a_crowd_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crowd, "BUILDING", BuildingConfig(seed=4))
    found = crowd.measure(robots=12, ticks=20, seed=1)
    assert found["share_of_robots_that_drove"] == 1.0
    assert found["mean_speed_mps"] > 0.1
    assert found["tick_ms_p99"] >= found["tick_ms_median"] > 0.0


@pytest.mark.parametrize("model", ["disc", "line-of-sight", "shadowing"])
def test_the_load_is_delivered_to_all_in_range(model: str) -> None:
    found = gate.load(ticks=3, seed=0, model=model)
    pairs = gate.LOAD_ROBOTS * (gate.LOAD_ROBOTS - 1)
    assert 0.95 * pairs < found["delivered_per_tick"] <= pairs
    assert model == "shadowing" or found["delivered_per_tick"] == pairs
