"""A start for a pose graph that needs no start: headings first, then positions, both linear.

Martinec and Pajdla, "Robust rotation and translation estimation in multiview reconstruction",
2007; Carlone, Tron, Daniilidis, Dellaert, "Initialization techniques for 3D SLAM: a survey on
rotation estimation and its use in pose graph optimization", 2015. In the plane a heading is a
complex number z of length 1. Leaving the length open makes

    min Σ ω_ij |z_j − z_i exp(iθ_ij)|²,   then   min Σ eᵀΩe over the positions

two linear least squares problems, the second with the headings of the first.
"""

import numpy as np

from protocol.pose import FloatArray
from robot.slam.normal_equations import NormalEquations


def chordal_start(problem: NormalEquations) -> FloatArray:
    """Nodes (m×3) near the optimum, from the edges alone.

    Fixed nodes stay; what the problem says of the others is not used, nor are its weights.
    """
    nodes, free = problem.nodes.copy(), problem.free
    if not free.any():
        return nodes
    blocks = problem.blocks[free]
    problem.linearise_headings(nodes)
    headings = problem.solve()
    if headings is not None:
        nodes[free, 2] = np.arctan2(headings[blocks, 1], headings[blocks, 0])
    return problem.place(nodes)
