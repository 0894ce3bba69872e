"""Merging maps of two robots that do not know where the other started, from lidar alone.

    python -m studies.merging --trials 60 --json merging.json
    python -m studies.merging --maps office,loop --runs 8 --trials 200 --out runs/merging

Robots explore alone, out of everybody's earshot, and their journals are kept. A trial takes two of
them, from one world or from two, each cut off at a random length, and merges them. It is *right*
when the alignment is within 5 cm and 1° of the truth, *false* when it is farther or the worlds
differ, and *undecided* when none is claimed. A study that was cut off goes on where it stopped.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from protocol.config import LidarConfig
from protocol.errors import EarshotError
from protocol.model import Model
from protocol.pose import Pose2, compose
from robot.brain import Brain
from robot.journal_file import frame_record
from robot.recollection import read_records
from robot.slam.engine import Anchor, Closure, Keyframe
from robot.team.entries import Hello, Known, decode_entry
from robot.team.hypothesis import solve_alone
from robot.team.joint import Solution
from robot.team.journal import LogName, decode_record
from robot.team.pair_judge import State
from station.merge import make_graph, merge
from station.merge_metrics import compare_grids, draw_grid
from studies.command import study_parser, write_figures
from world.scenario import GateConfig, RobotSpec, Scenario
from world.simulation import Simulation

RIGHT_M, RIGHT_RAD = 0.05, math.radians(1.0)
CLASSES = ((0.5, "≥ 50 %"), (0.3, "30–50 %"), (0.0, "< 30 %"))
OTHER_WORLD = "other world"
OUTCOMES = ("right", "undecided", "false")
SHORTEST = 0.4
ONE, TWO = LogName("a", 0), LogName("b", 0)


class Trial(Model):
    """One trial: which journals, how much of each, and what came of it."""

    number: int
    worlds: tuple[str, str]
    seeds: tuple[int, int]
    shares: tuple[float, float]
    overlap: float | None
    state: str
    reason: str
    error_m: float | None
    error_rad: float | None
    outcome: str


def record(world: str, seed: int, seconds: float, folder: Path) -> tuple[list[Known], Pose2]:
    """The entries of a robot that explored a world alone, and where it started."""
    path = folder / f"{Path(world).stem}-{seed}.journal"
    scenario = Scenario(
        map=world,
        seed=seed,
        robots=(RobotSpec(name="r1"),),
        starts="unknown",
        radio=GateConfig(range_m=0.0),
        max_sim_s=seconds,
    )
    simulation = Simulation(scenario)
    start = Pose2.from_array(simulation.starts[0])
    if not path.exists():
        brain = Brain(simulation.robot_config("r1"))
        records: list[bytes] = []
        senses = simulation.step({})
        while not simulation.done:
            action = brain.step(senses["r1"])
            records += brain.take_records()
            senses = simulation.step({"r1": action})
        partial = path.with_suffix(".part")
        partial.write_bytes(b"".join(frame_record(one) for one in records))
        partial.replace(path)
    entries = []
    for one in read_records(path):
        name, body = decode_record(one)
        entries.append(decode_entry(body, name.sequence))
    return entries, start


def cut(entries: list[Known], share: float) -> list[Known]:
    """The first entries of a journal, up to a share of its keyframes."""
    wanted = max(3, round(share * sum(isinstance(entry, Keyframe) for entry in entries)))
    kept: list[Known] = []
    for entry in entries:
        if isinstance(entry, Hello):
            kept.append(replace(entry, start=None))
        elif isinstance(entry, Anchor | Keyframe | Closure):
            kept.append(entry)
        wanted -= isinstance(entry, Keyframe)
        if wanted == 0:
            break
    return kept


def run_trial(number: int, chosen: "Choice", folder: Path, seconds: float) -> Trial:
    """Merge two journals and hold the result against the truth."""
    lidar = LidarConfig()
    logs: dict[LogName, list[Known]] = {}
    starts: list[Pose2] = []
    for name, world, seed, share in zip(
        (ONE, TWO), chosen.worlds, chosen.seeds, chosen.shares, strict=True
    ):
        entries, start = record(world, seed, seconds, folder)
        logs[name] = cut(entries, share)
        starts.append(start)
    merged = merge(logs, lidar)
    view = merged.alignment.pair(ONE, TWO)
    state = view.state if view else State.UNKNOWN
    same = chosen.worlds[0] == chosen.worlds[1]
    T_true = starts[0].inverse() @ starts[1]
    error_m = error_rad = None
    if state is State.ALIGNED and same:
        missed = T_true.inverse() @ _transform(merged.solutions[0])
        error_m, error_rad = math.hypot(missed.x, missed.y), abs(missed.theta)
    outcome = "undecided"
    if state is State.ALIGNED:
        outcome = "right" if _is_right(error_m, error_rad) else "false"
    return Trial(
        number=number,
        worlds=chosen.worlds,
        seeds=chosen.seeds,
        shares=chosen.shares,
        overlap=true_overlap(logs, T_true, lidar) if same else None,
        state=state.value,
        reason=view.reason if view else "",
        error_m=error_m,
        error_rad=error_rad,
        outcome=outcome,
    )


def _is_right(error_m: float | None, error_rad: float | None) -> bool:
    if error_m is None or error_rad is None:
        return False
    return error_m <= RIGHT_M and error_rad <= RIGHT_RAD


def true_overlap(logs: dict[LogName, list[Known]], T_one_two: Pose2, lidar: LidarConfig) -> float:
    """Free cells in both maps by those of the smaller, where both truly lie."""
    graph = make_graph(logs)
    one, two = solve_alone(graph, ONE).anchors, solve_alone(graph, TWO).anchors
    grids = (
        draw_grid(graph, ONE, one, lidar),
        draw_grid(graph, TWO, compose(T_one_two.to_array(), two), lidar),
    )
    return compare_grids(*grids)[0] or 0.0


class Choice(Model):
    """What a trial merges."""

    worlds: tuple[str, str]
    seeds: tuple[int, int]
    shares: tuple[float, float]


def choices(maps: list[str], runs: int, trials: int, seed: int) -> Iterator[Choice]:
    """Trials drawn by a seed: three of four within one world, the others from two."""
    for number in range(trials):
        rng = np.random.default_rng((seed, number))
        one = maps[int(rng.integers(len(maps)))]
        two = one
        if len(maps) > 1 and rng.random() < 0.25:
            two = [world for world in maps if world != one][int(rng.integers(len(maps) - 1))]
        first, second = rng.choice(runs, 2, replace=False).tolist()
        shares = tuple(np.round(rng.uniform(SHORTEST, 1.0, 2), 3).tolist())
        yield Choice(worlds=(one, two), seeds=(first, second), shares=shares)


def table(trials: list[Trial]) -> str:
    """Outcomes by overlap."""
    labels = [*(label for _, label in CLASSES), OTHER_WORLD]
    rows = {label: [trial for trial in trials if class_of(trial) == label] for label in labels}
    lines = [f"{'overlap':>12}  {'trials':>6}  {'right':>6}  {'undecided':>9}  {'false':>5}"]
    for label, found in rows.items():
        count = {what: sum(t.outcome == what for t in found) for what in OUTCOMES}
        lines.append(
            f"{label:>12}  {len(found):>6}  {count['right']:>6}  {count['undecided']:>9}  "
            f"{count['false']:>5}"
        )
    return "\n".join(lines)


def class_of(trial: Trial) -> str:
    if trial.overlap is None:
        return OTHER_WORLD
    return next(label for least, label in CLASSES if trial.overlap >= least)


def _transform(solution: Solution) -> Pose2:
    """`T_one_two` between first anchors."""
    one, two = (Pose2.from_array(solution[name][0]) for name in (ONE, TWO))
    return one.inverse() @ two


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = study_parser("studies.merging", __doc__)
    parser.add_argument("--maps", default="office,loop,rooms-small", help="names or YAML files")
    parser.add_argument("--runs", type=int, default=4, help="journals kept of each map")
    parser.add_argument("--seconds", type=float, default=90.0, help="simulated, of each journal")
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/merging"), help="kept journals")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    arguments = _arguments(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    done_file = arguments.out / "trials.jsonl"
    done = _read_done(done_file)
    trials: list[Trial] = []
    maps = arguments.maps.split(",")
    try:
        for number, chosen in enumerate(
            choices(maps, arguments.runs, arguments.trials, arguments.seed)
        ):
            trial = done.get(_key(number, chosen.model_dump(mode="json")))
            if trial is None:
                trial = run_trial(number, chosen, arguments.out, arguments.seconds)
                with done_file.open("a") as file:
                    file.write(trial.model_dump_json() + "\n")
            trials.append(trial)
            where = f"[{number + 1}/{arguments.trials}]"
            print(f"{where} {class_of(trial)}: {trial.outcome}", flush=True)
    except EarshotError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(table(trials))
    rows = [trial.model_dump(mode="json") for trial in trials]
    write_figures(rows, arguments.json)
    return 0


def _read_done(path: Path) -> dict[str, Trial]:
    if not path.exists():
        return {}
    found = {}
    for line in path.read_text().splitlines():
        trial = Trial.model_validate_json(line)
        found[_key(trial.number, trial.model_dump(mode="json"))] = trial
    return found


def _key(number: int, fields: dict[str, Any]) -> str:
    return json.dumps([number, *(fields[name] for name in ("worlds", "seeds", "shares"))])


if __name__ == "__main__":
    sys.exit(main())
