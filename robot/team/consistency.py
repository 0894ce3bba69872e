"""Which matches between two logs can be true together, and the sets of them that are.

Pairwise consistency maximisation: Mangelson, Dominic, Eustice, Vasudevan, "Pairwise consistent
measurement set maximization for robust multi-robot map merging", 2018. Two matches close a loop
through both logs, which must come back to where it began, to within what the matches and the two
chains of anchors between them may err by. True matches are consistent with each other; false ones
hardly ever are, unless the building repeats itself. A set is worth the distinct places in it.
"""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, compose, invert, wrap_angles

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# χ² with three degrees of freedom stays below it with a probability of 99.9 %.
GATE = 16.27
# What matches err by besides their own noise: rooms that are not what a grid says they are.
FLOOR = np.diag([0.05**2, 0.05**2, 0.01**2])
# Chains of anchors drift the same way for long; their covariances say they do not.
CHAIN_FACTOR = 4.0
# Sets are grown from so many seeds, those that agree with most weight.
SEEDS = 16


@dataclass(frozen=True, slots=True)
class Matches:
    """n matches between log a and log b, each an anchor of b seen from one of a.

    `of`, `to` (n): the anchors; `poses_a`, `poses_b` (n×3) where they lie in their logs' frames;
    `measured` (n×3) `T_of_to` with `covariance` (n×3×3, tangent space at `to`); `weights` (n).
    `chain_a`, `chain_b` (n×3×3): covariance gathered along the chain up to these anchors, in the
    frame of the log, so that the difference of two is that of the stretch between them.
    """

    of: IntArray
    to: IntArray
    poses_a: FloatArray
    poses_b: FloatArray
    measured: FloatArray
    covariance: FloatArray
    chain_a: FloatArray
    chain_b: FloatArray
    weights: FloatArray

    def only(self, chosen: IntArray) -> "Matches":
        """Those of some numbers."""
        return Matches(*(getattr(self, field.name)[chosen] for field in fields(self)))


def gathered_covariance(relative: FloatArray, covariance: FloatArray) -> FloatArray:
    """Σ (m×3×3) along a chain of relative poses (m×3) up to each, in the frame of the chain's
    origin; `covariance` (m×3×3) in the tangent space at the end of each step."""
    pose, total = np.zeros(3), np.zeros((3, 3))
    out = np.empty_like(covariance)
    for k in range(len(relative)):
        pose = compose(pose, relative[k])
        adjoint = adjoints(pose[None])[0]
        total = total + adjoint @ covariance[k] @ adjoint.T
        out[k] = total
    return out


def adjoints(poses: FloatArray) -> FloatArray:
    """The adjoint matrices (…×3×3) of poses (…×3)."""
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    out = np.zeros((*poses.shape[:-1], 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = c, -s, poses[..., 1]
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = s, c, -poses[..., 0]
    out[..., 2, 2] = 1.0
    return out


def consistency(m: Matches) -> BoolArray:
    """Which pairs (n×n) of matches close a loop. Symmetric, true on the diagonal."""
    n = len(m.of)
    i, j = np.triu_indices(n, 1)
    # The loop seen from where match i puts its anchor of b: there, and back by match j.
    along_a = compose(invert(m.poses_a[i]), m.poses_a[j])
    back_b = compose(invert(m.poses_b[j]), m.poses_b[i])
    loop = compose(compose(invert(m.measured[i]), along_a), compose(m.measured[j], back_b))
    loop[:, 2] = wrap_angles(loop[:, 2])
    covariance = FLOOR + m.covariance[i] + _carried(m.covariance[j] + FLOOR, invert(back_b))
    chain_a = CHAIN_FACTOR * _between(m.chain_a[i], m.chain_a[j])
    covariance += _carried(chain_a, invert(compose(m.poses_a[i], m.measured[i])))
    chain_b = CHAIN_FACTOR * _between(m.chain_b[i], m.chain_b[j])
    covariance += _carried(chain_b, invert(m.poses_b[i]))
    d2 = np.einsum("ka,kab,kb->k", loop, np.linalg.inv(covariance), loop)
    out = np.eye(n, dtype=bool)
    out[i, j] = out[j, i] = d2 <= GATE
    return out


def _carried(covariance: FloatArray, T_a_b: FloatArray) -> FloatArray:
    """Covariances (k×3×3) at b as seen in the frame a."""
    adjoint = adjoints(T_a_b)
    return np.asarray(adjoint @ covariance @ adjoint.transpose(0, 2, 1), dtype=np.float64)


def _between(first: FloatArray, second: FloatArray) -> FloatArray:
    """What a chain gathered between two of its points, whichever comes first."""
    sign = np.where(np.trace(second - first, axis1=1, axis2=2) >= 0.0, 1.0, -1.0)
    return np.asarray(sign[:, None, None] * (second - first), dtype=np.float64)


def worth(m: Matches, chosen: IntArray) -> float:
    """What a set of matches is worth: each place counts once, on the side that has fewer."""
    sides = []
    for anchors in (m.of[chosen], m.to[chosen]):
        best = np.zeros(int(anchors.max()) + 1)
        np.maximum.at(best, anchors, m.weights[chosen])
        sides.append(float(best.sum()))
    return min(sides)


def consistent_sets(m: Matches, most: int) -> list[IntArray]:
    """Up to `most` sets (sorted indices) of consistent matches, the one of most worth first.

    Each is grown from a seed by what keeps most weight in play; a set further down holds nothing
    that agrees with most of one before it, so that it stands for another alignment.
    """
    agrees = consistency(m)
    left = np.ones(len(m.of), dtype=bool)
    found: list[IntArray] = []
    while len(found) < most and left.any():
        support = np.where(left, (agrees & left) @ m.weights, -1.0)
        seeds = np.argsort(-support, kind="stable")[: min(SEEDS, int(left.sum()))]
        grown = [_grow(agrees, left, m.weights, int(seed)) for seed in seeds]
        best = max(grown, key=lambda chosen: (worth(m, chosen), -int(chosen[0])))
        found.append(best)
        left &= agrees[:, best].mean(axis=1) <= 0.5
        left[best] = False
    return found


def _grow(agrees: BoolArray, left: BoolArray, weights: FloatArray, seed: int) -> IntArray:
    """A clique round a seed: always the match next that leaves most weight to choose from."""
    chosen = [seed]
    open_to = agrees[seed] & left
    open_to[seed] = False
    while open_to.any():
        places = np.flatnonzero(open_to)
        kept = agrees[np.ix_(places, places)] @ weights[places]
        following = int(places[int(np.argmax(kept))])
        chosen.append(following)
        open_to &= agrees[following]
        open_to[following] = False
    return np.sort(np.array(chosen, dtype=np.int64))
