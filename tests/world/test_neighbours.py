"""Who is near whom: what looking at all pairs gives."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from world.neighbour_kernels import neighbours


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 60),
    spread=st.sampled_from([0.5, 30.0, 4000.0]),
    reach=st.sampled_from([0.0, 0.1, 4.0, 25.0, 1e4]),
)
def test_it_is_what_all_pairs_give(seed: int, count: int, spread: float, reach: float) -> None:
    points = np.random.default_rng(seed).uniform(-spread, spread, (count, 3))
    starts, others = neighbours(points, reach)
    assert starts[0] == 0 and starts[-1] == len(others)
    for i in range(count):
        apart = np.hypot(*(points[:, :2] - points[i, :2]).T)
        near = set(np.flatnonzero(apart <= reach).tolist()) - {i}
        found = others[starts[i] : starts[i + 1]].tolist()
        assert sorted(found) == sorted(near)


def test_robots_in_a_line_at_the_very_reach_are_neighbours() -> None:
    points = np.column_stack([np.arange(50.0), np.zeros(50)])
    starts, _ = neighbours(points, 1.0)
    assert np.diff(starts).tolist() == [1] + 48 * [2] + [1]


def test_more_neighbours_than_room_was_made_for() -> None:
    starts, others = neighbours(np.zeros((40, 2)), 0.0)
    assert len(others) == 40 * 39
    assert np.diff(starts).tolist() == 40 * [39]


def test_a_short_reach_on_a_large_map_costs_no_memory() -> None:
    points = np.array([[0.0, 0.0], [1e9, 1e9], [1e9, 1e9 + 1.0]])
    _, others = neighbours(points, 2.0)
    assert others.tolist() == [2, 1]
