"""Where a body can go on a map, at what cost, and by which path.

Planning works on blocks of about 0.1 m: a block is as clear as the clearest map cell in it, so
that no passage is lost to the coarser blocks, and clearance itself is measured on the map's own
cells. A robot whose own block is too near to a wall leaves it through free blocks.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from maps.grid import BoolArray, IntArray, OccupancyGrid
from protocol.config import BodyConfig
from protocol.pose import FloatArray, Pose2
from robot.explore.planner_kernels import (
    OCCUPIED,
    block_clearance,
    bridge_slivers,
    coarsen,
    shortcut,
    travel_costs,
)

BLOCK_M = 0.10
MARGIN_M = 0.03  # beyond the body's radius, between centres of cells: half a cell is lost there
SQUEEZE_M = 0.05  # a map's walls may be off by a cell
CUT_OFF_M = 1.0
BLOCKED_RADIUS_M = 0.2  # closes any gap that is too tight to drive through
WANTED_CLEARANCE_M = 0.60
WALL_COST = 4.0
PATH_STEP_M = 0.10
NO_PATH: FloatArray = np.empty((0, 2))


@dataclass(frozen=True, slots=True)
class Terrain:
    """A map as a body of one radius sees it, in blocks of `resolution` m.

    `state` (h×w int8): −1 unknown, 0 free, 1 occupied. `clearance` (h×w): m to the nearest cell
    that is not free, from `centres` (h×w×2: row, column, in blocks), the clearest place of each
    block. `needed`: the clearance at which the body fits.
    """

    state: npt.NDArray[np.int8]
    clearance: FloatArray
    centres: FloatArray
    resolution: float
    origin_x: float
    origin_y: float
    needed: float

    @property
    def open(self) -> BoolArray:
        """Where the body's centre can be."""
        return self.clearance >= self.needed

    def block_at(self, x: float, y: float) -> tuple[int, int] | None:
        """Row and column of a point (m), None outside the grid."""
        row = math.floor((y - self.origin_y) / self.resolution)
        column = math.floor((x - self.origin_x) / self.resolution)
        height, width = self.state.shape
        return (row, column) if 0 <= row < height and 0 <= column < width else None

    def points_of(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """The clearest places (n×2, m) of blocks."""
        return self.to_points(self.centres[rows, columns])

    def point_of(self, row: int, column: int) -> tuple[float, float]:
        """The clearest place (x, y in m) of a block."""
        y, x = self.centres[row, column] * self.resolution
        return self.origin_x + float(x), self.origin_y + float(y)

    def to_points(self, units: FloatArray) -> FloatArray:
        """Places (n×2: row, column in block units) as points (n×2: x, y in m)."""
        return np.array([self.origin_x, self.origin_y]) + units[:, ::-1] * self.resolution

    def to_units(self, points: FloatArray) -> FloatArray:
        """Points (n×2: x, y in m) as (row, column) in block units."""
        origin = np.array([self.origin_y, self.origin_x])
        return np.ascontiguousarray((points[:, ::-1] - origin) / self.resolution)


@dataclass(frozen=True, slots=True)
class TravelField:
    """Cost (h×w, m) from one block to all, and each block's parent (h·w) on the way back.

    `room` (h×w, m) is the terrain's clearance, less where a teammate stands.
    """

    cost: FloatArray
    parent: IntArray
    room: FloatArray


def survey(grid: OccupancyGrid, body: BodyConfig) -> Terrain:
    """The terrain of a map for a body."""
    cells = np.array(grid.cells, dtype=np.int8, order="C")
    stride = max(1, round(BLOCK_M / grid.resolution))
    height, width = cells.shape
    state = np.empty((-(-height // stride), -(-width // stride)), dtype=np.int8)
    coarsen(cells, stride, state)
    state = bridge_slivers(state)
    clearance, centres = block_clearance(cells, stride, state, grid.resolution)
    return Terrain(
        state,
        clearance,
        centres,
        grid.resolution * stride,
        grid.origin_x,
        grid.origin_y,
        body.radius_m + MARGIN_M,
    )


def travel_field(
    terrain: Terrain,
    start: Pose2,
    avoided: tuple[Pose2, ...] = (),
    detour_m: float = 5.0,
    squeeze: bool = False,
    blocked: FloatArray = NO_PATH,
) -> TravelField | None:
    """The cost of travel from a pose to everywhere; None if the pose is off the map.

    Blocks within two body radii of an `avoided` pose (a teammate that stands there) cost as
    much as `detour_m` more. With `squeeze`, passages that look too narrow by up to `SQUEEZE_M`
    are open, at a high price: the follower finds out whether they are. `blocked` (n×2, m) are
    spots where it did: nothing goes through them, whatever the map says, unless it starts there.
    """
    block = terrain.block_at(start.x, start.y)
    if block is None:
        return None
    extra, room = np.zeros(terrain.state.shape), terrain.clearance.copy()
    reach = 2.0 * terrain.needed
    for pose in avoided:
        near = disc(terrain, pose, reach)
        extra[near] = detour_m / reach
        gaps = np.hypot(*(terrain.points_of(*near) - [pose.x, pose.y]).T) - terrain.needed
        room[near] = np.minimum(room[near], np.maximum(gaps, 0.0))
    state, clearance = terrain.state.copy(), terrain.clearance.copy()
    for x, y in blocked.tolist():
        spot = Pose2(x, y, 0.0)
        if spot.distance_to(start) > BLOCKED_RADIUS_M:
            closed = disc(terrain, spot, BLOCKED_RADIUS_M)
            state[closed], clearance[closed], room[closed] = OCCUPIED, 0.0, 0.0
    tight = terrain.needed - SQUEEZE_M if squeeze else terrain.needed
    cost, parent = travel_costs(
        state, clearance, extra, tight, terrain.needed, WANTED_CLEARANCE_M,
        WALL_COST, terrain.resolution, block[0] * terrain.state.shape[1] + block[1],
    )  # fmt: skip
    return TravelField(cost, parent, room)


def is_cut_off(terrain: Terrain, field: TravelField, home: Pose2 | None) -> bool:
    """Whether there is no way from the field's start to `home`, where the robot came from.

    A robot may find that the gap it came in by looks too narrow on the map of now.
    """
    if home is None:
        return False
    return not bool(np.isfinite(field.cost[disc(terrain, home, CUT_OFF_M)]).any())


def path_to(terrain: Terrain, field: TravelField, row: int, column: int) -> FloatArray:
    """The smoothed path (n×2, m) from the field's start to a block; empty if it is not reached."""
    if not math.isfinite(field.cost[row, column]):
        return NO_PATH
    width = terrain.state.shape[1]
    chain = [row * width + column]
    while field.parent[chain[-1]] >= 0:
        chain.append(int(field.parent[chain[-1]]))
    indices = np.array(chain[::-1], dtype=np.int64)
    units = terrain.centres[indices // width, indices % width]
    corners = units[shortcut(units, field.room, terrain.needed, WANTED_CLEARANCE_M)]
    roomy = replace(terrain, clearance=field.room)
    return smooth(roomy, resample(terrain.to_points(corners), PATH_STEP_M))


def replan(
    grid: OccupancyGrid,
    body: BodyConfig,
    start: Pose2,
    goal: Pose2,
    avoided: tuple[Pose2, ...] = (),
) -> FloatArray:
    """A new path (n×2, m) to the same goal; empty if there is none."""
    terrain = survey(grid, body)
    field = travel_field(terrain, start, avoided)
    block = terrain.block_at(goal.x, goal.y)
    return NO_PATH if field is None or block is None else path_to(terrain, field, *block)


def resample(points: FloatArray, step_m: float) -> FloatArray:
    """Points (n×2) about `step_m` apart along a polyline (m×2), both its ends included."""
    if len(points) < 2:
        return points
    lengths = np.hypot(*np.diff(points, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    count = max(2, math.ceil(along[-1] / step_m) + 1)
    wanted = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(wanted, along, points[:, k]) for k in (0, 1)], axis=-1)


def smooth(terrain: Terrain, path: FloatArray, rounds: int = 8) -> FloatArray:
    """Round the corners of a path, wherever the rounder one has room (n×2, ends kept)."""
    for _ in range(rounds if len(path) > 2 else 0):
        rounder = path.copy()
        rounder[1:-1] = 0.25 * path[:-2] + 0.5 * path[1:-1] + 0.25 * path[2:]
        has_room = clearance_at(terrain, rounder) >= np.minimum(
            clearance_at(terrain, path), 0.5 * (terrain.needed + WANTED_CLEARANCE_M)
        )
        path = np.where(has_room[:, None], rounder, path)
    return path


def clearance_at(terrain: Terrain, points: FloatArray) -> FloatArray:
    """Clearance (n, m) at points (n×2); 0 off the map."""
    units = np.floor(terrain.to_units(points)).astype(np.int64)
    height, width = terrain.state.shape
    rows, columns = units[:, 0], units[:, 1]
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    clearance = np.zeros(len(points))
    clearance[inside] = terrain.clearance[rows[inside], columns[inside]]
    return clearance


def disc(terrain: Terrain, centre: Pose2, radius_m: float) -> tuple[IntArray, IntArray]:
    """Rows and columns of the blocks within a radius of a point."""
    height, width = terrain.state.shape
    reach = radius_m / terrain.resolution
    row = (centre.y - terrain.origin_y) / terrain.resolution - 0.5
    column = (centre.x - terrain.origin_x) / terrain.resolution - 0.5
    rows = np.arange(max(0, math.ceil(row - reach)), min(height, math.floor(row + reach) + 1))
    columns = np.arange(
        max(0, math.ceil(column - reach)), min(width, math.floor(column + reach) + 1)
    )
    both = np.stack(np.meshgrid(rows, columns, indexing="ij")).reshape(2, -1)
    within = np.hypot(both[0] - row, both[1] - column) <= reach
    return both[0][within], both[1][within]
