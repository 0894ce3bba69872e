"""The referee: full marks for the truth, and none for maps that are shifted, thick or empty."""

import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage

from maps.grid import OccupancyGrid
from maps.library import load_map
from protocol.messages import Action, DriveCommand, GridPatch, MapReply, RadioFrame, TrajectoryReply
from protocol.pose import FloatArray, Pose2, compose, invert
from world.referee import Referee, Reply
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation
from world.terrain import Terrain
from world.truth import Cells, MapTruth

Cell = npt.NDArray[np.int8]


def simulation(ticks: int = 30) -> Simulation:
    """Two robots that drive about in rooms-small and talk."""
    robots = (RobotSpec(name="r1"), RobotSpec(name="r2"))
    world = Simulation(Scenario(map="rooms-small", robots=robots, seed=1))
    senses = world.step({})
    for tick in range(ticks):
        frame = RadioFrame(kind="x", payload=bytes(tick))
        drive = DriveCommand(forward_mps=0.3, turn_rps=0.5)
        senses = world.step(
            {n: Action(tick=tick, drive=drive, frame_count=1, frames=(frame,)) for n in senses}
        )
    return world


def patch(grid: OccupancyGrid, cells: Cell | None = None, dx: float = 0.0) -> GridPatch:
    return GridPatch(
        resolution_m=grid.resolution,
        origin_x_m=grid.origin_x + dx,
        origin_y_m=grid.origin_y,
        cells=grid.cells if cells is None else cells,
    )


def trajectory(world: Simulation, name: str, T_map_world: Pose2 | None = None) -> TrajectoryReply:
    """The true trajectory as a robot would tell it, in a map frame of its own."""
    i = world.names.index(name)
    poses: FloatArray = world.history.poses[:, i]
    if T_map_world is not None:
        poses = compose(T_map_world.to_array(), poses)
    drift = poses + np.linspace(0.0, 1.0, len(poses))[:, None] * np.array([1.0, 0.0, 0.0])
    return TrajectoryReply(
        ticks=np.arange(len(poses)),
        stamps=np.arange(len(poses)) * 0.1,
        online=poses + np.array([0.1, 0.0, 0.0]),
        final=poses,
        dead_reckoned=drift,
        nodes=np.zeros((0, 3)),
        edge_nodes=np.zeros((0, 2), dtype=np.int32),
        edge_values=np.zeros((0, 9)),
        journal_digest="",
        frames_sent=int(world.ledger.sent[i, 0]),
        bytes_sent=int(world.ledger.sent[i, 1]),
        frames_heard=int(world.ledger.heard[i, 0]),
        bytes_heard=int(world.ledger.heard[i, 1]),
        sent_for={"live": int(world.ledger.sent[i, 1])},
        heard_for={
            other: {"live": int(world.ledger.delivered[k, i, 1])}
            for k, other in enumerate(world.names)
        },
    )


def exact_replies(world: Simulation) -> dict[str, Reply]:
    exact = patch(world.terrain.grid)
    return {n: (MapReply(own=exact, joint=exact), trajectory(world, n)) for n in world.names}


def share(world: Simulation, drawn: GridPatch) -> tuple[float, float, float]:
    """Coverage, recall and precision of one map."""
    truth, placed = Referee(world).truth, [(drawn, Pose2(0.0, 0.0, 0.0))]
    return (
        truth.known(truth.target, placed),
        truth.known(truth.walls, placed),
        truth.precision(placed),
    )


def test_the_truth_gets_full_marks() -> None:
    world = simulation()
    score = Referee(world).score(exact_replies(world))
    assert score.coverage == score.coverage_worst_joint == 1.0
    assert (score.walls.recall, score.walls.precision) == (1.0, 1.0)
    assert score.team.ate_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert score.robots["r1"].ate_online_rmse_m == pytest.approx(0.1)
    assert score.team.dead_reckoning_rmse_m is not None
    assert score.team.dead_reckoning_rmse_m > 0.05
    assert score.ledger.equal
    assert score.radio.frames_offered == 60
    assert score.sim_s == pytest.approx(3.0)
    assert 40.0 < score.target_m2 < 80.0
    assert type(score).model_validate_json(score.model_dump_json()) == score


def test_maps_are_judged_where_the_trajectories_put_them() -> None:
    world = simulation()
    T_map_world = Pose2(5.0, -3.0, 0.0)
    moved = patch(world.terrain.grid, dx=5.0)
    moved = moved.model_copy(update={"origin_y_m": moved.origin_y_m - 3.0})
    replies: dict[str, Reply] = {
        n: (MapReply(own=moved, joint=moved), trajectory(world, n, T_map_world))
        for n in world.names
    }
    score = Referee(world).score(replies)
    assert score.coverage is not None and score.coverage > 0.999
    assert score.walls.recall is not None and score.walls.recall > 0.999
    assert score.team.ate_rmse_m == pytest.approx(0.0, abs=1e-9)


def test_a_turned_map_is_judged_in_its_own_frame() -> None:
    world = simulation()
    grid = world.terrain.grid
    height = grid.cells.shape[0] * grid.resolution
    # A quarter turn to the left about the origin: what was along x is now along y.
    turned = GridPatch(
        resolution_m=grid.resolution,
        origin_x_m=-grid.origin_y - height,
        origin_y_m=grid.origin_x,
        cells=np.ascontiguousarray(grid.cells.T[:, ::-1]),
    )
    T_map_world = Pose2(0.0, 0.0, np.pi / 2)
    truth = Referee(world).truth
    T_world_map = Pose2.from_array(invert(T_map_world.to_array()))
    assert truth.known(truth.target, [(turned, T_world_map)]) > 0.999
    assert truth.known(truth.walls, [(turned, T_world_map)]) > 0.999
    assert truth.precision([(turned, T_world_map)]) > 0.999


def test_a_shift_of_one_cell_is_tolerated_and_more_is_punished() -> None:
    world = simulation()
    grid = world.terrain.grid
    assert min(share(world, patch(grid, dx=0.05))) > 0.999
    coverage, recall, precision = share(world, patch(grid, dx=0.15))
    assert coverage < 0.98
    assert recall < 0.8
    assert precision < 0.9


def test_walls_that_are_too_thick_are_punished() -> None:
    world = simulation()
    grid = world.terrain.grid
    thick = ndimage.binary_dilation(grid.occupied, np.ones((3, 3), dtype=bool), iterations=2)
    cells = np.where(thick, 100, grid.cells).astype(np.int8)
    coverage, recall, precision = share(world, patch(grid, cells))
    assert coverage < 0.97
    assert recall == 1.0
    assert precision < 0.8


def test_an_empty_map_an_open_one_and_a_solid_one() -> None:
    world = simulation()
    grid = world.terrain.grid
    nothing, open_ground, solid = (np.full_like(grid.cells, value) for value in (-1, 0, 100))
    assert share(world, patch(grid, nothing)) == (0.0, 0.0, 0.0)
    coverage, recall, precision = share(world, patch(grid, open_ground))
    assert coverage < 0.97
    assert (recall, precision) == (0.0, 0.0)
    coverage, recall, precision = share(world, patch(grid, solid))
    assert coverage < 0.1
    assert precision < 0.25


def test_half_a_map_is_half_the_coverage() -> None:
    world = simulation()
    grid = world.terrain.grid
    cells = grid.cells.copy()
    cells[:, cells.shape[1] // 2 :] = -1
    coverage, recall, precision = share(world, patch(grid, cells))
    assert coverage == pytest.approx(0.5, abs=0.05)
    assert recall == pytest.approx(0.5, abs=0.1)
    assert precision == 1.0


def test_maps_together_know_what_one_of_them_knows() -> None:
    world = simulation()
    grid = world.terrain.grid
    left, right = grid.cells.copy(), grid.cells.copy()
    left[:, left.shape[1] // 2 :] = -1
    right[:, : right.shape[1] // 2] = -1
    referee = Referee(world)
    assert referee.coverage({"r1": patch(grid, left), "r2": patch(grid, right)}) == 1.0


def test_maps_that_are_wrong_outvote_one_that_is_right() -> None:
    world = simulation()
    grid = world.terrain.grid
    good, bad = patch(grid), patch(grid, np.full_like(grid.cells, 100))
    referee = Referee(world)
    assert referee.coverage({"r1": good, "r2": bad}) == 1.0
    assert referee.coverage({"r1": good, "r2": bad, "r3": bad}) < 0.1


def test_the_poorest_joint_map_counts() -> None:
    world = simulation()
    replies = exact_replies(world)
    grid = world.terrain.grid
    empty = patch(grid, np.full_like(grid.cells, -1))
    replies["r2"] = (MapReply(own=patch(grid), joint=empty), replies["r2"][1])
    score = Referee(world).score(replies)
    assert score.coverage == 1.0
    assert score.coverage_worst_joint == 0.0
    assert score.robots["r1"].coverage_joint == 1.0


def test_the_dead_answer_nothing_and_cost_nothing() -> None:
    world = simulation()
    world.mark_dead("r2")
    replies = exact_replies(world) | {"r2": (None, None)}
    score = Referee(world).score(replies)
    assert score.coverage == score.coverage_worst_joint == 1.0
    assert score.robots["r2"].ate_rmse_m is None
    assert score.robots["r2"].ledger_equal is None
    assert score.ledger.equal
    nobody = Referee(world).score({})
    assert (nobody.coverage, nobody.coverage_worst_joint) == (None, None)
    assert (nobody.walls.recall, nobody.walls.precision) == (None, None)
    assert (nobody.ledger.equal, nobody.team.ate_rmse_m) == (None, None)


def test_a_robot_whose_counts_differ_is_found() -> None:
    world = simulation()
    replies = exact_replies(world)
    track = replies["r1"][1]
    assert track is not None
    wrong = track.model_copy(update={"bytes_heard": track.bytes_heard + 1})
    score = Referee(world).score(replies | {"r1": (replies["r1"][0], wrong)})
    assert not score.ledger.equal
    assert score.robots["r1"].ledger_equal is False
    assert score.robots["r2"].ledger_equal is True


def test_tolerance_is_one_cell_of_the_coarser_grid() -> None:
    coarse = OccupancyGrid(load_map("rooms-small").cells[::2, ::2].copy(), 0.1, -0.5, -0.5)
    terrain = Terrain(coarse)
    truth = MapTruth(terrain, np.array([[2.0, 2.0, 0.0]]), 0.2)
    cells = np.ascontiguousarray(np.repeat(np.repeat(coarse.cells, 2, 0), 2, 1))
    for shift, fine in ((0.1, True), (0.25, False)):
        drawn = GridPatch(resolution_m=0.05, origin_x_m=-0.5 + shift, origin_y_m=-0.5, cells=cells)
        placed = [(drawn, Pose2(0.0, 0.0, 0.0))]
        assert (truth.known(truth.walls, placed) > 0.99) == fine
        assert (truth.precision(placed) > 0.99) == fine


def test_the_target_ends_where_robots_cannot_get() -> None:
    """Two rooms without a door: only the one with the start counts, with the walls around it."""
    cells = np.full((20, 42), 100, dtype=np.int8)
    cells[1:-1, 1:20] = 0
    cells[1:-1, 22:41] = 0
    terrain = Terrain(OccupancyGrid(cells, 0.1, 0.0, 0.0))
    truth = MapTruth(terrain, np.array([[1.0, 1.0, 0.0]]), 0.2)
    assert truth.target.points[:, 0].max() < 2.1
    assert truth.walls.points[:, 0].max() < 2.1
    free = truth.target.points[~truth.target.walls]
    # A disc cannot fill a corner of 90 degrees: three cells in each are not asked for.
    assert len(free) == 18 * 19 - 4 * 3
    assert len(truth.walls.points) == 20 * 21 - 18 * 19


def test_cells_without_any_are_no_coverage() -> None:
    world = simulation(1)
    nothing = Cells(np.zeros((0, 2)), np.zeros(0, dtype=bool))
    assert Referee(world).truth.known(nothing, [(patch(world.terrain.grid), Pose2(0, 0, 0))]) == 0.0
