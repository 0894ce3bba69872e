"""The map that a run leaves: a robot finds its place in it, and groups are kept apart."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from robot.slam.saved_map import SavedMap
from station.known_maps import read_known_map
from station.launch import launch
from station.observer import RunOutcome
from station.report_maps import write_saved_maps
from studies.localisation import locate
from world.scenario import RobotSpec, Scenario


@pytest.fixture(scope="module")
def run() -> RunOutcome:
    """Two robots in small rooms, for long enough that they have seen most."""
    robots = (RobotSpec(name="r1"), RobotSpec(name="r2"))
    scenario = Scenario(map="rooms-small", seed=3, robots=robots, max_sim_s=40.0, starts="known")
    return launch(scenario, "inline")


def write(outcome: RunOutcome, folder: Path) -> Path:
    for name in outcome.robots:
        (folder / name).mkdir()
    write_saved_maps(outcome, folder)
    return folder


def test_a_robot_finds_its_place_in_the_map_of_a_run(run: RunOutcome, tmp_path: Path) -> None:
    known = read_known_map(write(run, tmp_path) / "map.earshot")
    terrain, history = run.simulation.terrain, run.simulation.history
    for tick in (0, len(history) // 2):
        # Known starts: the frame of the team is that of the world.
        found = locate(terrain, known, np.array(history.poses[tick, 0]), 5.0, seed=tick)
        assert found["verdict"] == "right"


def test_robots_that_share_a_frame_share_a_map(run: RunOutcome, tmp_path: Path) -> None:
    folder = write(run, tmp_path)
    assert sorted(path.name for path in folder.rglob("*.earshot")) == ["map.earshot"] * 3
    one, other, both = (
        SavedMap.decode((folder / place / "map.earshot").read_bytes()) for place in ("r1", "r2", "")
    )
    assert len(both.submaps) == len(one.submaps) + len(other.submaps)
    assert len(both.graph.edge_nodes) == len(one.graph.edge_nodes) + len(other.graph.edge_nodes)
    nodes = len(one.graph.nodes)
    np.testing.assert_array_equal(both.graph.nodes[nodes:], other.graph.nodes)
    assert both.submaps[len(one.submaps)].index == nodes + other.submaps[0].index


def test_a_group_by_itself_has_a_map_by_itself(run: RunOutcome, tmp_path: Path) -> None:
    robots = dict(run.robots)
    trajectory = robots["r2"].trajectory
    assert trajectory is not None
    apart = trajectory.model_copy(update={"frame": "r2.0"})
    robots["r2"] = dataclasses.replace(robots["r2"], trajectory=apart)
    folder = write(dataclasses.replace(run, robots=robots), tmp_path)
    for group, robot in (("map.earshot", "r1"), ("map-r2.earshot", "r2")):
        assert (folder / group).read_bytes() == (folder / robot / "map.earshot").read_bytes()


def test_what_is_no_map_is_left_out(run: RunOutcome, tmp_path: Path) -> None:
    robots = dict(run.robots)
    reply = robots["r1"].map
    assert reply is not None
    damaged = reply.model_copy(update={"saved": reply.saved[:-7]})
    robots["r1"] = dataclasses.replace(robots["r1"], map=damaged)
    robots["r2"] = dataclasses.replace(robots["r2"], map=None)
    folder = write(dataclasses.replace(run, robots=robots), tmp_path)
    assert not list(folder.rglob("*.earshot"))
