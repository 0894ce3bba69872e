"""False matches between robots: do they get into the map?

    python -m studies.false_matches --trials 500 --json false.json

Journals of two robots that explored one world are merged as in `studies.merging`; to the matches
that were found and verified false ones are added, until four of five are false. They say of
themselves what true ones do. Half of the trials draw each by itself; in the others they come in
groups that agree with each other on a wrong alignment, as look-alike rooms make them, the largest
as large as the true set. Outcomes are told in `studies.merging_truth`; a map that is not right but
claimed is *corrupted*. A study that was cut off goes on
where it stopped.
"""

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from protocol.model import Model
from protocol.pose import Pose2
from robot.perception.returns import noise_model
from robot.team.alignment import align
from robot.team.entries import Link
from robot.team.evidence import Kind
from robot.team.hypothesis import LoneLogs
from robot.team.joint import JointGraph, solve
from robot.team.journal import LogName
from robot.team.pair_judge import State
from station.merge import make_graph, merge
from station.warm_up import ensure_warm
from studies.command import aligned, one_line_errors, study_parser, write_figures
from studies.lone_journals import LoneJournal, lone_journal
from studies.merging_truth import LIDAR, ONE, OUTCOMES, TWO, Truth, outcome_of
from studies.merging_worlds import worlds_of

FALSE_SHARE = 0.8
# Where a false alignment may put the other robot.
REACH_M = 20.0
DONE = "false_matches.jsonl"


class Trial(Model):
    """One trial: how many true and false matches there were, and what came of it."""

    number: int
    world: str
    seeds: tuple[int, int]
    grouped: bool
    true: int
    false: int
    false_counted: int
    """False matches that count in the alignment."""
    state: str
    reason: str
    outcome: str
    error_m: float | None
    error_rad: float | None


class Stage:
    """Two journals with the matches between them, and how they truly lie."""

    def __init__(self, one: LoneJournal, two: LoneJournal) -> None:
        self.logs = {ONE: one.entries, TWO: two.entries}
        self.seeds = (one.seed, two.seed)
        self.world = one.world
        self.truth = Truth(one, two)
        self._lone = LoneLogs(make_graph(self.logs))
        found = merge(self.logs, LIDAR).graph
        self.matches: list[tuple[LogName, Link]] = []
        """Who found it, and what: true ones, and those that the search got wrong by itself."""
        for name in (ONE, TWO):
            log = found.log(name)
            assert log is not None
            for link in log.links:
                if link.evidence.kind is not Kind.NEAR:
                    self.matches.append((name, link))

    def graph(self, lies: list[Link]) -> JointGraph:
        """The journals with all matches, lies last, as found by the first robot."""
        graph = make_graph(self.logs)
        for holder, link in self.matches:
            graph.add(holder, link)
        for lie in lies:
            graph.add(ONE, lie)
        return graph

    def false_matches(self, rng: np.random.Generator, grouped: bool) -> list[Link]:
        """As many as make the share of false ones, alone or in groups that agree."""
        wanted = round(len(self.matches) * FALSE_SHARE / (1.0 - FALSE_SHARE))
        lies: list[Link] = []
        while len(lies) < wanted:
            T_one_two = _anywhere(rng)
            size = int(rng.integers(2, len(self.matches) + 2)) if grouped else 1
            lies += [self._lie(rng, T_one_two) for _ in range(min(size, wanted - len(lies)))]
        return lies

    def _lie(self, rng: np.random.Generator, T_one_two: Pose2) -> Link:
        """A match between two anchors that says that the logs lie to each other in this way."""
        _, like = self.matches[int(rng.integers(len(self.matches)))]
        ours, theirs = self._lone[ONE].anchors, self._lone[TWO].anchors
        of, to = int(rng.integers(len(ours))), int(rng.integers(len(theirs)))
        noise = Pose2.from_array(rng.normal(0.0, [0.01, 0.01, 0.003]))
        T_of_to = Pose2.from_array(ours[of]).inverse() @ T_one_two @ Pose2.from_array(theirs[to])
        return replace(like, of=of, log=TWO, to=to, T_of_to=T_of_to @ noise)


def _anywhere(rng: np.random.Generator) -> Pose2:
    x, y = rng.uniform(-REACH_M, REACH_M, 2)
    return Pose2(float(x), float(y), float(rng.uniform(-math.pi, math.pi)))


def run_trial(number: int, stage: Stage, seed: int, grouped: bool) -> Trial:
    """Add false matches, align, and hold the joint solution against the truth."""
    lies = stage.false_matches(np.random.default_rng((seed, number)), grouped)
    graph = stage.graph(lies)
    alignment = align(graph, noise_model(LIDAR))
    view = alignment.pair(ONE, TWO)
    assert view is not None
    errors, counted = None, 0
    held = view.state is State.ALIGNED
    if held:
        (group,) = alignment.groups
        errors = stage.truth.errors(graph, solve(graph.problem(group)))
        true = sum(name == ONE for name, _ in stage.matches)
        counted = sum(name == ONE and index >= true for name, index in group.links)
    return Trial(
        number=number,
        world=stage.world,
        seeds=stage.seeds,
        grouped=grouped,
        true=len(stage.matches),
        false=len(lies),
        false_counted=counted,
        state=view.state.value,
        reason=view.reason,
        outcome=outcome_of(held, errors),
        error_m=errors.metres if errors else None,
        error_rad=errors.radians if errors else None,
    )


def stages(worlds: list[str], runs: int, seconds: float, folder: Path) -> Iterator[Stage]:
    """The pairs of journals that are merged rightly without lies."""
    for seeds in combinations(range(runs), 2):
        for world in worlds:
            stage = Stage(*(lone_journal(world, seed, seconds, folder) for seed in seeds))
            if stage.matches and _is_right(stage):
                yield stage


def _is_right(stage: Stage) -> bool:
    """Whether what was found is enough for an alignment, and where it must be."""
    graph = stage.graph([])
    alignment = align(graph, noise_model(LIDAR))
    if len(alignment.groups) > 1:
        return False
    errors = stage.truth.errors(graph, solve(graph.problem(alignment.groups[0])))
    return outcome_of(True, errors) == "right"


def table(trials: list[Trial]) -> str:
    rows = []
    for grouped, label in ((False, "each by itself"), (True, "in groups that agree")):
        found = [trial for trial in trials if trial.grouped == grouped]
        counts = ", ".join(
            f"{sum(trial.outcome == what for trial in found)} {what}" for what in OUTCOMES
        )
        rows.append((f"{label}, {len(found)} trials", counts))
    counted = sum(trial.false_counted for trial in trials)
    total = sum(trial.false for trial in trials)
    rows.append(("false matches that count in a map", f"{counted} of {total}"))
    return aligned(rows)


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = study_parser("studies.false_matches", __doc__)
    parser.add_argument("worlds", nargs="*", default=["scoring"], help="as of studies.merging")
    parser.add_argument("--runs", type=int, default=4, help="journals of each world")
    parser.add_argument("--seconds", type=float, default=180.0, help="simulated, of each journal")
    parser.add_argument("--pairs", type=int, default=50, help="of journals that are drawn from")
    parser.add_argument("--trials", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/merging"), help="kept journals")
    return parser.parse_args(argv)


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    arguments = _arguments(argv)
    ensure_warm()
    arguments.out.mkdir(parents=True, exist_ok=True)
    worlds = [world for names in arguments.worlds for world in worlds_of(names)]
    done = _done(arguments.out / DONE)
    trials: list[Trial] = []
    found = stages(worlds, arguments.runs, arguments.seconds, arguments.out)
    for place, stage in zip(range(arguments.pairs), found, strict=False):
        for number in range(place, arguments.trials, arguments.pairs):
            # Both kinds on every pair of journals, whether or not there is an even number of pairs.
            grouped = (number // arguments.pairs + place) % 2 == 1
            trial = done.get((number, stage.world, stage.seeds, grouped))
            if trial is None:
                trial = run_trial(number, stage, arguments.seed, grouped)
                with (arguments.out / DONE).open("a") as file:
                    file.write(trial.model_dump_json() + "\n")
            trials.append(trial)
            print(f"[{len(trials)}/{arguments.trials}] {trial.outcome}", flush=True)
    print(table(trials))
    write_figures([trial.model_dump(mode="json") for trial in trials], arguments.json)
    return 0 if all(trial.outcome in ("right", "undecided") for trial in trials) else 1


def _done(path: Path) -> dict[tuple[int, str, tuple[int, int], bool], Trial]:
    """What an earlier study left there."""
    if not path.exists():
        return {}
    trials = map(Trial.model_validate_json, path.read_text().splitlines())
    return {(trial.number, trial.world, trial.seeds, trial.grouped): trial for trial in trials}


if __name__ == "__main__":
    sys.exit(main())
