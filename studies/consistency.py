"""Does a robot know how well it knows where it is? NEES of the pose over many short drives.

    python -m studies.consistency --runs 50 --json consistency.json

One robot explores a map (office, loop and rooms-small by turns, seeds 0 on, `modern` noise) for
`--seconds`; every `--every` seconds its error e against the truth, in the tangent space at the
estimate, is held against the covariance P that it reports: eᵀP⁻¹e / 3, whose mean is 1 where that
is honest (Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
2001, section 5.4). Given are the mean over all, its 95 % interval by resampling whole runs, and
the share within the 95 % gate of χ².
"""

import sys
from typing import Any

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.brain import Brain
from station.warm_up import ensure_warm
from studies.command import aligned, one_line_errors, study_parser, write_figures
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

MAPS = ("office", "loop", "rooms-small")
GATE_95 = 7.815  # χ² with three degrees of freedom
RESAMPLES = 2000


def drive(seed: int, seconds: float, every_s: float) -> FloatArray:
    """Errors and covariances of one drive: rows of eᵀP⁻¹e, squared position error, squared heading
    error, and the variances that the robot gave for the two."""
    robots = (RobotSpec(name="r1"),)
    name = MAPS[seed % len(MAPS)]
    scenario = Scenario(map=name, seed=seed, robots=robots, starts="known", max_sim_s=seconds)
    simulation = Simulation(scenario)
    brain = Brain(simulation.robot_config("r1"))
    senses = simulation.step({})
    rows, due = [], every_s
    while not simulation.done:
        truth = Pose2.from_array(simulation.poses[0])
        actions = {name: brain.step(sense) for name, sense in senses.items()}
        brain.take_records()
        if simulation.stamp >= due:
            due += every_s
            report = brain.report()
            estimate, covariance = report.pose.to_pose(), np.array(report.covariance)
            e = (estimate.inverse() @ truth).log()
            nees = float(e @ np.linalg.solve(covariance, e))
            variances = covariance[0, 0] + covariance[1, 1], covariance[2, 2]
            rows.append((nees, e[0] ** 2 + e[1] ** 2, e[2] ** 2, *variances))
        senses = simulation.step(actions)
    return np.array(rows).reshape(-1, 5)


def summarise(runs: list[FloatArray]) -> dict[str, Any]:
    """The figures over all runs."""
    table = np.concatenate(runs)
    means = np.array([run[:, 0].mean() / 3.0 for run in runs if len(run)])
    rng = np.random.default_rng(0)
    resampled = rng.choice(means, (RESAMPLES, len(means))).mean(axis=1)
    rms = np.sqrt(table[:, 1:].mean(axis=0))
    return {
        "runs": len(means),
        "samples": len(table),
        "nees_per_dof": float(means.mean()),
        "nees_95": [float(value) for value in np.percentile(resampled, (2.5, 97.5))],
        "nees_median_run": float(np.median(means)),
        "within_95_gate": float((table[:, 0] < GATE_95).mean()),
        "error_m": float(rms[0]),
        "error_rad": float(rms[1]),
        "sigma_m": float(rms[2]),
        "sigma_rad": float(rms[3]),
    }


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.consistency", __doc__)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=60.0, help="simulated, of one drive")
    parser.add_argument("--every", type=float, default=5.0, help="seconds between two samples")
    arguments = parser.parse_args(argv)
    ensure_warm()
    runs = []
    for seed in range(arguments.runs):
        runs.append(drive(seed, arguments.seconds, arguments.every))
        share = runs[-1][:, 0].mean() / 3.0 if len(runs[-1]) else float("nan")
        print(f"  drive {seed + 1} of {arguments.runs}: NEES / 3 = {share:.3f}", flush=True)
    figures = summarise(runs)
    print(aligned([(name, str(value)) for name, value in figures.items()]))
    write_figures(figures, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
