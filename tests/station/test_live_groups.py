"""What is shown as one map is what both robots say is one, drawn where their frames truly lie."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from maps.grid import OccupancyGrid
from protocol.config import PoseModel
from protocol.messages import Action, Report, TeammateView
from protocol.pose import Pose2
from station.live_groups import groups_of, pairs_of, standing_of
from station.live_panel import Panel, bgr
from station.live_picture import LivePicture
from station.pictures import WALL_COLOUR
from world.frames import frame_of
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

STARTS = ((0.0, 2.0, 0.0), (6.0, 2.2, 3.0), (3.0, 1.0, 1.0))
NAMES = ("r1", "r2", "r3")


def room() -> OccupancyGrid:
    cells = np.zeros((100, 160), dtype=np.int8)
    cells[:2] = cells[-2:] = 100
    cells[:, :2] = cells[:, -2:] = 100
    return OccupancyGrid(cells, 0.05, -1.0, -0.5)


def simulation(starts: str = "unknown") -> Simulation:
    robots = tuple(
        RobotSpec(name=name, start=PoseModel(x_m=x, y_m=y, theta_rad=theta))
        for name, (x, y, theta) in zip(NAMES, STARTS, strict=True)
    )
    scenario = Scenario.model_validate({"map": "room", "robots": robots, "starts": starts})
    return Simulation(scenario, room())


def report(said: dict[str, str]) -> Report:
    """A report that says of each teammate how the maps stand."""
    return Report(
        tick=0,
        pose=PoseModel(x_m=0.0, y_m=0.0, theta_rad=0.0),
        covariance=np.eye(3),
        activity="",
        path=np.zeros((0, 2)),
        known_m2=0.0,
        frontier_m=0.0,
        finished=False,
        team=tuple(
            TeammateView.model_validate(
                {
                    "robot": name,
                    "in_range": False,
                    "last_heard_tick": -1,
                    "entries": 0,
                    "alignment": state,
                    "alignment_reason": f"as told of {name}",
                }
            )
            for name, state in said.items()
        ),
        loop_closures=0,
        journal_entries=0,
    )


def test_the_lesser_word_counts() -> None:
    world = simulation()
    reports = {
        "r1": report({"r2": "aligned", "r3": "tentative"}),
        "r2": report({"r1": "aligned", "r3": "aligned"}),
        "r3": report({"r1": "contradictory", "r2": "unknown"}),
    }
    found = {(pair.a, pair.b): (pair.state, pair.reason) for pair in pairs_of(world, reports)}
    assert found == {
        ("r1", "r2"): ("aligned", "as told of r2"),
        ("r1", "r3"): ("contradictory", "as told of r1"),
        ("r2", "r3"): ("unknown", "as told of r2"),
    }
    assert groups_of(world, reports) == (("r1", "r2"), ("r3",))
    assert standing_of(("r1", "r2"), world, reports) == "r1 r2: one map"
    assert standing_of(("r3",), world, reports).startswith("r3: contradictory with r1")


def test_before_anybody_spoke_everybody_is_alone() -> None:
    world = simulation()
    assert groups_of(world, {}) == (("r1",), ("r2",), ("r3",))
    assert {pair.state for pair in pairs_of(world, {})} == {"unknown"}


@pytest.mark.parametrize("starts", ["known", "same"])
def test_who_was_told_shares_a_frame_from_the_beginning(starts: str) -> None:
    world = simulation(starts)
    assert groups_of(world, {}) == (NAMES,)
    assert pairs_of(world, {}) == ()


def test_frames_lie_where_the_robots_began() -> None:
    for starts, wanted in (
        ("known", [Pose2(0.0, 0.0, 0.0)] * 3),
        ("same", [Pose2(*STARTS[0])] * 3),
        ("unknown", [Pose2(*start) for start in STARTS]),
    ):
        world = simulation(starts)
        assert [frame_of(world, name) for name in NAMES] == wanted


def test_who_came_back_thinks_in_the_frame_of_where_it_stood() -> None:
    """And shares a map with those who were told where they are only when both say so."""
    world, told = simulation("known"), Pose2(0.0, 0.0, 0.0)
    world.step({})
    for tick in range(3):
        world.mark_dead("r2") if tick == 1 else world.mark_alive("r2")
        world.step({name: Action(tick=world.tick) for name in world.alive})
        if tick == 1:  # dead: what it said last was still in the frame that it was told
            assert frame_of(world, "r2") == told
            assert groups_of(world, {}) == (NAMES,)
    assert frame_of(world, "r2") == Pose2.from_array(world.poses[1])
    assert frame_of(world, "r1") == told
    assert groups_of(world, {}) == (("r1", "r3"), ("r2",))
    aligned = {name: report(dict.fromkeys(NAMES, "aligned")) for name in NAMES}
    assert groups_of(world, aligned) == (NAMES,)


def test_a_map_in_a_turned_frame_falls_on_the_truth() -> None:
    """Cells of the same walls, told in a frame that lies a quarter turn away."""
    grid = room()
    panel = Panel(grid, 800)
    height = grid.cells.shape[0] * grid.resolution
    turned = OccupancyGrid(
        np.ascontiguousarray(grid.cells.T[:, ::-1]),
        grid.resolution,
        -grid.origin_y - height,
        grid.origin_x,
    )
    straight = panel.ground([(grid, Pose2(0.0, 0.0, 0.0))])
    placed = panel.ground([(turned, Pose2(0.0, 0.0, -np.pi / 2))])
    walls = (straight == bgr(WALL_COLOUR)).all(axis=2)
    assert walls.sum() > 1000
    differing = (straight != placed).any(axis=2)
    assert differing.mean() < 0.01


def test_what_is_not_aligned_stands_in_panels_of_its_own(tmp_path: Path) -> None:
    world, path = simulation(), tmp_path / "live.png"
    picture = LivePicture(path, lambda: 0.0)
    picture.started(world)
    world.step({})
    picture.ticked(world, {})
    apart = cv2.imread(str(path))
    told = {name: report({mate: "aligned" for mate in NAMES if mate != name}) for name in NAMES}
    together_path = tmp_path / "together.png"
    joined = LivePicture(together_path, lambda: 0.0)
    joined.started(world)
    joined.ticked(world, told)
    together = cv2.imread(str(together_path))
    assert apart is not None and together is not None
    # Three panels in two columns, each under a line that says whose it is; or one, twice as wide.
    assert abs(apart.shape[1] - together.shape[1]) <= 2
    assert apart.shape[0] - together.shape[0] > 36
