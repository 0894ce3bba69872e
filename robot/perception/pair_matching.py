"""Scan matching without a map: the pose from which one scan saw what another one did.

Iterative closest points with distances to lines (Censi, "An ICP variant using a point-to-line
metric", 2008), weighted by both scans' noise across the surface. The heading comes first, from the
directions in which surfaces face: it does not depend on where the scans were taken.
"""

import math
from dataclasses import dataclass

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.perception import pair_kernels
from robot.perception.returns import Returns

MAX_ITERATIONS = 30
TOLERANCE = 5e-4  # m and rad
MIN_RETURNS = 12
# Information below this is none (1/m² and 1/rad²).
NO_INFORMATION = 1e-6


@dataclass(frozen=True, slots=True)
class PairMatch:
    """`T_target_source`, with information (3×3, tangent space there) by the noise of both scans:
    what their surfaces say beyond what the noise of normals would say of a wall without an end.

    `share` is that of the source's returns on surfaces that lie on the target's; `converged` is
    False where the surfaces in common do not hold the pose or too few returns were there.
    """

    T_target_source: Pose2
    information: FloatArray
    share: float
    iterations: int
    converged: bool

    @property
    def sigma_m(self) -> float:
        """σ of the position in the direction that is known worst; infinite if one is not at all."""
        values, vectors = np.linalg.eigh(self.information)
        if values[0] < NO_INFORMATION:
            return math.inf
        covariance = (vectors / values) @ vectors.T
        return math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))


def match_pair(
    target: Returns,
    source: Returns,
    guess: Pose2,
    noise: FloatArray,
    reach_m: float = 0.4,
    reach_rad: float = math.radians(20.0),
) -> PairMatch:
    """Match two scans from a guess of `T_target_source` that may be off by the reach.

    `noise` is what `noise_model` says of both.
    """
    if min(len(target), len(source)) < MIN_RETURNS:
        return PairMatch(guess, np.zeros((3, 3)), 0.0, 0, False)
    pose = guess.to_array()
    pose[2] += pair_kernels.turn_between(target.values, source.values, guess.theta, reach_rad)
    information = np.zeros((3, 3))
    share, iterations, converged, held = pair_kernels.match_pair(
        target.values,
        target.links,
        source.values,
        noise,
        reach_m,
        MAX_ITERATIONS,
        TOLERANCE,
        pose,
        information,
    )
    pose[2] = math.remainder(pose[2], 2.0 * math.pi)
    return PairMatch(
        Pose2.from_array(pose),
        information if held else _positive(information),
        float(share),
        int(iterations),
        bool(converged),
    )


def _positive(information: FloatArray) -> FloatArray:
    """Without what is negative: noise may have made less of a direction than it mostly does."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T, dtype=np.float64)
