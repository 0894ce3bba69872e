"""Checkpoints: what comes back is what went in, and strangers' bytes run no code."""

from collections import deque
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
import pytest

from protocol.config import RobotConfig
from protocol.pose import Pose2
from protocol.state import StateError, adopt_state, dump_state, load_state
from robot.jobs import Jobs
from robot.team.journal import EntryName, LogName


def test_values_survive() -> None:
    value: dict[Any, Any] = {
        "numbers": [1, 2.5, True, None, 2**80, -(2**70)],
        ("a", 1): np.arange(6, dtype=np.int16).reshape(2, 3),
        "name": EntryName(LogName("r1", 0), 4),
        "pose": Pose2(1.0, 2.0, 3.0),
        "queue": deque([1, 2], maxlen=5),
        "set": {3, 1, 2},
        "scalar": np.float64(0.1),
        "config": RobotConfig(name="r1", team=("r1", "r2")),
        b"bytes": b"\x00\xff",
    }
    back = load_state(dump_state(value), dict)
    assert list(back) == list(value)
    assert back["numbers"] == value["numbers"]
    assert np.array_equal(back["a", 1], value["a", 1])
    assert back["a", 1].dtype == np.int16
    for key in ("name", "pose", "set", "scalar", "config", b"bytes"):
        assert back[key] == value[key]
        assert type(back[key]) is type(value[key])
    assert back["queue"].maxlen == 5


def test_shared_references_stay_shared() -> None:
    shared = [1]
    holder: dict[str, Any] = {"a": shared, "b": shared, "poses": (Pose2(0, 0, 0),) * 2}
    holder["self"] = holder
    back = load_state(dump_state(holder), dict)
    assert back["a"] is back["b"]
    assert back["self"] is back


def test_transient_attributes_are_kept_by_the_target() -> None:
    class Executor:
        pass

    jobs = Jobs()
    jobs.start("sum", 3, 2, sum, [1, 2])
    data = dump_state(jobs)
    target: Any = Jobs()
    target.executor = Executor()
    adopt_state(target, data)
    assert isinstance(target.executor, Executor)
    assert target.landed("sum", 4) == []
    assert target.landed("sum", 5) == [3]


@dataclass
class Foreign:
    x: int = 1


def test_foreign_objects_are_refused() -> None:
    with pytest.raises(StateError, match="cannot be stored"):
        dump_state([Foreign()])
    with pytest.raises(StateError, match="cannot be stored"):
        dump_state({"f": print})


@pytest.mark.parametrize(
    "packed",
    [
        ["o", "subprocess:Popen", {"args": "true"}],
        ["e", "os:environ", "PATH"],
        ["o", "protocol.pose:wrap_angle", {}],
        ["@", 7],
        ["?", 1],
        ["a", "<f8", [3], b"\x00", True],
        [],
    ],
)
def test_damaged_checkpoints_are_refused(packed: list[Any]) -> None:
    with pytest.raises(StateError, match="checkpoint"):
        load_state(msgpack.packb(packed), object)
