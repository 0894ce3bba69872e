"""Compiled loops over the terrain: where discs fit, and how they move.

Lengths are in cells, as in `ray_kernels`.
"""

import math

import numpy as np
import numpy.typing as npt

from protocol.kernel import inlined, kernel
from protocol.pose import FloatArray

BoolArray = npt.NDArray[np.bool_]
ByteArray = npt.NDArray[np.uint8]
IntArray = npt.NDArray[np.int64]


@inlined
def disc_hits(solid: BoolArray, x: float, y: float, radius: float) -> bool:
    """Whether the open disc at (x, y) overlaps a solid cell; outside the grid is solid."""
    height, width = solid.shape
    for r in range(math.floor(y - radius), math.floor(y + radius) + 1):
        for c in range(math.floor(x - radius), math.floor(x + radius) + 1):
            if r < 0 or c < 0 or r >= height or c >= width or solid[r, c]:
                gap_x = x - min(max(x, c), c + 1.0)
                gap_y = y - min(max(y, r), r + 1.0)
                if gap_x * gap_x + gap_y * gap_y < radius * radius:
                    return True
    return False


@kernel
def disc_overlaps(solid: BoolArray, x: float, y: float, radius: float) -> bool:
    """`disc_hits`, for one disc (cells)."""
    return disc_hits(solid, x, y, radius)


@kernel
def room_for_disc(solid: BoolArray, radius: float) -> BoolArray:
    """At which cell centres (h×w) a disc of `radius` (cells) overlaps no solid cell."""
    height, width = solid.shape
    fits = ~solid
    reach = math.ceil(radius + 0.5)
    for r in range(height):
        for c in range(width):
            if not solid[r, c]:
                continue
            for i in range(max(r - reach, 0), min(r + reach + 1, height)):
                gap_y = max(abs(i - r) - 0.5, 0.0)
                for j in range(max(c - reach, 0), min(c + reach + 1, width)):
                    gap_x = max(abs(j - c) - 0.5, 0.0)
                    if gap_x * gap_x + gap_y * gap_y < radius * radius:
                        fits[i, j] = False
    return fits


@inlined
def arc_x(x: float, heading: float, forward: float, turn: float) -> float:
    """x after driving an arc of length `forward` while turning by `turn`."""
    if abs(turn) < 1e-6:  # below it the quotient loses digits that the series keeps
        return x + forward * math.cos(heading + 0.5 * turn)
    return x + forward / turn * (math.sin(heading + turn) - math.sin(heading))


@inlined
def arc_y(y: float, heading: float, forward: float, turn: float) -> float:
    """y after driving an arc of length `forward` while turning by `turn`."""
    if abs(turn) < 1e-6:
        return y + forward * math.sin(heading + 0.5 * turn)
    return y - forward / turn * (math.cos(heading + turn) - math.cos(heading))


@inlined
def blocked_at(
    solid: BoolArray, near: FloatArray, count: int, x: float, y: float, radius: float
) -> bool:
    """Whether a robot may not stand at (x, y): a wall is there, or one of the first `count`
    discs of `near`."""
    for k in range(count):
        if math.hypot(near[k, 0] - x, near[k, 1] - y) < 2.0 * radius:
            return True
    return disc_hits(solid, x, y, radius)


@kernel
def drive_all(
    solid: BoolArray,
    clearance: ByteArray,
    poses: FloatArray,
    motions: FloatArray,
    starts: IntArray,
    others: IntArray,
    radius: float,
    stride: float,
    blocked: BoolArray,
) -> None:
    """Move robots one after the other along arcs, each until something is in its way.

    `poses` (n×3: cells, cells, rad) is changed in place; `motions` (n×2) holds length (cells) and
    turn (rad). `clearance` (h×w): free cells around each cell, in all directions. `starts` and
    `others` name, as `neighbours` gives them, all who can touch in this motion. A robot that is
    `blocked` (n) stands where it touched and goes on turning on the spot.
    """
    n = poses.shape[0]
    near = np.empty((n, 2))
    for i in range(n):
        x, y, heading = poses[i, 0], poses[i, 1], poses[i, 2]
        forward, turn = motions[i, 0], motions[i, 1]
        blocked[i] = False
        reach = radius + abs(forward)
        open_ground = clearance[math.floor(y), math.floor(x)] - 1.0 >= reach
        count = 0
        for k in others[starts[i] : starts[i + 1]]:
            # Those farther away are out of touch wherever the robot gets to in this motion.
            if math.hypot(poses[k, 0] - x, poses[k, 1] - y) < reach + radius:
                open_ground = False
                near[count, 0], near[count, 1] = poses[k, 0], poses[k, 1]
                count += 1
        share = 1.0
        if not open_ground and forward != 0.0:
            steps = math.ceil(abs(forward) / stride)
            share = 0.0
            for step in range(1, steps + 1):
                ahead = step / steps
                at_x = arc_x(x, heading, forward * ahead, turn * ahead)
                at_y = arc_y(y, heading, forward * ahead, turn * ahead)
                if blocked_at(solid, near, count, at_x, at_y, radius):
                    blocked[i] = True
                    break
                share = ahead
            if blocked[i]:  # halve the last stride down to the contact
                width = 1.0 / steps
                for _ in range(12):
                    width *= 0.5
                    ahead = share + width
                    at_x = arc_x(x, heading, forward * ahead, turn * ahead)
                    at_y = arc_y(y, heading, forward * ahead, turn * ahead)
                    if not blocked_at(solid, near, count, at_x, at_y, radius):
                        share = ahead
        if share > 0.0:
            poses[i, 0] = arc_x(x, heading, forward * share, turn * share)
            poses[i, 1] = arc_y(y, heading, forward * share, turn * share)
        poses[i, 2] = (heading + turn + math.pi) % (2.0 * math.pi) - math.pi
