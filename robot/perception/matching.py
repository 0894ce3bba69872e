"""Scan matching: the pose at which the returns of a scan lie best on a correlation field."""

from typing import Literal, NamedTuple

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.perception import matching_kernels
from robot.perception.field import RESOLUTION_M, SIGMA_M, BoolArray, CorrelationField
from robot.perception.returns import Returns
from robot.perception.walls import Walls

MAX_ITERATIONS = 25
TOLERANCE = 5e-4  # m and rad: a step this short is the last
MIN_RETURNS = 12
# Fewer surfaces on walls that were seen from behind draw a match off by nothing to speak of.
MIN_BEHIND = 0.02
# How thick walls may be.
WALLS_M = (0.12, 0.24)

# What a return is worth against the prior, in units of 1 / σ².
TRUST = 1.0

# c² of the kernel by which a prior counts: one that is 3 σ off has half its weight.
PRIOR_SCALE_SQUARED = 9.0

NO_PRIOR = np.zeros((3, 3))

Reason = Literal["converged", "iterations", "few returns"]


class Match(NamedTuple):
    """A pose of a scan on a field, and how good it is.

    `information` (3×3) is that of the returns alone, in the tangent space at the pose. `score` is
    the field under the returns, by weight, as a share of what noise alone would leave of it.
    `value` is what was climbed: the field under the returns less the cost of leaving the prior.
    """

    T_field_base: Pose2
    information: FloatArray
    score: float
    value: float
    iterations: int
    converged: bool
    reason: Reason


def match_returns(
    field: CorrelationField,
    returns: Returns,
    prior: Pose2,
    prior_information: FloatArray = NO_PRIOR,
    start: Pose2 | None = None,
    wanted: float = 0.0,
) -> Match:
    """Climb from `start` (the prior if none) to the best pose nearby, or until it is plain that its
    score will be less than is `wanted`.

    The prior pulls with its information (3×3, tangent space at the pose); by default not at all.
    """
    if len(returns) < MIN_RETURNS:
        return Match(prior, np.zeros((3, 3)), 0.0, 0.0, 0, False, "few returns")
    pose = (start or prior).to_array()
    information = np.zeros((3, 3))
    score, value, iterations, converged = matching_kernels.match_returns(
        field.nodes,
        field.origin,
        RESOLUTION_M,
        returns.values,
        len(returns),
        SIGMA_M,
        TRUST,
        prior.to_array(),
        prior_information,
        PRIOR_SCALE_SQUARED,
        MAX_ITERATIONS,
        TOLERANCE,
        wanted,
        pose,
        information,
    )
    return Match(
        Pose2.from_array(pose),
        information,
        score,
        value,
        iterations,
        converged,
        "converged" if converged else "iterations",
    )


def match_facing(field: CorrelationField, walls: Walls, returns: Returns, start: Pose2) -> Match:
    """As `match_returns`, without surfaces on walls that were drawn from the other side alone:
    these draw a match off by as much as the walls are thick. Where there are such, it is climbed
    from as far before them too, and the pose counts at which most surfaces fit.

    Normals are to face who saw the surfaces.
    """
    share, best, behind = _climb_facing(field, walls, returns, start)
    if not behind.any():
        return best
    towards = returns.moved(best.T_field_base).values[behind, 2:4].mean(axis=0)
    for thick_m in WALLS_M:
        x, y = thick_m * towards
        shifted = Pose2(x, y, 0.0) @ best.T_field_base
        other_share, other, _ = _climb_facing(field, walls, returns, shifted)
        if other_share > share:
            share, best = other_share, other
    return best


def _climb_facing(
    field: CorrelationField, walls: Walls, returns: Returns, start: Pose2
) -> tuple[float, Match, BoolArray]:
    """A match without the surfaces that it puts on walls drawn from the other side; before it its
    score as a share of all surfaces, after it which those are (n; none if they are few)."""
    match = match_returns(field, returns, start)
    _, behind = walls.sides(match.T_field_base, returns)
    if behind.sum() < MIN_BEHIND * len(returns):
        return match.score, match, np.zeros_like(behind)
    facing = Returns.unlinked(returns.values[~behind])
    match = match_returns(field, facing, match.T_field_base)
    return match.score * len(facing) / len(returns), match, behind
