"""What the robots know at the end of a run, against one batch solution of all their data.

    python -m studies.centralised --map office --robots 4 --seeds 0-4 --json centralised.json

Each robot has solved what it heard, as it came. The batch gets every entry that any robot wrote,
all closures and links among them, and minimises until nothing moves any more. Both are held against
the truth at all keyframes, under one rigid alignment for the team. They differ by what a robot did
not hear before the run was over, which is chance in one run: what working apart costs is the mean
ratio of several, told with its standard error. Runs are inline; those found in `--out` are not
played again.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from protocol.pose import FloatArray
from robot.brain import Brain
from robot.perception.returns import noise_model
from robot.slam.pose_graph import optimise
from robot.team.alignment import align
from robot.team.joint import JointGraph, Problem, Solution, by_log, keyframe_poses
from robot.team.journal import decode_record
from robot.team.log_reading import read_in_order
from station.scenario_file import changed
from studies.command import one_line_errors, study_parser, write_figures
from studies.trials import parse_seeds
from world.accuracy import align_team, distances, rmse
from world.scenario import Scenario
from world.simulation import Simulation

# From the last solution on, until its cost no longer falls at all.
ROUNDS, ITERATIONS = 20, 100


def compare(scenario: Scenario) -> dict[str, Any]:
    """Play a scenario; team error at the keyframes as the robots have it and by the batch."""
    simulation = Simulation(scenario)
    brains = {name: Brain(simulation.robot_config(name)) for name in simulation.names}
    records: dict[bytes, None] = {}
    senses = simulation.step({})
    while not simulation.done:
        actions = {name: brain.step(senses[name]) for name, brain in brains.items()}
        for brain in brains.values():
            records.update(dict.fromkeys(brain.take_records()))
        senses = simulation.step(actions)
    graph = union(records)
    solution = centralised(graph, noise_model(scenario.lidar))
    told = {name: brain.trajectory_reply() for name, brain in brains.items()}
    known = {log.robot: (graph.log(log), anchors) for log, anchors in solution.items()}
    ours, batch = [], []
    for k, name in enumerate(simulation.names):
        log, anchors = known.get(name, (None, np.zeros((0, 3))))
        if log is None:
            continue
        ticks = np.array([keyframe.tick for keyframe in log.keyframes])
        true = simulation.history.poses[ticks, k]
        batch.append((keyframe_poses(log, anchors), true))
        ours.append((told[name].final[np.searchsorted(told[name].ticks, ticks)], true))
    return {
        "seed": scenario.seed,
        "exit_reason": simulation.exit_reason,
        "robots": len(brains),
        "aligned": len(known),
        "frames": len({reply.frame for reply in told.values()}),
        "journals": len({reply.journal_digest for reply in told.values()}),
        "keyframes": sum(len(poses) for poses, _ in batch),
        "team_error_m": _error_m(ours),
        "centralised_error_m": _error_m(batch),
    }


def union(records: Mapping[bytes, None]) -> JointGraph:
    """The graph of all entries that anybody wrote or heard, each once."""
    entries = sorted(decode_record(record) for record in records)
    graph = JointGraph()
    for name, entry in read_in_order(entries):
        graph.add(name.log, entry)
    return graph


def centralised(graph: JointGraph, noise: FloatArray) -> Solution:
    """The largest group of logs that are aligned, solved until nothing moves."""
    group = max(align(graph, noise).groups, key=lambda group: len(group.logs))
    problem = graph.problem(group)
    return by_log(problem, _minimised(problem))


def _minimised(problem: Problem) -> FloatArray:
    nodes, cost = problem.nodes, np.inf
    for _ in range(ROUNDS):
        solved = optimise(
            nodes,
            problem.edge_nodes,
            problem.measurements,
            problem.information,
            problem.fixed,
            problem.robust,
            ITERATIONS,
        )
        if not solved.cost < cost:
            break
        nodes, cost = solved.nodes, solved.cost
    return nodes


def _error_m(ways: Sequence[tuple[FloatArray, FloatArray]]) -> float | None:
    T_world_team = align_team(ways)
    return rmse(distances(T_world_team, poses, true) for poses, true in ways)


def kept(scenario: Scenario, path: Path) -> dict[str, Any]:
    """The figures of a run, from its file if it has one."""
    if path.exists():
        found: dict[str, Any] = json.loads(path.read_text())
        return found
    row = compare(scenario)
    write_figures(row, path)
    return row


def line(row: Mapping[str, Any]) -> str:
    """One run in words."""
    if not row["team_error_m"] or not row["centralised_error_m"]:
        return f"seed {row['seed']}: nothing to compare"
    ratio = row["team_error_m"] / row["centralised_error_m"]
    return (
        f"seed {row['seed']}: {row['exit_reason']}, {row['aligned']} of {row['robots']} aligned, "
        f"team error {row['team_error_m']:.5f} m, by the batch {row['centralised_error_m']:.5f} m, "
        f"ratio {ratio:.4f}, {row['journals']} different journals"
    )


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """The mean ratio of the errors (team to batch) with its standard error, and the errors over all
    runs."""
    errors = np.array(
        [
            (row["team_error_m"], row["centralised_error_m"])
            for row in rows
            if row["team_error_m"] and row["centralised_error_m"]
        ]
    ).reshape(-1, 2)
    if len(errors) < 2:
        return "too few runs for a mean"
    ratios = errors[:, 0] / errors[:, 1]
    ours, batch = np.sqrt((errors**2).mean(axis=0))
    return (
        f"{len(ratios)} runs: mean ratio {ratios.mean():.4f} "
        f"± {ratios.std(ddof=1) / np.sqrt(len(ratios)):.4f}, greatest {ratios.max():.4f}; "
        f"team error {ours:.5f} m (rms), by the batch {batch:.5f} m"
    )


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.centralised", __doc__)
    parser.add_argument("--map", default="office", help="a shipped map or a map_server YAML file")
    parser.add_argument("--robots", type=int, default=4)
    parser.add_argument("--range", type=float, default=10.0, metavar="METRES", help="radio range d")
    parser.add_argument("--seeds", type=parse_seeds, default=list(range(5)), help="e.g. 0-4")
    parser.add_argument("--out", type=Path, default=Path("runs/centralised"), help="finished runs")
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for seed in arguments.seeds:
        values = {"map": arguments.map, "seed": seed, "radio": {"range_m": arguments.range}}
        scenario = changed(Scenario(), values, robots=arguments.robots)
        name = f"{Path(arguments.map).stem}-{arguments.robots}-{arguments.range:g}-{seed}.json"
        rows.append(kept(scenario, arguments.out / name))
        print(line(rows[-1]), flush=True)
    print(summary(rows))
    write_figures(rows, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
