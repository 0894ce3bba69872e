"""The scenarios that ship: robots can stand where they start, and meet as each file says."""

from pathlib import Path

import numpy as np
import pytest
import yaml

import world
from world.scenario import Scenario
from world.simulation import Simulation

FILES = sorted((Path(world.__file__).parent / "scenarios").glob("*.yaml"))


def simulation(name: str, **changes: object) -> Simulation:
    path = next(path for path in FILES if path.stem == name)
    return Simulation(Scenario.model_validate(yaml.safe_load(path.read_text()) | changes))


def test_the_ways_of_meeting_are_there() -> None:
    wanted = {"apart", "corridor", "office-32", "ring", "rows", "symmetric", "wings"}
    assert {path.stem for path in FILES} == wanted


@pytest.mark.parametrize("name", [path.stem for path in FILES])
def test_robots_start_out_of_earshot_where_they_must_meet(name: str) -> None:
    links = simulation(name).links
    alone = {"wings": 4, "office-32": None}.get(name, 0)
    assert alone is None or links.sum() == alone


def test_robots_apart_can_never_be_in_contact() -> None:
    world = simulation("apart")
    radius = world.scenario.body.radius_m
    left, right = (
        np.argwhere(world.terrain.reachable(radius, start[None])) for start in world.starts
    )
    gap_m = (right[:, 1].min() - left[:, 1].max()) * world.terrain.cell
    assert gap_m > max(world.scenario.radio.range_m, world.scenario.sightings.max_range_m)


def test_symmetric_robots_see_the_same() -> None:
    world = simulation("symmetric", lidar={"noise": "none"})
    first, second = world.step({}).values()
    assert first.ranges is not None and second.ranges is not None
    assert np.allclose(first.ranges, second.ranges, atol=1e-5)


def test_thirty_two_robots_find_room() -> None:
    world = simulation("office-32")
    assert len(world.names) == 32
    assert world.scenario.pace.factor == 0.25
