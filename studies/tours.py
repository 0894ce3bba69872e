"""A drive round a building with loops in it: where a robot truly was, twenty times a second."""

import math

import numpy as np
from scipy.ndimage import distance_transform_edt, label
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from protocol.errors import EarshotError
from protocol.pose import FloatArray, wrap_angle
from world.terrain import Terrain

STEP_S = 0.05
# The way keeps this far from walls, and farther where there is room.
RADIUS_M, ROOM_M = 0.3, 0.8
CELL_M = 0.2
PLACES = 40
# Every third goal or so is a place that was visited before: loops to be closed.
AGAIN = 0.35
LOOK_AHEAD_M = 0.5
TURN_RPS, ACCELERATION_MPS2 = 0.9, 0.6
PAUSE_S = 1.5


class Roads:
    """Ways on a coarse grid over the largest area where a robot fits."""

    def __init__(self, terrain: Terrain) -> None:
        stride = max(1, round(CELL_M / terrain.cell))
        # Half a coarse cell of room more, since ways run through the middles of coarse cells.
        fits = terrain.room_for(RADIUS_M)[::stride, ::stride]
        labels, areas = label(fits)
        if areas == 0:
            raise EarshotError("the map has no room for a robot")
        fits = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
        rows, columns = np.nonzero(fits)
        self.points: FloatArray = terrain.grid.to_points(rows * stride, columns * stride)
        away = distance_transform_edt(terrain.grid.free)[::stride, ::stride] * terrain.cell
        self._graph = _graph(fits, 1.0 + 4.0 * np.clip(ROOM_M - away, 0.0, ROOM_M))

    def spread(self, count: int, rng: np.random.Generator) -> list[int]:
        """Points that lie far from each other, each the farthest from those before it."""
        chosen = [int(rng.integers(len(self.points)))]
        nearest = np.full(len(self.points), np.inf)
        for _ in range(count):
            apart = np.hypot(*(self.points - self.points[chosen[-1]]).T)
            nearest = np.minimum(nearest, apart)
            chosen.append(int(np.argmax(nearest)))
        return chosen[1:]

    def from_point(self, start: int) -> tuple[FloatArray, np.ndarray]:
        """Cost of the way to every point, and the point before each on it."""
        cost, before = dijkstra(self._graph, indices=start, return_predecessors=True)
        return np.asarray(cost), np.asarray(before)


def _graph(fits: np.ndarray, price: FloatArray) -> csr_matrix:
    """Neighbouring cells (8 of them), by distance times what the ground costs."""
    number = np.full(fits.shape, -1)
    number[fits] = np.arange(int(fits.sum()))
    height, width = fits.shape
    parts = []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = (slice(0, height - down), slice(max(0, -right), width - max(0, right)))
        there = (slice(down, height), slice(max(0, right), width + min(0, right)))
        both = fits[here] & fits[there]
        cost = math.hypot(down, right) * 0.5 * (price[here] + price[there])
        parts.append((number[here][both], number[there][both], cost[both]))
    i, j, costs = (np.concatenate(column) for column in zip(*parts, strict=True))
    count = int(fits.sum())
    graph = coo_matrix((costs, (i, j)), shape=(count, count))
    return csr_matrix(graph + graph.T)


def plan_tour(roads: Roads, metres: float, rng: np.random.Generator) -> list[FloatArray]:
    """Ways (k×2, m) from place to place: mostly the nearest new one, at times one that is known,
    and in the end back to the first."""
    fresh = roads.spread(PLACES, rng)
    start = here = fresh.pop()
    known, legs, driven = [start], [], 0.0
    while driven < 0.85 * metres:
        cost, before = roads.from_point(here)
        if known[:-1] and (not fresh or rng.random() < AGAIN):
            goal = int(rng.choice(known[:-1]))
        else:
            goal = min(fresh, key=lambda place: cost[place])
            fresh.remove(goal)
            known.append(goal)
        legs.append(_way(roads, before, goal))
        driven += _length(legs[-1])
        here = goal
    _, before = roads.from_point(here)
    return [leg for leg in (*legs, _way(roads, before, start)) if len(leg) > 2]


def _way(roads: Roads, before: np.ndarray, goal: int) -> FloatArray:
    back = [goal]
    while before[back[-1]] >= 0:
        back.append(int(before[back[-1]]))
    return roads.points[back[::-1]]


def _length(way: FloatArray) -> float:
    return float(np.hypot(*np.diff(way, axis=0).T).sum())


def drive(legs: list[FloatArray], rng: np.random.Generator) -> FloatArray:
    """True poses (n×3), `STEP_S` apart, of a robot that steers at a point ahead on each way, at 0.4
    to 0.8 m/s, and pauses at its end."""
    x, y = legs[0][0]
    ahead = legs[0][min(5, len(legs[0]) - 1)] - legs[0][0]
    theta, speed = math.atan2(ahead[1], ahead[0]), 0.0
    poses = []
    for leg in legs:
        top = rng.uniform(0.4, 0.8)
        at = 0
        while True:
            # On to the nearest of the next points, and from there to one some way ahead.
            window = leg[at : at + 10] - (x, y)
            at += int(np.argmin(np.hypot(*window.T)))
            aim = at
            while aim < len(leg) - 1 and math.dist(leg[aim], (x, y)) < LOOK_AHEAD_M:
                aim += 1
            if at >= len(leg) - 2 and math.dist(leg[-1], (x, y)) < 0.25:
                break
            off = wrap_angle(math.atan2(leg[aim][1] - y, leg[aim][0] - x) - theta)
            wanted = top * max(0.0, math.cos(off)) ** 4 if abs(off) < 1.2 else 0.0
            change = ACCELERATION_MPS2 * STEP_S
            speed += min(max(wanted - speed, -3.0 * change), change)
            theta = wrap_angle(theta + STEP_S * min(max(2.5 * off, -TURN_RPS), TURN_RPS))
            x, y = x + STEP_S * speed * math.cos(theta), y + STEP_S * speed * math.sin(theta)
            poses.append((x, y, theta))
        speed = 0.0
        poses += [(x, y, theta)] * round(rng.uniform(0.0, PAUSE_S) / STEP_S)
    return np.array(poses)
