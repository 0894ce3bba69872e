"""Keyed random numbers: the same key gives the same numbers, another key others."""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from protocol.kernel import kernel
from world import noise_kernels
from world.drive import poisson
from world.noise import LAYERS, Noise

TEAM = tuple(f"r{i}" for i in range(1, 401))


@kernel
def words(key: np.uint64, tick: np.uint64, item: np.uint64, block: np.uint64) -> tuple[int, int]:
    return noise_kernels.philox(key, tick, item, block)  # type: ignore[no-any-return]


def test_the_same_key_gives_the_same_numbers_in_any_order() -> None:
    first, second = Noise(5), Noise(5)
    keys = [("r1", "lidar", 0), ("r1", "lidar", 1), ("r2", "lidar", 0), ("r1", "encoders", 0)]
    drawn = {key: first.at(*key).random(4) for key in keys}
    streamed = {(r, p, t): first.stream((r,), p).uniforms(t, 4) for r, p, t in keys}
    for robot, purpose, tick in reversed(keys):
        key = (robot, purpose, tick)
        assert np.array_equal(second.at(*key).random(4), drawn[key])
        assert np.array_equal(second.stream((robot,), purpose).uniforms(tick, 4), streamed[key])
    for a, b in itertools.combinations([*drawn.values(), *streamed.values()], 2):
        assert not np.intersect1d(a, b).size


def test_a_team_draws_what_each_draws_alone() -> None:
    team = Noise(4).stream(("a", "b", "c"), "lidar").normals(9, 5)
    for row, name in zip(team, ("a", "b", "c"), strict=True):
        assert np.array_equal(Noise(4).stream((name,), "lidar").normals(9, 5)[0], row)


def test_items_have_numbers_of_their_own_whoever_else_is_asked_for() -> None:
    stream = Noise(4).stream(("a", "b"), "sightings")
    some = stream.normals_of(3, np.array([0, 1, 1]), np.array([5, 5, 0]), 2)
    alone = stream.normals_of(3, np.array([1]), np.array([0]), 2)
    assert np.array_equal(some[2], alone[0])
    assert len(np.unique(some)) == some.size


def test_more_numbers_begin_with_the_fewer() -> None:
    stream = Noise(1).stream(TEAM, "lidar")
    assert np.array_equal(stream.normals(2, 514)[:, :7], stream.normals(2, 7))
    assert np.array_equal(stream.uniforms(2, 8)[:, :3], stream.uniforms(2, 3))


def test_seeds_differ() -> None:
    assert not np.array_equal(
        Noise(1).at("r", "x", 0).random(4), Noise(2).at("r", "x", 0).random(4)
    )
    largest = 2**63 - 1
    assert Noise(largest).at("r", "x", 2**53).random() < 1.0
    assert Noise(largest).stream(("r",), "x").uniforms(2**53, 1)[0, 0] < 1.0


def test_numbers_never_change() -> None:
    # A recorded run is replayed with the same noise only as long as these stay as they are.
    drawn = Noise(7).at("r1", "lidar", 3).integers(0, 2**63, 3)
    assert drawn.tolist() == [1239901369672944009, 3216371148366853306, 1006788356355788806]
    streamed = Noise(7).stream(("r1",), "lidar").normals(3, 3)
    assert streamed[0].tolist() == [-0.0017301644126725966, 1.0414440928300637, 0.11163077634301695]


@pytest.mark.parametrize(
    ("key", "counter", "expected"),
    [
        ((0, 0), (0, 0, 0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        (2 * (2**32 - 1,), 4 * (2**32 - 1,), (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0xA4093822, 0x299F31D0),
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_gives_the_published_answers(
    key: tuple[int, ...], counter: tuple[int, ...], expected: tuple[int, ...]
) -> None:
    block, item, low, high = counter
    address = (key[0] | key[1] << 32, low | high << 32, item, block)
    first, second = (int(word) for word in words(*map(np.uint64, address)))
    assert (first % 2**32, first >> 32, second % 2**32, second >> 32) == expected


def test_numbers_are_distributed_as_told() -> None:
    noise = Noise(3)
    normals = noise.stream(TEAM, "lidar").normals(0, 1001).ravel()
    assert stats.kstest(normals, "norm").pvalue > 0.01
    assert abs(stats.kurtosis(normals)) < 5.0 * math.sqrt(24.0 / normals.size)
    uniforms = noise.stream(TEAM, "loss").uniforms(0, 1001).ravel()
    assert stats.kstest(uniforms, "uniform").pvalue > 0.01


def test_the_tail_is_as_heavy_as_it_should_be() -> None:
    noise, edge = Noise(3), 3.6541528853610088
    beyond = np.concatenate(
        [np.abs(noise.stream(TEAM, "x").normals(tick, 1000)).ravel() for tick in range(5)]
    )
    beyond = beyond[beyond > edge]
    expected = 2e6 * math.erfc(edge / math.sqrt(2.0))
    assert abs(len(beyond) - expected) < 5.0 * math.sqrt(expected)
    assert stats.kstest(beyond, stats.truncnorm(edge, np.inf).cdf).pvalue > 0.01


def test_layers_are_of_equal_area() -> None:
    edges = LAYERS[0, 1:] * 2.0**52
    area = edges[1:] * -np.diff(LAYERS[2, 1:])
    assert area == pytest.approx(np.full(254, 0.00492867323399), rel=1e-9)
    assert LAYERS[2, 1:] == pytest.approx(np.exp(-0.5 * edges**2))


def test_streams_of_successive_ticks_do_not_correlate() -> None:
    noise = Noise(11)
    rows = [noise.stream(("r1",), "lidar").normals(tick, 2000)[0] for tick in range(20)]
    correlations = np.asarray(np.corrcoef(rows))[np.triu_indices(20, 1)]
    assert np.abs(correlations).max() < 5.0 / np.sqrt(2000)
    assert abs(np.mean(rows)) < 5.0 / np.sqrt(np.size(rows))


@pytest.mark.parametrize("mean", [0.0, 0.002, 1.5, 80.0])
def test_slips_are_poisson(mean: float) -> None:
    counts = poisson(np.random.default_rng(1).random(20000), mean)
    assert abs(counts.mean() - mean) <= 5.0 * math.sqrt(mean / 20000)
    assert counts.var() == pytest.approx(mean, rel=0.1, abs=5e-3)
    exact = stats.poisson(mean).ppf(np.linspace(0.01, 0.99, 50))
    assert poisson(np.linspace(0.01, 0.99, 50), mean).tolist() == exact.tolist()


def test_the_largest_number_below_one_ends_the_count() -> None:
    assert np.isfinite(poisson(np.array([np.nextafter(1.0, 0.0)]), 100.0)).all()
