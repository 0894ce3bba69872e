"""Keyed random numbers: the same key gives the same numbers, another key others."""

import itertools

import numpy as np

from world.noise import Noise


def test_the_same_key_gives_the_same_numbers_in_any_order() -> None:
    first, second = Noise(5), Noise(5)
    keys = [("r1", "lidar", 0), ("r1", "lidar", 1), ("r2", "lidar", 0), ("r1", "encoders", 0)]
    drawn = {key: first.at(*key).random(4) for key in keys}
    for key in reversed(keys):
        assert np.array_equal(second.at(*key).random(4), drawn[key])
    for a, b in itertools.combinations(drawn.values(), 2):
        assert not np.intersect1d(a, b).size


def test_seeds_differ() -> None:
    assert not np.array_equal(
        Noise(1).at("r", "x", 0).random(4), Noise(2).at("r", "x", 0).random(4)
    )
    largest = 2**63 - 1
    assert Noise(largest).at("r", "x", 2**53).random() < 1.0


def test_numbers_never_change() -> None:
    # A recorded run is replayed with the same noise only as long as these stay as they are.
    drawn = Noise(7).at("r1", "lidar", 3).integers(0, 2**63, 3)
    assert drawn.tolist() == [1239901369672944009, 3216371148366853306, 1006788356355788806]


def test_streams_of_successive_ticks_do_not_correlate() -> None:
    noise = Noise(11)
    rows = np.stack([noise.at("r1", "lidar", tick).standard_normal(2000) for tick in range(20)])
    correlations = np.asarray(np.corrcoef(rows))[np.triu_indices(20, 1)]
    assert np.abs(correlations).max() < 5.0 / np.sqrt(2000)
    assert abs(rows.mean()) < 5.0 / np.sqrt(rows.size)
