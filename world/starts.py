"""Where robots start: as the scenario says, or drawn by its seed."""

import math
from collections.abc import Mapping

import numpy as np
from scipy import ndimage

from protocol.errors import EarshotError
from protocol.pose import FloatArray
from world.noise import Noise
from world.scenario import Scenario
from world.terrain import Terrain

# Starts keep this much more than a radius from walls, and this far from each other, if they can.
COMFORT_M = 0.15
APART_M = 1.0
# Robots that are drawn into a tight place still must not touch.
GAP_M = 0.01
# Robots that start at the same place leave each other this much room to turn.
BESIDE_M = 0.3
# So many places are looked at together: a large map has millions, and few are needed.
BLOCK = 4096


class StartError(EarshotError):
    """A robot cannot stand where it should start, or there is no room for all of them."""


def place_robots(scenario: Scenario, terrain: Terrain, noise: Noise) -> FloatArray:
    """The start of every robot (n×3, m, m, rad). Raises StartError."""
    names, radius = scenario.names, scenario.body.radius_m
    given = {
        name: spec.start.to_pose().to_array()
        for name, spec in zip(names, scenario.robots, strict=True)
        if spec.start is not None
    }
    _check_given(terrain, given, radius)
    drawn = [name for name in names if name not in given]
    taken = np.array([pose[:2] for pose in given.values()]).reshape(-1, 2)
    rng = noise.at("*", "starts", 0)  # of the team: no robot has this name
    if scenario.starts == "same":
        rows = gather_starts(terrain, rng, len(drawn), radius, taken)
    else:
        rows = draw_starts(terrain, rng, len(drawn), radius, taken)
    poses = dict(zip(drawn, rows, strict=True))
    return np.array([given[name] if name in given else poses[name] for name in names])


def draw_starts(
    terrain: Terrain, rng: np.random.Generator, count: int, radius_m: float, taken: FloatArray
) -> FloatArray:
    """Poses (count×3, m, m, rad) drawn evenly over the largest area that a disc can move in.

    They keep `COMFORT_M` from walls and `APART_M` from each other and from `taken` (k×2), or as
    much of it as the map has room for. Raises StartError when it has room for too few.
    """
    if count == 0:
        return np.zeros((0, 3))
    labels, areas = ndimage.label(terrain.room_for(radius_m))
    if areas == 0:
        raise StartError(f"the map has no room for a robot of radius {radius_m:g} m")
    largest = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    for share in (1.0, 0.5, 0.0):
        choice = largest & terrain.room_for(radius_m + share * COMFORT_M)
        closest = 2.0 * radius_m + GAP_M
        rows, columns = np.nonzero(choice)
        order = rng.permutation(len(rows))
        points = terrain.grid.to_points(rows[order], columns[order])
        picked = _pick_apart(points, count, max(closest, share * APART_M), taken)
        if len(picked) == count:
            return np.column_stack([picked, rng.uniform(-np.pi, np.pi, count)])
    raise StartError(f"the map has no room for {count} robots of radius {radius_m:g} m")


def gather_starts(
    terrain: Terrain, rng: np.random.Generator, count: int, radius_m: float, taken: FloatArray
) -> FloatArray:
    """Poses (count×3) beside each other, or beside the first of those `taken` (k×2), all facing the
    same way; else as `draw_starts`, and likewise raises StartError."""
    if count == 0:
        return np.zeros((0, 3))
    room = terrain.room_for(radius_m + COMFORT_M)
    first = draw_starts(terrain, rng, 1, radius_m, taken)[0]
    middle = taken[0] if len(taken) else first[:2]
    rows, columns = np.nonzero(room)
    points = terrain.grid.to_points(rows, columns)
    away = np.hypot(*(points - middle).T)
    near = np.argsort(away, kind="stable")
    # Around the corner is not beside: what the first one could drive to within this reach counts.
    reach = np.zeros_like(room)
    reach[rows, columns] = away <= 2.0 * BESIDE_M * math.sqrt(count + len(taken))
    labels, _ = ndimage.label(reach)
    own = labels[rows[near[0]], columns[near[0]]]
    near = near[labels[rows[near], columns[near]] == own]
    picked = _pick_apart(points[near], count, 2.0 * radius_m + BESIDE_M, taken)
    if len(picked) < count:
        raise StartError(f"the map has no room for {count} robots beside each other at {middle}")
    return np.column_stack([picked, np.full(count, first[2])])


def _check_given(terrain: Terrain, given: Mapping[str, FloatArray], radius_m: float) -> None:
    before: list[tuple[str, FloatArray]] = []
    for name, pose in given.items():
        x, y = float(pose[0]), float(pose[1])
        if terrain.disc_overlaps(x, y, radius_m):
            raise StartError(f"{name} cannot start at ({x:g}, {y:g}): a wall is in its way")
        for other, there in before:
            if np.hypot(*(there[:2] - pose[:2])) < 2.0 * radius_m:
                raise StartError(f"{name} cannot start at ({x:g}, {y:g}): {other} stands there")
        before.append((name, pose))


def _pick_apart(points: FloatArray, count: int, apart: float, taken: FloatArray) -> FloatArray:
    """The first `count` points, in order, that keep their distance from each other and `taken`."""
    picked: list[FloatArray] = []
    for first in range(0, len(points), BLOCK):
        block = points[first : first + BLOCK]
        open_to = np.ones(len(block), dtype=bool)
        for other in (*taken, *picked):
            open_to &= np.hypot(*(block - other[:2]).T) >= apart
        while len(picked) < count and open_to.any():
            point = block[int(np.argmax(open_to))]
            picked.append(point)
            open_to &= np.hypot(*(block - point).T) >= apart
        if len(picked) == count:
            break
    return np.array(picked).reshape(-1, 2)
