"""Compiled loops of the follower: the dynamic window over forward speed and turn rate."""

import math

import numpy as np

from protocol.kernel import inlined, kernel

STRIDE_M = 0.03
THIN_M = 0.03
ROLLOUT_STEPS = 8


@kernel
def steady_points(ranges, angles, near_m, spread_m, same_m):
    """Where beams (n) met something within `near_m`: m×2, robot frame, noise reduced.

    Close by, neighbouring beams meet the same surface: each range is the median of those beams
    that lie within `spread_m` to either side of it and differ from it by at most `same_m`: what
    is seen past an edge says nothing of where the edge is. The nearest of many noisy ranges would
    make a narrow door look narrower than it is. Of points within `THIN_M` of each other the
    nearest is kept.
    """
    n = ranges.shape[0]
    increment = abs(angles[1] - angles[0]) if n > 1 else 1.0
    points, found = np.empty((n, 2)), 0
    window = np.empty(9)
    first_x, first_y, nearest = np.inf, np.inf, np.inf
    for i in range(n):
        r = ranges[i]
        if not 0.0 < r < near_m:
            continue
        half, size = min(4, int(spread_m / (r * increment))), 0
        for k in range(i - half, i + half + 1):
            if 0 <= k < n and abs(ranges[k] - r) <= same_m:
                window[size] = ranges[k]
                size += 1
        steady = np.median(window[:size])
        x, y = steady * math.cos(angles[i]), steady * math.sin(angles[i])
        if math.hypot(x - first_x, y - first_y) >= THIN_M:
            first_x, first_y, nearest = x, y, np.inf
            found += 1
        if steady < nearest:
            nearest = steady
            points[found - 1, 0], points[found - 1, 1] = x, y
    return points[:found].copy()


@kernel
def best_velocity(
    obstacles, forwards, turns, wanted_forward, wanted_turn, carrot_x, carrot_y,
    max_forward, max_turn, braking, dt, slow_margin, fast_margin, rollout_s, wanted_clearance,
):  # fmt: skip
    """The best pair of forward speed (m/s) and turn rate (rad/s) that cannot hit anything.

    `obstacles` (n×4), robot frame: x, y, the distance at which the robot's centre touches, and
    the distance it must keep. A pair is safe if the robot, driving its arc for `dt` and then
    braking along it, keeps that distance plus a margin that grows with speed; what is nearer
    already may at least not come nearer. Of safe pairs the cheapest is taken: near the wanted
    one, ending near the carrot, clear of obstacles over `rollout_s`. Returns forward, turn, and
    whether any pair was safe; if none was: full braking.

    Source: Fox, Burgard, Thrun, "The dynamic window approach to collision avoidance", 1997.
    """
    best = math.inf
    best_forward, best_turn = 0.0, 0.0
    for forward in forwards:
        for turn in turns:
            cost = abs(forward - wanted_forward) / max_forward
            cost += 0.5 * abs(turn - wanted_turn) / max_turn
            if cost >= best or not _is_safe(
                obstacles, forward, turn, max_forward, braking, dt, slow_margin, fast_margin
            ):
                continue
            cost += _rollout_cost(
                obstacles, forward, turn, carrot_x, carrot_y, slow_margin, rollout_s,
                wanted_clearance,
            )  # fmt: skip
            if cost < best:
                best, best_forward, best_turn = cost, forward, turn
    return best_forward, best_turn, best < math.inf


@inlined
def _on_arc(forward, turn, t):
    """Position after `t` seconds of constant speed and turn rate."""
    angle = turn * t
    if abs(angle) < 1e-6:
        return forward * t, 0.5 * forward * t * angle
    radius = forward / turn
    return radius * math.sin(angle), radius * (1.0 - math.cos(angle))


@inlined
def _is_safe(obstacles, forward, turn, max_forward, braking, dt, slow_margin, fast_margin):
    speed = abs(forward)
    if speed < 1e-9:
        return True  # a disc that turns on the spot touches nothing
    margin = slow_margin + (fast_margin - slow_margin) * min(1.0, speed / max_forward)
    stopping_s = dt + 0.5 * speed / braking  # at constant speed: the same length of arc
    steps = int(math.ceil(stopping_s * speed / STRIDE_M))
    for n in range(obstacles.shape[0]):
        ox, oy = obstacles[n, 0], obstacles[n, 1]
        now = math.hypot(ox, oy)
        keep = obstacles[n, 3] + margin
        if now > keep + stopping_s * speed:
            continue
        keep = min(keep, now)
        for k in range(1, steps + 1):
            x, y = _on_arc(forward, turn, stopping_s * k / steps)
            if math.hypot(ox - x, oy - y) < keep:
                return False
    return True


@inlined
def _rollout_cost(
    obstacles, forward, turn, carrot_x, carrot_y, margin, rollout_s, wanted_clearance
):
    """How far from the carrot an arc passes, and how close to obstacles it comes."""
    nearest_carrot = math.hypot(carrot_x, carrot_y)
    clearance = wanted_clearance
    touches = 0.0
    for k in range(1, ROLLOUT_STEPS + 1):
        x, y = _on_arc(forward, turn, rollout_s * k / ROLLOUT_STEPS)
        nearest_carrot = min(nearest_carrot, math.hypot(carrot_x - x, carrot_y - y))
        for n in range(obstacles.shape[0]):
            gap = math.hypot(obstacles[n, 0] - x, obstacles[n, 1] - y) - obstacles[n, 2]
            clearance = min(clearance, gap)
        if clearance < margin:
            touches = 1.0 - k / ROLLOUT_STEPS
            break
    lack = 1.0 - max(0.0, clearance) / wanted_clearance
    return 1.0 * nearest_carrot + 0.3 * lack * lack + 0.5 * touches
