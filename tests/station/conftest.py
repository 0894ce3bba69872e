"""A short run without brains: scripted driving, and hand-made answers near the truth."""

from collections.abc import Callable

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from protocol.config import PoseModel
from protocol.messages import (
    Action,
    DriveCommand,
    GridPatch,
    MapReply,
    RadioFrame,
    Report,
    TeammateView,
    TrajectoryReply,
)
from protocol.pose import FloatArray, compose, invert
from robot.slam.engine import GraphSnapshot
from robot.slam.packed_submap import PackedGrid, PackedSubmap
from robot.slam.saved_map import SavedMap
from station.observer import Observer, RobotOutcome, RunOutcome
from world.report_log import ReportLog
from world.scenario import GateConfig, RobotSpec, Scenario
from world.simulation import Simulation

TICKS = 120
DIES_AT = 60
OFFSET_M = 0.02


def make_room() -> OccupancyGrid:
    """8 × 5 m with a wall that has a door."""
    cells = np.zeros((100, 160), dtype=np.int8)
    cells[:2] = cells[-2:] = 100
    cells[:, :2] = cells[:, -2:] = 100
    cells[:40, 80:82] = cells[62:, 80:82] = 100
    return OccupancyGrid(cells, 0.05, -1.0, -0.5)


def make_simulation(dies: bool = True) -> Simulation:
    starts = (
        PoseModel(x_m=0.0, y_m=2.0, theta_rad=0.0),
        PoseModel(x_m=6.0, y_m=2.2, theta_rad=3.0),
    )
    robots = tuple(RobotSpec(name=f"r{i + 1}", start=start) for i, start in enumerate(starts))
    scenario = Scenario(
        map="room",
        robots=(*robots, RobotSpec(name="r3")) if dies else robots,
        starts="known",
        radio=GateConfig(range_m=4.0),
        max_sim_s=0.1 * TICKS,
    )
    return Simulation(scenario, make_room())


def make_report(simulation: Simulation, index: int) -> Report:
    x, y, theta = simulation.poses[index].tolist()
    name, names = simulation.names[index], simulation.names
    return Report(
        tick=simulation.tick,
        pose=PoseModel(x_m=x + OFFSET_M, y_m=y, theta_rad=theta),
        covariance=np.eye(3),
        activity="exploring: as told",
        path=np.array([[x, y], [x + 1.0, y], [x + 1.0, y + 1.0]]),
        known_m2=0.2 * simulation.tick,
        frontier_m=3.0,
        finished=False,
        team=tuple(
            TeammateView(
                robot=other,
                in_range=bool(simulation.links[index, k]),
                last_heard_tick=simulation.tick,
                entries=2,
            )
            for k, other in enumerate(names)
            if other != name
        ),
        loop_closures=1,
        journal_entries=7,
    )


SAVED = SavedMap(
    GraphSnapshot(
        np.zeros((1, 3)), np.empty((0, 2), np.int32), np.empty((0, 3)), np.empty((0, 3, 3))
    ),
    (
        PackedSubmap(
            index=0,
            keyframes=np.zeros((1, 3)),
            travel_m=0.0,
            nodes=PackedGrid.of(np.full((8, 8), 255, np.uint8)),
            free=PackedGrid.of(np.ones((2, 2), np.uint8)),
            origin=np.zeros(2),
        ),
    ),
)


def make_map_reply(simulation: Simulation, share: float) -> MapReply:
    """The truth, as far as the left `share` of the building."""
    grid = simulation.terrain.grid
    cells = np.array(grid.cells)
    cells[:, round(share * cells.shape[1]) :] = -1
    patch = GridPatch(
        resolution_m=grid.resolution,
        origin_x_m=grid.origin_x,
        origin_y_m=grid.origin_y,
        cells=cells,
    )
    return MapReply(own=patch, joint=patch, saved=SAVED.encode())


def make_trajectory_reply(simulation: Simulation, index: int) -> TrajectoryReply:
    true: FloatArray = np.array(simulation.history.poses[:, index])
    count = len(true)
    nodes = true[::20]
    relative = compose(invert(nodes[:-1]), nodes[1:])
    edges = len(nodes) - 1
    ledger = simulation.ledger
    return TrajectoryReply(
        ticks=np.arange(count),
        stamps=0.1 * np.arange(count),
        online=true + np.array([OFFSET_M, 0.0, 0.0]),
        final=true,
        dead_reckoned=compose(true, np.array([0.0, 0.0, 0.1]) * np.ones((count, 1))),
        nodes=nodes,
        edge_nodes=np.stack([np.arange(edges), np.arange(edges) + 1], axis=1),
        edge_values=np.hstack([relative, np.tile([100.0, 0, 0, 100.0, 0, 900.0], (edges, 1))]),
        journal_digest="0" * 64,
        frame="team",
        frames_sent=int(ledger.sent[index, 0]),
        bytes_sent=int(ledger.sent[index, 1]),
        frames_heard=int(ledger.heard[index, 0]),
        bytes_heard=int(ledger.heard[index, 1]),
        sent_for={"live": int(ledger.sent[index, 1])},
        heard_for={
            name: {"live": size}
            for name, size in zip(
                simulation.names, ledger.delivered[:, index, 1].tolist(), strict=True
            )
        },
    )


def play(observer: Observer | None = None, dies: bool = True) -> RunOutcome:
    """The whole run under an observer; with `dies`, r3 is killed half way."""
    simulation = make_simulation(dies)
    reports = {name: ReportLog() for name in simulation.names}
    if observer:
        observer.started(simulation)
    simulation.step({})
    while not simulation.done:
        if dies and simulation.tick == DIES_AT:
            simulation.mark_dead("r3")
        frames = (RadioFrame(kind="beacon", payload=bytes(50)),)
        simulation.step(
            {
                name: Action(
                    tick=simulation.tick,
                    drive=DriveCommand(forward_mps=0.3, turn_rps=0.1 * k),
                    frame_count=1,
                    frames=frames,
                )
                for k, name in enumerate(simulation.names)
                if name in simulation.alive
            }
        )
        if simulation.tick % 10 == 0 and not simulation.done:
            for k, name in enumerate(simulation.names):
                if name in simulation.alive:
                    reports[name].append(make_report(simulation, k))
        if observer:
            latest = {name: log.latest for name, log in reports.items() if log.latest}
            observer.ticked(simulation, latest)
            if simulation.tick % 40 == 0:
                share = simulation.tick / TICKS
                observer.mapped("r1", make_map_reply(simulation, share))
    robots = {
        name: RobotOutcome(
            make_map_reply(simulation, 1.0), make_trajectory_reply(simulation, k), 150.0
        )
        for k, name in enumerate(simulation.names)
    }
    if dies:
        robots["r3"] = RobotOutcome(None, None, 140.0, "killed by signal 9")
    outcome = RunOutcome(simulation, "time limit", 2.0, "inline", robots, 200.0, reports)
    if observer:
        observer.ended(outcome)
    return outcome


@pytest.fixture(scope="session")
def outcome() -> RunOutcome:
    """A finished run of three robots, the third of which died half way."""
    return play()


@pytest.fixture(scope="session")
def play_under() -> Callable[[Observer], RunOutcome]:
    """The same run, under an observer."""
    return play


@pytest.fixture
def nothing() -> RunOutcome:
    """A run that was interrupted before tick 0: nobody answered anything."""
    return RunOutcome(make_simulation(), "interrupted", 0.0, "processes", {}, 200.0)
