"""Runs from Python.

from station.api import Scenario, run
result = run(Scenario(map="rooms-small", seed=1), out="report")
print(result.metrics.coverage)
"""

from dataclasses import dataclass
from pathlib import Path

from station.hosts import Mode
from station.launch import launch
from station.observer import Observer, RunOutcome
from station.report import write_report
from station.report_metrics import Metrics, measure
from world.scenario import GateConfig, RobotSpec, Scenario

__all__ = ["GateConfig", "RobotSpec", "RunResult", "Scenario", "run"]


@dataclass(frozen=True, slots=True)
class RunResult:
    """`metrics` in numbers; `outcome` is all the rest: maps, trajectories, reports, the world."""

    metrics: Metrics
    outcome: RunOutcome


def run(
    scenario: Scenario,
    *,
    out: Path | str | None = None,
    mode: Mode = "inline",
    observer: Observer | None = None,
) -> RunResult:
    """Play a scenario to its end and judge it; with `out`, also write the report into that folder.

    Without another `mode` everything happens in this process, without a network. Raises an
    EarshotError, whose message says what to do, for a scenario that cannot be played.
    """
    folder = None if out is None else Path(out)
    outcome = launch(scenario, mode, observer, folder=folder and folder / "robots")
    metrics = measure(outcome) if folder is None else write_report(outcome, folder)
    return RunResult(metrics, outcome)
