"""What every command does around a run: watch it on the screen, then write its report."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from station.live import LiveTable, Observers, PlainLines
from station.live_picture import LivePicture
from station.observer import Observer, RunOutcome
from station.report import TEAM_PICTURE, write_report
from station.report_folder import run_folder
from station.report_tables import metrics_table
from world.pace import NO_ANSWER
from world.process import INTERRUPTED
from world.simulation import NOBODY_LEFT

Play = Callable[[Observer, Path], RunOutcome]


def run_at_desk(args: argparse.Namespace, play: Play) -> int:
    """Play a run under the eyes of the operator; returns the command's exit code.

    The last line printed is the report's folder and its picture.
    """
    folder = run_folder(args.out)
    screen = PlainLines() if args.headless or not sys.stdout.isatty() else LiveTable()
    picture = LivePicture(args.picture or folder / "live.png")
    print(f"live picture: {picture.path}", flush=True)
    with Observers([screen, picture]) as observers:
        outcome = play(observers, folder)
    metrics = write_report(outcome, folder, screen.tracker.coverage)
    if args.json is not None:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(metrics.model_dump_json(indent=2) + "\n", encoding="utf-8")
    print(metrics_table(metrics))
    print(f"report: {folder}  picture: {folder / TEAM_PICTURE}", flush=True)
    return _exit_code(outcome.exit_reason)


def _exit_code(reason: str) -> int:
    if reason == INTERRUPTED:
        return 130
    return 1 if reason in (NOBODY_LEFT, NO_ANSWER) else 0
