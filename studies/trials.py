"""Many runs of one scenario under different seeds, as a table.

    python -m studies.trials --map office --seeds 0-9
    python -m studies.trials my_scenario.yaml --seeds 0-49 --json table.json

Each finished run is kept as a report folder, and a study that was cut off goes on where it
stopped. Runs are inline, which gives the same results as processes do.
"""

import argparse
import json
import multiprocessing
import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from statistics import mean
from typing import Any

from protocol.errors import EarshotError
from station.launch import launch
from station.observer import RunOutcome
from station.report import write_report
from station.scenario_file import changed, read_scenario
from studies.command import end_with_parent, one_line_errors, study_parser, write_figures
from world.process import INTERRUPTED
from world.scenario import Scenario

COLUMNS = (
    ("seed", "{:.0f}"),
    ("sim_s", "{:.0f}"),
    ("wall_s", "{:.0f}"),
    ("coverage", "{:.4f}"),
    ("coverage_worst_joint", "{:.4f}"),
    ("walls.recall", "{:.4f}"),
    ("walls.precision", "{:.4f}"),
    ("team.ate_rmse_m", "{:.4f}"),
    ("team.ate_online_rmse_m", "{:.4f}"),
    ("worst_robot_ate_m", "{:.4f}"),
    ("team.dead_reckoning_rmse_m", "{:.2f}"),
    ("collisions", "{:.0f}"),
    ("radio.bytes_delivered", "{:.0f}"),
    ("radio.bytes_per_metre", "{:.0f}"),
    ("exit_reason", "{}"),
)


def run_trial(scenario: Scenario, folder: Path) -> dict[str, Any]:
    """Run a scenario inline, write its report, and return its metrics as plain values."""
    outcome: RunOutcome = launch(scenario, "inline")
    if outcome.exit_reason == INTERRUPTED:
        raise KeyboardInterrupt  # half a run is none: it is played again
    metrics = write_report(outcome, folder).model_dump()
    errors = [robot["ate_rmse_m"] for robot in metrics["robots"].values()]
    metrics["worst_robot_ate_m"] = max((e for e in errors if e is not None), default=None)
    (folder / "trial.json").write_text(json.dumps(metrics))
    return metrics


def trials(
    scenario: Scenario, seeds: list[int], out: Path, workers: int
) -> Iterator[dict[str, Any]]:
    """The metrics of each seed as they come; those found in `out` are not run again."""
    waiting = {}
    for seed in seeds:
        folder = out / f"seed-{seed}"
        asked = scenario.model_copy(update={"seed": seed})
        found = _finished(folder, asked)
        if found is not None:
            yield found
        else:
            waiting[seed] = (asked, folder)
    # A fresh interpreter for each worker: nothing of this process decides a trial.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=end_with_parent) as pool:
        running = [pool.submit(run_trial, *waiting[seed]) for seed in sorted(waiting)]
        try:
            for future in as_completed(running):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _finished(folder: Path, scenario: Scenario) -> dict[str, Any] | None:
    done, said = folder / "trial.json", folder / "scenario.yaml"
    if not done.is_file() or not said.is_file():
        return None
    if read_scenario(said) != scenario:
        raise EarshotError(f"{folder} holds a run of another scenario: name another --out")
    found: dict[str, Any] = json.loads(done.read_text())
    return found


def table(rows: Iterable[dict[str, Any]]) -> str:
    """One line for each run, then least, mean and greatest of every number."""
    ordered = sorted(rows, key=lambda row: row["seed"])
    cells = [[name for name, _ in COLUMNS]]
    cells += [[_cell(_value(row, name), form) for name, form in COLUMNS] for row in ordered]
    for word, fold in (("least", min), ("mean", mean), ("greatest", max)):
        line = [word]
        for name, form in COLUMNS[1:]:
            values = [v for row in ordered if isinstance(v := _value(row, name), int | float)]
            line.append(_cell(fold(values), form) if values else "")
        cells.append(line)
    widths = [max(len(line[i]) for line in cells) for i in range(len(COLUMNS))]
    return "\n".join(
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True))
        for line in cells
    )


def _value(row: dict[str, Any], name: str) -> Any:
    value: Any = row
    for part in name.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value


def _cell(value: Any, form: str) -> str:
    return "-" if value is None else form.format(value)


def parse_seeds(text: str) -> list[int]:
    """`0-9`, `3`, or `0-4,7`. Raises ArgumentTypeError on anything else."""
    seeds: list[int] = []
    for part in text.split(","):
        first, dash, last = part.partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise argparse.ArgumentTypeError(f"{text!r} is not like 0-9, 3 or 0-4,7")
        seeds += range(int(first), int(last if dash else first) + 1)
    if not seeds:
        raise argparse.ArgumentTypeError(f"{text!r} counts backwards")
    return seeds


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = study_parser("studies.trials", __doc__)
    parser.add_argument("scenario", nargs="?", type=Path, help="a scenario file")
    parser.add_argument("--map", help="a shipped map or a map_server YAML file")
    parser.add_argument("--robots", type=int, help="how many robots")
    parser.add_argument("--range", type=float, metavar="METRES", help="radio range d")
    parser.add_argument("--starts", choices=("known", "same", "unknown"), help="are they told?")
    parser.add_argument("--seeds", type=parse_seeds, default=list(range(10)), help="e.g. 0-9")
    parser.add_argument("--workers", type=int, default=2, help="runs side by side")
    parser.add_argument("--out", type=Path, help="folder for the reports, runs/trials by default")
    return parser.parse_args(argv)


def _scenario(arguments: argparse.Namespace) -> Scenario:
    scenario = read_scenario(arguments.scenario) if arguments.scenario else Scenario()
    path = Path(arguments.map) if arguments.map else None
    name = str(path.resolve()) if path and path.is_file() else arguments.map
    return changed(
        scenario,
        {"map": name, "starts": arguments.starts, "radio": {"range_m": arguments.range}},
        robots=arguments.robots,
    )


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    arguments = _arguments(argv)
    scenario = _scenario(arguments)
    out = arguments.out or Path("runs") / f"trials-{Path(scenario.map).stem}"
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for row in trials(scenario, arguments.seeds, out, arguments.workers):
        rows.append(row)
        print(
            f"[{len(rows)}/{len(arguments.seeds)}] seed {row['seed']}: {row['exit_reason']} "
            f"after {row['sim_s']:.0f} s, coverage {_cell(row['coverage'], '{:.4f}')}",
            flush=True,
        )
    print(table(rows))
    write_figures(rows, arguments.json)
    print(f"reports: {out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
