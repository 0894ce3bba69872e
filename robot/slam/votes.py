"""Which closures others speak for: cycles of two closures and the odometry between their ends.

Pairwise consistency (Mangelson, Dominic, Eustice, Vasudevan, "Pairwise consistent measurement set
maximization for robust multi-robot map merging", 2018) without the clique: two closures between
the same two stretches of the way close a short cycle, which hardly ever closes by chance. Each
closure gathers log odds from all such cycles; false closures find nobody to agree with.
"""

import math

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, invert
from robot.slam import chain_kernels, consistency_kernels

# Closures whose ends are farther apart in steps than this are not compared.
WINDOW = 20


def vote(
    nodes: FloatArray,
    edge_nodes: npt.NDArray[np.int64],
    measurements: FloatArray,
    covariances: FloatArray,
    doubted: npt.NDArray[np.bool_],
    gate: float,
) -> FloatArray:
    """Log odds (k, 0 for edges that are not doubted) that each doubted edge is true.

    Arrays as in `optimise`, `covariances` (k×3×3) the inverses of the information. Node numbers
    are the order in time; edges between consecutive nodes that are not doubted are the odometry.
    """
    odds = np.zeros(len(edge_nodes))
    ends, measured, covariance = _forwards(edge_nodes, measurements, covariances)
    steps = np.flatnonzero(~doubted & (ends[:, 1] == ends[:, 0] + 1))
    step_edges = np.full(len(nodes), -1, dtype=np.int64)
    step_edges[ends[steps, 1]] = steps
    chain = np.empty((len(nodes), 3))
    chain_kernels.chain(ends[steps], measured[steps], nodes[0].copy(), chain)
    chain = np.where(np.isnan(chain), nodes, chain)
    drift, broken = np.zeros((len(nodes), 3, 3)), np.zeros(len(nodes), dtype=np.int64)
    consistency_kernels.gather_drift(chain, step_edges, covariance, drift, broken)
    chosen = np.flatnonzero(doubted)
    chosen = chosen[np.argsort(ends[chosen, 0], kind="stable")]
    found = np.zeros(len(chosen))
    consistency_kernels.vote(
        ends[chosen],
        measured[chosen],
        covariance[chosen],
        chain,
        drift,
        broken,
        WINDOW,
        gate,
        room_of(measured[chosen]),
        found,
    )
    odds[chosen] = found
    return odds


def room_of(measured: FloatArray) -> float:
    """The volume (m² rad) that the measurements are spread over: where a false one may fall."""
    if len(measured) == 0:
        return 1.0
    width, height = np.maximum(np.ptp(measured[:, :2], axis=0), 0.1)
    return float(width * height * 2.0 * math.pi)


def _forwards(
    edge_nodes: npt.NDArray[np.int64], measurements: FloatArray, covariances: FloatArray
) -> tuple[npt.NDArray[np.int64], FloatArray, FloatArray]:
    """The same edges, each from the earlier node to the later one."""
    ends, measured, covariance = edge_nodes.copy(), measurements.copy(), covariances.copy()
    turned = ends[:, 0] > ends[:, 1]
    c, s = np.cos(measured[turned, 2]), np.sin(measured[turned, 2])
    adjoint = np.zeros((int(turned.sum()), 3, 3))
    adjoint[:, 0, 0], adjoint[:, 0, 1], adjoint[:, 0, 2] = c, -s, measured[turned, 1]
    adjoint[:, 1, 0], adjoint[:, 1, 1], adjoint[:, 1, 2] = s, c, -measured[turned, 0]
    adjoint[:, 2, 2] = 1.0
    covariance[turned] = adjoint @ covariance[turned] @ adjoint.transpose(0, 2, 1)
    measured[turned] = invert(measured[turned])
    ends[turned] = ends[turned][:, ::-1]
    return ends, measured, covariance
