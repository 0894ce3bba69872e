"""A saved map comes back as it was, and what is no saved map is refused."""

import zlib
from typing import Any

import msgpack
import numpy as np
import pytest

from protocol.pose import Pose2
from robot.jobs import Jobs
from robot.slam.dead_reckoning import DeadReckoning
from robot.slam.graph import GraphSlam
from robot.slam.saved_map import SavedMap, SavedMapError


@pytest.fixture(scope="module")
def saved(lap: Any) -> SavedMap:
    engine = GraphSlam(lap.lidar, lap.body, Pose2.from_array(lap.truth[0]), Jobs())
    for tick, (motion, scan) in enumerate(zip(lap.motions[:150], lap.scans[:150], strict=True)):
        engine.step(tick, motion, scan)
    assert len(engine.submaps) >= 1
    saved = SavedMap.of(engine)
    # The submap that is being filled is part of it, and goes on being filled.
    assert len(saved.submaps) == len(engine.submaps) + 1
    engine.step(150, lap.motions[150], lap.scans[150])
    return saved


def test_it_comes_back_with_the_same_hash_and_bytes(saved: SavedMap) -> None:
    data = saved.encode()
    back = SavedMap.decode(data)
    assert back.digest() == saved.digest()
    assert back.encode() == data
    assert np.array_equal(back.graph.nodes, saved.graph.nodes)
    for ours, theirs in zip(saved.submaps, back.submaps, strict=True):
        assert np.array_equal(ours.unpack().field.nodes, theirs.unpack().field.nodes)
        assert ours.index == theirs.index


def test_the_hash_is_of_the_content(saved: SavedMap) -> None:
    fields = msgpack.unpackb(saved.encode())
    walls = fields["submaps"][0]["walls"]
    walls[2] = zlib.compress(zlib.decompress(walls[2]), 9)
    assert SavedMap.decode(msgpack.packb(fields)).digest() == saved.digest()
    grid = bytearray(zlib.decompress(walls[2]))
    grid[len(grid) // 2] ^= 1
    walls[2] = zlib.compress(bytes(grid))
    assert SavedMap.decode(msgpack.packb(fields)).digest() != saved.digest()


def test_an_engine_that_maps_nothing_has_no_submaps(lap: Any) -> None:
    engine = DeadReckoning(lap.lidar, lap.body, Pose2(0.0, 0.0, 0.0), Jobs())
    assert SavedMap.decode(SavedMap.of(engine).encode()).submaps == ()


def _changed(saved: SavedMap, **changes: Any) -> bytes:
    fields = msgpack.unpackb(saved.encode())
    for name, value in changes.items():
        target = fields if name in fields else fields["submaps"][0]
        target[name] = value
    data: bytes = msgpack.packb(fields)
    return data


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "the field format"),
        ({"version": 2}, "version 2; this is for version 1"),
        ({"nodes": b"1234567"}, "damaged"),
        ({"nodes": np.full(6, np.nan).tobytes()}, "not finite"),
        ({"nodes": np.zeros(3).tobytes()}, "not there|without its anchor"),
        ({"edge_nodes": np.array([0, 9999], dtype="<i4").tobytes()}, "differ in number"),
        ({"submaps": 3}, "expected a list"),
        ({"submaps": [3]}, "no map of fields"),
        ({"index": -1}, "out of bounds"),
        ({"travel_m": "far"}, "damaged"),
        ({"keyframes": b""}, "without keyframes"),
        ({"origin": np.zeros(3).tobytes()}, "not x, y"),
        ({"walls": [3, 3, b"no zlib"]}, "damaged"),
        ({"walls": [1 << 20, 1 << 20, b""]}, "a grid of 1048576"),
        ({"walls": [10, 10, zlib.compress(bytes(10_000_000))]}, "does not hold 10 × 10"),
    ],
)
def test_what_is_wrong_is_refused(saved: SavedMap, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(SavedMapError, match=message):
        SavedMap.decode(_changed(saved, **changes))


def test_no_bytes_do_harm(saved: SavedMap) -> None:
    data, rng = saved.encode(), np.random.default_rng(2)
    for number in range(150):
        damaged = bytearray(data)
        for at in rng.integers(0, 2000 if number % 2 else len(data), 5):
            damaged[at] = rng.integers(256)
        if number % 3 == 0:
            damaged = damaged[: rng.integers(len(data))]
        try:
            SavedMap.decode(bytes(damaged)).digest()
        except SavedMapError as error:
            assert "\n" not in str(error)
