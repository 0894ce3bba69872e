"""Finished submaps are kept compressed, and come back as they were."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from protocol.pose import Pose2
from protocol.state import dump_state, load_state
from robot.perception.returns import describe_returns, noise_model
from robot.slam.candidates import UNPACKED, CandidateFinder
from robot.slam.config import ClosureConfig
from robot.slam.packed_submap import PackedSubmap
from robot.slam.submap import Submap


@pytest.fixture(scope="module")
def submap(lap: Any) -> Submap:
    """Some scans of the drive, finished."""
    filling, start = Submap.start(7, 20.0), Pose2.from_array(lap.truth[0])
    for k in range(0, 60, 3):
        returns = describe_returns(lap.scans[k], noise_model(lap.lidar), 20.0)
        filling.insert(start.inverse() @ Pose2.from_array(lap.truth[k]), returns)
    filling.finish()
    return filling


def test_a_submap_comes_back_to_the_last_bit(submap: Submap) -> None:
    packed = load_state(dump_state(PackedSubmap.of(submap)), PackedSubmap)
    assert dump_state(packed.unpack()) == dump_state(submap)
    assert packed.unpack().field.nodes.flags.writeable  # one signature for each kernel


def test_it_takes_a_fraction_of_the_memory(submap: Submap) -> None:
    packed = PackedSubmap.of(submap)
    grids = submap.field.nodes.nbytes + submap.field.free.nbytes
    packed_grids = (packed.nodes, packed.free)
    assert sum(len(grid.marks) + len(grid.runs) for grid in packed_grids) < 0.2 * grids


def test_few_stay_unpacked(submap: Submap) -> None:
    """However many are looked at, those looked at last are there as they were, and no others."""
    finder, nodes = CandidateFinder(ClosureConfig()), np.zeros((2 * UNPACKED, 3))
    for index in range(2 * UNPACKED):
        finder.add(dataclasses.replace(submap, index=index))
    here = Pose2(0.0, 0.0, 0.0)
    first = finder.others(-1, here, nodes, 1.0, UNPACKED)
    again = finder.others(-1, here, nodes, 1.0, UNPACKED)
    assert all(a.submap is b.submap for a, b in zip(first, again, strict=True))
    every = finder.others(-1, here, nodes, 1.0, 2 * UNPACKED)
    assert [c.submap.index for c in every] == list(range(2 * UNPACKED))
    last = finder.others(UNPACKED, here, nodes, 1.0, 2)
    assert last[0].submap is not first[0].submap
    assert len(dump_state(finder)) < 1.5 * len(dump_state(every[:UNPACKED]))
