"""What the commands of all studies share: their options, and how they tell their figures."""

import argparse
import functools
import json
import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Protocol

from protocol.errors import EarshotError


class Main(Protocol):
    """A command line's entry: arguments, or those of the process, to its exit code."""

    def __call__(self, argv: list[str] | None = None) -> int: ...


def study_parser(module: str, about: str | None) -> argparse.ArgumentParser:
    """A parser with the module's text as its help, and `--json`."""
    parser = argparse.ArgumentParser(
        prog=f"python -m {module}",
        description=about,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    return parser


def one_line_errors(main: Main) -> Main:
    """Have a study's `main` say in one line what was wrong, and end with 2; with 130 on Ctrl-C."""

    @functools.wraps(main)
    def guarded(argv: list[str] | None = None) -> int:
        try:
            return main(argv)
        except (EarshotError, BrokenProcessPool) as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            return 130

    return guarded


def write_figures(figures: object, path: Path | None) -> None:
    """Write a study's figures, if somebody asked for a file."""
    if path is not None:
        path.write_text(json.dumps(figures, indent=2) + "\n")


def print_figures(figures: Mapping[str, float]) -> None:
    """One figure a line, their values below each other."""
    print(aligned([(name, f"{value:.10g}") for name, value in figures.items()]))


def aligned(rows: Sequence[tuple[str, str]]) -> str:
    """Names and values a line each, the values below each other."""
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join(f"{name:>{width}}  {value}" for name, value in rows)


def end_with_parent() -> None:
    """Have this worker process end when the process that made it does, in whatever way."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_outlive_nobody, args=(parent.join,), daemon=True).start()


def _outlive_nobody(wait: Callable[[], None]) -> None:
    wait()
    os._exit(1)
