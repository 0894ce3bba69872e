"""Compiled loops that describe the returns of a scan: points, surfaces, weights."""

import math

import numpy as np

from protocol.kernel import inlined, kernel

# Returns lie on a line when they spread across it by less than this share of along it (squares),
FLAT = 0.08
# or as far as noise can tell, if that leaves the line's direction so sure (variance, rad²).
LEAN2 = 0.06
# A line does not explain its returns when the χ² of their misfit is so many of its own standard
# deviations above its mean. Fewer would take the noise of plain walls for rags, and the lines with
# it that average it out.
LINE_SIGMAS = 4.0
# Between neighbouring returns that step across their surface by more than this share of their
# distance, and so many σ, there is no wall to draw.
STEP_SHARE = 0.1
STEP_SIGMAS = 2.0
# Where no surface lies between neighbours, and one is so many σ farther out, lies a shadow.
SHADOW_SIGMAS = 3.0


@kernel
def directions(angles, out):
    """Cosines and sines (n×2) of the angles of beams (n)."""
    for i in range(angles.shape[0]):
        out[i, 0] = math.cos(angles[i])
        out[i, 1] = math.sin(angles[i])


@kernel
def describe_returns(
    ranges,
    directions,
    increment,
    wraps,
    max_range,
    max_gap,
    normal_radius,
    spacing,
    noise,
    out,
    links,
):
    """Points, surface normals, weights and σ of a scan's returns; the number of them is returned.

    `ranges` (n) lie along `directions` (n×2). `noise` = (σ at 0 m, growth per metre, variance per
    metre, σ of the angle). `out` (n×6) takes x, y, normal x, normal y, weight, σ; the normal is
    (0, 0) where the neighbours lie on no line.
    A return on a surface is moved onto the line through its neighbours, as far as noise explains,
    and its σ is the one across the surface: range noise along a grazing ray does not count there.
    `links[i]` is 1 when return i and the next lie on one surface. Ragged walls are not smoothed and
    no segment bridges their steps: both would look otherwise from each side, and robots that pass
    would think that they got farther than they did. So they would by returns at the edge of a
    shadow, which moves with the robot: these are to be drawn, but weigh nothing. Where nobody knows
    the noise all weigh the same.
    """
    n = ranges.shape[0]
    count = 0
    beam = np.empty(n, dtype=np.int64)
    nearest = np.empty(n)  # that it may be, as far as noise can tell
    for i in range(n):
        r = ranges[i]
        if math.isfinite(r) and r <= max_range:
            out[count, 0] = r * directions[i, 0]
            out[count, 1] = r * directions[i, 1]
            sigma_r = noise[0] + noise[1] * r
            variance = sigma_r * sigma_r + noise[2] * r + (r * noise[3]) ** 2
            out[count, 5] = math.sqrt(variance)
            nearest[count] = r - SHADOW_SIGMAS * out[count, 5]
            beam[count] = i
            count += 1
    for k in range(count):
        links[k] = 0
        following = k + 1
        gap_beams = 0
        if following < count:
            gap_beams = beam[following] - beam[k]
        elif wraps and count > 1:
            following = 0
            gap_beams = n - beam[k] + beam[0]
        if gap_beams == 0 or gap_beams > 2:
            continue
        dx = out[following, 0] - out[k, 0]
        dy = out[following, 1] - out[k, 1]
        r = min(ranges[beam[k]], ranges[beam[following]])
        limit = max(3.0 * r * increment * gap_beams, 3.0 * spacing) + 3.0 * out[k, 5]
        if math.sqrt(dx * dx + dy * dy) < min(limit, max_gap):
            links[k] = 1
    moments = np.empty((6, count))
    for k in range(count):
        r = ranges[beam[k]]
        radius = max(normal_radius, 2.5 * r * increment, 4.0 * out[k, 5])
        _moments(out, links, count, k, radius, moments)
    lines = np.empty((5, count))
    _lines(moments, lines)
    shift = lines[2]
    across = np.empty(count)
    raw = np.zeros(count)
    for k in range(count):
        r = ranges[beam[k]]
        nx, ny, near, misfit = lines[0, k], lines[1, k], moments[0, k], lines[3, k]
        used = near
        variance = _across(out, k, r, nx, ny, noise)
        if not _is_line(near, misfit, lines[4, k], variance):
            nx, ny, used, shift[k] = 0.0, 0.0, 1.0, 0.0
            if near < 3.0 and count > 2:
                before = _wrapped(k - 1, count)
                after = _wrapped(k + 1, count)
                gap_before = _wrapped(beam[k] - beam[before], n)
                gap_after = _wrapped(beam[after] - beam[k], n)
                if gap_before <= 2 and gap_after <= 2:
                    nx, ny = _grazing_normal(out, before, k, after)
                    variance = _across(out, k, r, nx, ny, noise)
        elif misfit > _greatest_chi2(near) * variance:
            used, shift[k] = 1.0, 0.0
        out[k, 2] = nx
        out[k, 3] = ny
        out[k, 4] = min(1.0, r * increment / spacing)
        across[k] = out[k, 5]
        if nx != 0.0 or ny != 0.0:
            raw[k] = math.sqrt(variance)
            across[k] = raw[k] / math.sqrt(used)
            shift[k] = min(max(shift[k], -2.0 * raw[k]), 2.0 * raw[k])
    for k in range(count):
        out[k, 0] += shift[k] * out[k, 2]
        out[k, 1] += shift[k] * out[k, 3]
        out[k, 5] = across[k]
    for k in range(count):
        following = _wrapped(k + 1, count)
        if links[k] == 1 and not _is_bridged(out, raw, k, following):
            links[k] = 0
        is_beside = (following > k or wraps) and _wrapped(beam[following] - beam[k], n) <= 2
        if links[k] == 0 and is_beside and out[k, 5] > 0.0:
            if nearest[k] > ranges[beam[following]]:
                out[k, 4] = 0.0
            elif nearest[following] > ranges[beam[k]]:
                out[following, 4] = 0.0
    return count


@inlined
def _wrapped(k, count):
    """k of a ring of `count`, for k at most one round off: a remainder takes ten times as long."""
    if k >= count:
        return k - count
    return k + count if k < 0 else k


@inlined
def _across(out, k, r, nx, ny, noise):
    """The variance that noise has across a surface with that normal."""
    facing = (out[k, 0] * nx + out[k, 1] * ny) / r
    sigma_r = noise[0] + noise[1] * r
    along_ray = (sigma_r * sigma_r + noise[2] * r) * facing * facing
    return along_ray + (r * noise[3]) ** 2 * (1.0 - facing * facing)


@inlined
def _is_line(near, misfit, spread, variance):
    """Whether neighbours lie on a line: by their shape, or as far as noise of that variance can
    tell, if the line's direction is known in spite of it."""
    if near < 3.0 or spread == 0.0:
        return False
    if misfit <= FLAT * spread:
        return True
    return variance <= LEAN2 * spread and misfit <= _greatest_chi2(near) * variance


@inlined
def _greatest_chi2(near):
    """Of the misfit of so many neighbours, in variances of their noise."""
    freedom = near - 2.0
    return freedom + LINE_SIGMAS * math.sqrt(2.0 * freedom)


@inlined
def _is_bridged(out, raw, k, following):
    """Whether the segment between two linked returns follows the surfaces that both lie on.

    `raw` is the noise across the surface, 0 where there is none; of the returns as they were moved
    onto their lines less is left. Where nobody knows the noise there is no telling a step from it,
    and all segments are taken.
    """
    if out[k, 5] == 0.0:
        return True
    if raw[k] == 0.0 or raw[following] == 0.0:
        return False
    dx = out[following, 0] - out[k, 0]
    dy = out[following, 1] - out[k, 1]
    step = abs(out[k, 2] * dx + out[k, 3] * dy)
    step_following = abs(out[following, 2] * dx + out[following, 3] * dy)
    noise = STEP_SIGMAS * math.sqrt(out[k, 5] ** 2 + out[following, 5] ** 2)
    return max(step, step_following) <= STEP_SHARE * math.sqrt(dx * dx + dy * dy) + noise


@inlined
def _moments(out, links, count, k, radius, moments):
    """Of the linked neighbours of return k, itself among them: how many they are, and the sums of
    x, y, x², x y and y² from it on, into column k."""
    m = 1.0
    sx = 0.0
    sy = 0.0
    sxx = 0.0
    sxy = 0.0
    syy = 0.0
    x0 = out[k, 0]
    y0 = out[k, 1]
    reach2 = radius * radius
    for direction in (1, -1):
        j = k
        for _ in range(count - 1):
            following = _wrapped(j + direction, count)
            if links[j if direction == 1 else following] == 0:
                break
            j = following
            dx = out[j, 0] - x0
            dy = out[j, 1] - y0
            if dx * dx + dy * dy > reach2:
                break
            m += 1.0
            sx += dx
            sy += dy
            sxx += dx * dx
            sxy += dx * dy
            syy += dy * dy
    moments[0, k] = m
    moments[1, k], moments[2, k] = sx, sy
    moments[3, k], moments[4, k], moments[5, k] = sxx, sxy, syy


@inlined
def _lines(moments, lines):
    """The lines through neighbours, by their `_moments` (6×n), into 5×n: direction across the line,
    (0, 0) for none; how far it passes from the return; and the sums of squares of how far they are
    off it, and spread along it.

    All at once and without branches, for roots and divisions take long one after the other.
    """
    for k in range(moments.shape[1]):
        m, sx, sy = moments[0, k], moments[1, k], moments[2, k]
        sxx = moments[3, k] - sx * sx / m
        sxy = moments[4, k] - sx * sy / m
        syy = moments[5, k] - sy * sy / m
        half_trace = 0.5 * (sxx + syy)
        half_difference = 0.5 * (sxx - syy)
        root = math.sqrt(half_difference * half_difference + sxy * sxy)
        # The eigenvector of the small eigenvalue, from the row of the matrix that does not cancel.
        nx = -sxy if half_difference > 0.0 else root - half_difference
        ny = root + half_difference if half_difference > 0.0 else -sxy
        length = math.sqrt(nx * nx + ny * ny)
        is_some = length > 0.0
        nx /= length
        ny /= length
        lines[0, k] = nx if is_some else 0.0
        lines[1, k] = ny if is_some else 0.0
        lines[2, k] = (sx * nx + sy * ny) / m if is_some else 0.0
        lines[3, k] = half_trace - root
        lines[4, k] = half_trace + root if is_some else 0.0


@inlined
def _grazing_normal(out, before, k, after):
    """Normal of a wall seen at so flat an angle that its returns lie far apart; (0, 0) for none.

    Taken for spots, such returns would hold the robot where the wall lets it slide.
    """
    dx = out[after, 0] - out[before, 0]
    dy = out[after, 1] - out[before, 1]
    length = math.sqrt(dx * dx + dy * dy)
    if length == 0.0:
        return 0.0, 0.0
    px = out[k, 0] - out[before, 0]
    py = out[k, 1] - out[before, 1]
    along = (px * dx + py * dy) / length
    across = (px * dy - py * dx) / length
    if along <= 0.0 or along >= length or abs(across) > 0.02 * length + 3.0 * out[k, 5]:
        return 0.0, 0.0
    return -dy / length, dx / length


@kernel
def count_beyond(returns, limit):
    """How many returns (n×6) are farther from the robot than that."""
    count = 0
    for k in range(returns.shape[0]):
        if returns[k, 0] ** 2 + returns[k, 1] ** 2 > limit * limit:
            count += 1
    return count


@kernel
def thin(returns, limit, out):
    """Choose at most `limit` of the returns (n×6), spread evenly over the weight, into `out`
    (limit×6); how many."""
    n = returns.shape[0]
    total = 0.0
    for k in range(n):
        total += returns[k, 4]
    wanted = min(limit, n)
    if total <= 0.0:
        return 0
    count = 0
    chosen = 0
    last = -1
    reached = returns[0, 4]
    for i in range(wanted):
        level = (i + 0.5) * (total / wanted)
        while reached < level and chosen < n - 1:
            chosen += 1
            reached += returns[chosen, 4]
        if chosen != last:
            out[count] = returns[chosen]
            count += 1
            last = chosen
    return count
