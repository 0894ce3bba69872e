"""What the commands of all studies share: their options, and how they tell their figures."""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path


def study_parser(module: str, about: str | None) -> argparse.ArgumentParser:
    """A parser with the module's text as its help, and `--json`."""
    parser = argparse.ArgumentParser(
        prog=f"python -m {module}",
        description=about,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    return parser


def write_figures(figures: object, path: Path | None) -> None:
    """Write a study's figures, if somebody asked for a file."""
    if path is not None:
        path.write_text(json.dumps(figures, indent=2) + "\n")


def print_figures(figures: Mapping[str, float]) -> None:
    """One figure a line, their values below each other."""
    width = max(map(len, figures), default=0)
    for name, value in figures.items():
        print(f"{name:>{width}}  {value:.10g}")
