"""Merging maps of two robots that do not know where the other started, from lidar alone.

    python -m studies.merging --trials 300 --json merging.json
    python -m studies.merging repeating MAPS/aces.yaml --trials 300 --json repeating.json
    python -m studies.merging scoring --trials 0 --others 400 --json others.json

Robots explore alone, out of everybody's earshot, and their journals are kept. A trial takes two of
them, each cut off at a random length, and merges them as `earshot merge` does. Outcomes are told in
`studies.merging_truth`. The same two maps are merged by the usual method, features of images.
Trials are from one world, `--others` from two. A study that was cut off goes on where it stopped.
"""

import argparse
import multiprocessing
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import combinations
from pathlib import Path

import numpy as np

from maps.grid import OccupancyGrid
from protocol.model import Model
from protocol.pose import Pose2, compose
from robot.team.hypothesis import solve_alone
from robot.team.joint import JointGraph
from robot.team.pair_judge import State
from station.merge import make_graph, merge
from station.merge_metrics import compare_grids, draw_grid
from station.warm_up import ensure_warm
from studies.command import end_with_parent, one_line_errors, study_parser, write_figures
from studies.grid_features import DETECTORS, merge_by_features
from studies.lone_journals import lone_journal
from studies.merging_truth import LIDAR, ONE, OUTCOMES, TWO, Truth, outcome_of
from studies.merging_worlds import is_told_apart, kind_of, repeats, worlds_of

CLASSES = ((0.5, "≥ 50 %"), (0.3, "30–50 %"), (0.0, "< 30 %"))
SHORTEST = 0.3

TRIALS = "trials.jsonl"


class Pair(Model):
    """Two journals: in which worlds, by which seeds, of how many seconds."""

    worlds: tuple[str, str]
    seeds: tuple[int, int]
    seconds: float


class Choice(Model):
    """What a trial merges: the share of its keyframes that is left of either journal."""

    number: int
    pair: Pair
    shares: tuple[float, float]


class Trial(Model):
    """What came of a choice. `told`: whether what both have seen leaves one answer only; `usual`:
    what came of the usual method, by its features."""

    choice: Choice
    overlap: float | None
    told: bool
    state: str
    reason: str
    outcome: str
    error_m: float | None
    error_rad: float | None
    starts_m: float | None
    seconds: float
    usual: dict[str, str]


def choices(
    worlds: list[str], runs: int, seconds: float, trials: int, others: int, seed: int
) -> Iterator[Choice]:
    """Trials within a world, going through all pairs of journals, then others from two worlds."""
    within = [
        Pair(worlds=(world, world), seeds=two, seconds=seconds)
        for two in combinations(range(runs), 2)
        for world in worlds
    ]
    pairs = [within[number % len(within)] for number in range(trials)]
    for number in range(others):
        rng = np.random.default_rng((seed, 1, number))
        one, two = rng.choice(worlds, 2, replace=False).tolist()
        seeds = (int(rng.integers(runs)), int(rng.integers(runs)))
        pairs.append(Pair(worlds=(one, two), seeds=seeds, seconds=seconds))
    for number, pair in enumerate(pairs):
        rng = np.random.default_rng((seed, 2, number))
        one, two = np.round(rng.uniform(SHORTEST, 1.0, 2), 3).tolist()
        yield Choice(number=number, pair=pair, shares=(one, two))


def run_trial(choice: Choice, folder: Path) -> Trial:
    """Merge two journals as they were when cut off, and hold the result against the truth."""
    pair = choice.pair
    one, two = (
        lone_journal(world, seed, pair.seconds, folder).cut(share)
        for world, seed, share in zip(pair.worlds, pair.seeds, choice.shares, strict=True)
    )
    truth = Truth(one, two)
    logs = {ONE: one.entries, TWO: two.entries}
    graph = make_graph(logs)
    grids = {name: draw_grid(graph, name, solve_alone(graph, name).anchors, LIDAR) for name in logs}
    overlap = true_overlap(graph, truth.T_starts) if truth.same else None
    began = time.perf_counter()
    merged = merge(logs, LIDAR)
    took = time.perf_counter() - began
    view = merged.alignment.pair(ONE, TWO)
    aligned = view is not None and view.state is State.ALIGNED
    claimed = aligned and truth.same
    errors = truth.errors(merged.graph, merged.solutions[0]) if claimed else None
    return Trial(
        choice=choice,
        overlap=overlap,
        told=overlap is not None and is_told_apart(one, two, overlap),
        state=(view.state if view else State.UNKNOWN).value,
        reason=view.reason if view else "",
        outcome=outcome_of(aligned, errors),
        error_m=errors.metres if errors else None,
        error_rad=errors.radians if errors else None,
        starts_m=errors.starts_m if errors else None,
        seconds=took,
        usual={
            detector: usual_outcome(truth, grids[ONE], grids[TWO], detector)
            for detector in DETECTORS
        },
    )


def usual_outcome(truth: Truth, one: OccupancyGrid, two: OccupancyGrid, detector: str) -> str:
    """What came of merging the pictures of the two maps, each in the frame of its first anchor."""
    found = merge_by_features(one, two, detector)
    if found is None or not found.accepted:
        return "undecided"
    return outcome_of(True, truth.of_transform(found.T_a_b) if truth.same else None)


def true_overlap(graph: JointGraph, T_one_two: Pose2) -> float:
    """Free cells in both maps by those of the smaller, where both truly lie."""
    one, two = (solve_alone(graph, name).anchors for name in (ONE, TWO))
    grids = (
        draw_grid(graph, ONE, one, LIDAR),
        draw_grid(graph, TWO, compose(T_one_two.to_array(), two), LIDAR),
    )
    return compare_grids(*grids)[0] or 0.0


def label_of(trial: Trial) -> str:
    """The row of the table that a trial counts in."""
    world, _ = trial.choice.pair.worlds
    if trial.overlap is None:
        return "other worlds"
    if repeats(world):
        return f"{kind_of(world)}, {'told apart' if trial.told else 'both answers fit'}"
    return "overlap " + next(label for least, label in CLASSES if trial.overlap >= least)


def table(trials: list[Trial]) -> str:
    """Outcomes of ours and of the usual method, by overlap or by what tells apart."""
    methods = ("earshot", *DETECTORS)
    head = "".join(f"  {method:>{4 * 9 + 6}}" for method in methods)
    lines = [f"{'':>28}  {'':>6}{head}"]
    lines.append(f"{'':>28}  {'trials':>6}" + "".join(f"  {o:>9}" for o in OUTCOMES) * len(methods))
    for label in sorted({label_of(trial) for trial in trials}, reverse=True):
        found = [trial for trial in trials if label_of(trial) == label]
        counts = ""
        for method in methods:
            outcomes = [
                trial.outcome if method == "earshot" else trial.usual[method] for trial in found
            ]
            counts += "".join(f"  {outcomes.count(what):>9}" for what in OUTCOMES)
        lines.append(f"{label:>28}  {len(found):>6}{counts}")
    return "\n".join(lines)


def _done(path: Path) -> dict[Choice, Trial]:
    """What an earlier study left there."""
    if not path.exists():
        return {}
    lines = path.read_text().splitlines()
    return {trial.choice: trial for trial in map(Trial.model_validate_json, lines)}


def study(asked: list[Choice], out: Path, jobs: int) -> Iterator[Trial]:
    """All trials, as they come; what was done before is not done again."""
    done = _done(out / TRIALS)
    waiting = [choice for choice in asked if choice not in done]
    yield from (done[choice] for choice in asked if choice in done)
    for trial in _each(waiting, out, jobs):
        with (out / TRIALS).open("a") as file:
            file.write(trial.model_dump_json() + "\n")
        yield trial


def _each(waiting: list[Choice], out: Path, jobs: int) -> Iterable[Trial]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, initializer=end_with_parent) as pool:
        # Journals first: two workers that need the same one would both play it.
        journals = {
            (world, seed, choice.pair.seconds)
            for choice in waiting
            for world, seed in zip(choice.pair.worlds, choice.pair.seeds, strict=True)
        }
        running = [pool.submit(lone_journal, *one, out) for one in sorted(journals)]
        try:
            for played in as_completed(running):
                played.result()
            merging = [pool.submit(run_trial, choice, out) for choice in waiting]
            for future in as_completed(merging):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = study_parser("studies.merging", __doc__)
    parser.add_argument(
        "worlds",
        nargs="*",
        default=["scoring"],
        help="tuning, scoring, tuning-repeating, repeating, names of maps, YAML files",
    )
    parser.add_argument("--runs", type=int, default=4, help="journals of each world")
    parser.add_argument("--seconds", type=float, default=180.0, help="simulated, of each journal")
    parser.add_argument("--trials", type=int, default=300, help="of two journals from one world")
    parser.add_argument("--others", type=int, default=0, help="trials of journals from two worlds")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, default=Path("runs/merging"), help="kept journals")
    return parser.parse_args(argv)


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    arguments = _arguments(argv)
    ensure_warm()
    arguments.out.mkdir(parents=True, exist_ok=True)
    worlds = [world for names in arguments.worlds for world in worlds_of(names)]
    asked = list(
        choices(
            worlds,
            arguments.runs,
            arguments.seconds,
            arguments.trials,
            arguments.others,
            arguments.seed,
        )
    )
    trials: list[Trial] = []
    for trial in study(asked, arguments.out, arguments.jobs):
        trials.append(trial)
        print(f"[{len(trials)}/{len(asked)}] {label_of(trial)}: {trial.outcome}", flush=True)
    trials.sort(key=lambda trial: trial.choice.number)
    print(table(trials))
    write_figures([trial.model_dump(mode="json") for trial in trials], arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
