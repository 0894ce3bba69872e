"""Is a run the same however it is hosted? Hashes of four ways to run, side by side.

    python -m studies.determinism --maps rooms-small,office --seeds 0-2 --json hashes.json

Each run of a map and seed starts from nothing: inline, in memory, in processes, and with world and
robots on hosts of their own (network namespaces; left out, saying so, where they are not allowed),
each under two hash seeds of Python. A case is equal when trajectories, maps, journals, ledger and
true history of all its runs have one hash each.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protocol.errors import EarshotError
from station.hashes import run_hashes
from station.hosts import MODES
from station.launch import launch
from station.warm_up import ensure_warm
from studies.command import one_line_errors, study_parser, write_figures
from studies.namespaces import NetworkError, network, run_on_hosts
from studies.trials import parse_seeds
from world.scenario import PaceConfig, RobotSpec, Scenario

NAMESPACES = "namespaces"
HASH_SEEDS = ("1", "77")
WAIT_S = 600.0

Hashes = dict[str, str]


@dataclass(frozen=True, slots=True)
class Run:
    """One of the runs that must be equal, and what it came to."""

    way: str
    hash_seed: str
    hashes: Hashes


def ways() -> tuple[str, ...]:
    """The ways to run that are possible here."""
    try:
        with network(("probe",)):
            return (*MODES, NAMESPACES)
    except NetworkError as error:
        print(f"without hosts of their own: {error}", file=sys.stderr)
        return MODES


def runs(scenario: Scenario, chosen: Sequence[str], hash_seeds: Sequence[str]) -> Iterator[Run]:
    """The same scenario in each way under each hash seed. Raises EarshotError if one fails."""
    for way in chosen:
        for seed in hash_seeds:
            yield Run(way, seed, _play(scenario, way, seed))


def _play(scenario: Scenario, way: str, hash_seed: str) -> Hashes:
    environment = {"PYTHONHASHSEED": hash_seed}
    with tempfile.TemporaryDirectory(prefix="earshot-") as scratch:
        if way == NAMESPACES:
            metrics = json.loads(run_on_hosts(scenario, Path(scratch), environment).read_text())
            found: Hashes = metrics["hashes"]
            return found
        command = [sys.executable, "-m", "studies.determinism", "--be", way]
        root = str(Path(__file__).resolve().parents[1])
        played = subprocess.run(
            [*command, scenario.model_dump_json()],
            cwd=scratch,
            env={**os.environ, "PYTHONPATH": root, **environment},
            capture_output=True,
            text=True,
            timeout=WAIT_S,
            check=False,
        )
    if played.returncode != 0:
        raise EarshotError(f"{way} failed: {played.stderr.strip()[-500:]}")
    result: Hashes = json.loads(played.stdout.splitlines()[-1])
    return result


def same(found: Sequence[Run]) -> dict[str, bool]:
    """For each kind of hash, whether all runs have one."""
    return {
        kind: len({run.hashes.get(kind) for run in found}) == 1 for kind in sorted(found[0].hashes)
    }


def case(scenario: Scenario, chosen: Sequence[str], hash_seeds: Sequence[str]) -> dict[str, Any]:
    """All runs of one scenario, held against each other."""
    found = list(runs(scenario, chosen, hash_seeds))
    equal = same(found)
    return {
        "map": scenario.map,
        "seed": scenario.seed,
        "runs": len(found),
        "equal": all(equal.values()),
        "by_kind": equal,
        "hashes": {f"{run.way}/{run.hash_seed}": run.hashes for run in found},
    }


def scenario_of(name: str, seed: int, robots: int, seconds: float) -> Scenario:
    """Hashes agree when nobody is late: a loaded machine must not make anybody so."""
    return Scenario(
        map=name,
        seed=seed,
        robots=tuple(RobotSpec(name=f"r{n + 1}") for n in range(robots)),
        max_sim_s=seconds,
        pace=PaceConfig(deadline_s=WAIT_S),
    )


def line(row: dict[str, Any]) -> str:
    """One case: its first letters of each hash where they agree."""
    (first, *_) = row["hashes"].values()
    words = [
        f"{kind} {first[kind][:8]}" if alike else f"{kind} DIFFERS"
        for kind, alike in row["by_kind"].items()
    ]
    verdict = "equal" if row["equal"] else "DIFFERENT"
    return f"{row['map']:>14} {row['seed']:>3}  {row['runs']} runs {verdict}  {', '.join(words)}"


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.determinism", __doc__)
    parser.add_argument("--maps", default="rooms-small,office", metavar="MAP,…")
    parser.add_argument("--seeds", type=parse_seeds, default=[0, 1, 2], help="e.g. 0-2")
    parser.add_argument("--robots", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="simulated")
    parser.add_argument("--be", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    rows = []
    if arguments.be:
        way, scenario = arguments.be
        outcome = launch(Scenario.model_validate_json(scenario), way)
        print(json.dumps(run_hashes(outcome)))
        return 0
    ensure_warm()
    chosen = ways()
    for name in arguments.maps.split(","):
        for seed in arguments.seeds:
            scenario = scenario_of(name, seed, arguments.robots, arguments.seconds)
            rows.append(case(scenario, chosen, HASH_SEEDS))
            print(line(rows[-1]), flush=True)
    write_figures({"ways": chosen, "cases": rows}, arguments.json)
    return 0 if all(row["equal"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
