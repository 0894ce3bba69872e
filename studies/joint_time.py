"""How long the joint solution of a team takes, as the job that a robot runs.

    python -m studies.joint_time --json joint.json

Robots wander on a common lattice of corridors, so that they revisit each other's places. Two sizes
of graph are solved, from the chains as their owners measured them: one node a submap (`--submap`
keyframes each), as the robots' graphs are, and one node a keyframe, the worst case. Times are the
least of `--rounds`, of `robot.team.joint.solve` alone, on one core.
"""

import sys
import time
from typing import Any

import numpy as np

from protocol.pose import FloatArray, compose, invert
from robot.team.joint import Problem, solve
from robot.team.journal import LogName
from studies.command import study_parser, write_figures

TEAMS = ((4, 500), (8, 2000))
SIGMA = np.array([0.02, 0.02, 0.005])
STEP_M = 0.3
CELL_M = 6.0
NEAR_M = 1.5
CLOSURES_PER_NODE = 1.0


def team_problem(robots: int, nodes: int, step_m: float, seed: int) -> Problem:
    """Walks of `nodes` poses each over a lattice, with odometry and closures, all with noise."""
    rng = np.random.default_rng(seed)
    walks = [_walk(rng, nodes, step_m) for _ in range(robots)]
    truth = np.concatenate(walks)
    bases = np.arange(robots) * nodes
    steps = np.concatenate([base + np.arange(nodes - 1) for base in bases])
    chains = np.column_stack([steps, steps + 1])
    closures = _closures(rng, truth, int(CLOSURES_PER_NODE * len(truth)))
    edges = np.vstack([chains, closures]).astype(np.int32)
    measured = compose(invert(truth[edges[:, 0]]), truth[edges[:, 1]])
    measured = measured + SIGMA * rng.standard_normal(measured.shape)
    start = truth.copy()
    for base in bases:
        for n in range(base + 1, base + nodes):
            start[n] = compose(start[n - 1], measured[n - 1 - base // nodes])
    fixed = np.zeros(len(truth), dtype=np.bool_)
    fixed[bases] = True
    return Problem(
        tuple(LogName(f"r{i + 1}", 0) for i in range(robots)),
        (nodes,) * robots,
        start,
        edges,
        measured,
        np.tile(np.diag(SIGMA**-2.0), (len(edges), 1, 1)),
        fixed,
        np.arange(len(edges)) >= len(chains),
    )


def _walk(rng: np.random.Generator, nodes: int, step_m: float) -> FloatArray:
    poses = np.zeros((nodes, 3))
    heading, left = rng.integers(4), CELL_M
    for n in range(nodes):
        if n:
            poses[n, :2] = poses[n - 1, :2]
            poses[n, 0] += step_m * np.cos(0.5 * np.pi * heading)
            poses[n, 1] += step_m * np.sin(0.5 * np.pi * heading)
        left -= step_m
        if left <= 0.0:
            # Back towards the middle more often than not, so that places are seen again.
            away = poses[n, :2] @ np.array([np.cos(0.5 * np.pi * heading), heading % 2]) > 20.0
            heading, left = (heading + (2 if away else rng.choice([-1, 0, 1]))) % 4, CELL_M
        poses[n, 2] = (0.5 * np.pi * heading + np.pi) % (2.0 * np.pi) - np.pi
    return poses


def _closures(rng: np.random.Generator, truth: FloatArray, count: int) -> FloatArray:
    """Random pairs of nodes that are near each other and not neighbours in time."""
    pairs: list[tuple[int, int]] = []
    while len(pairs) < count:
        i = int(rng.integers(len(truth)))
        near = np.flatnonzero(np.hypot(*(truth[:, :2] - truth[i, :2]).T) < NEAR_M)
        near = near[np.abs(near - i) > 5]
        if len(near):
            pairs.append((i, int(rng.choice(near))))
        else:
            count -= 1
    return np.array(pairs).reshape(-1, 2)


def measure(robots: int, keyframes: int, submap: int, rounds: int, seed: int) -> dict[str, Any]:
    """Times of one team, in both sizes of graph."""
    figures: dict[str, Any] = {"robots": robots, "keyframes": keyframes}
    for name, per_node in (("submaps", submap), ("keyframes", 1)):
        problem = team_problem(robots, keyframes // per_node, STEP_M * per_node, seed)
        took = []
        for _ in range(rounds):
            began = time.perf_counter()
            solve(problem)
            took.append(time.perf_counter() - began)
        figures[f"nodes_{name}"] = len(problem.nodes)
        figures[f"edges_{name}"] = len(problem.edge_nodes)
        figures[f"ms_{name}"] = 1e3 * min(took)
    return figures


def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.joint_time", __doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--submap", type=int, default=10, help="keyframes of one submap")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    solve(team_problem(2, 20, STEP_M, 0))  # loads the kernels
    teams = [
        measure(robots, keyframes, arguments.submap, arguments.rounds, arguments.seed)
        for robots, keyframes in TEAMS
    ]
    for team in teams:
        print(
            f"{team['robots']} robots × {team['keyframes']} keyframes: "
            f"{team['ms_submaps']:.1f} ms with a node a submap ({team['nodes_submaps']} nodes, "
            f"{team['edges_submaps']} edges), {team['ms_keyframes']:.1f} ms with a node a keyframe "
            f"({team['nodes_keyframes']}, {team['edges_keyframes']})"
        )
    write_figures({"teams": teams}, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
