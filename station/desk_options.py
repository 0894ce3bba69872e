"""The options of watching and reporting; apart from `station.desk`, which imports pictures."""

import argparse
from pathlib import Path


def add_desk_options(parser: argparse.ArgumentParser) -> None:
    """How to watch a run, and where its report goes."""
    group = parser.add_argument_group("watching and reporting")
    group.add_argument(
        "--out", type=Path, metavar="DIR", help="the report's folder (default runs/<time>)"
    )
    group.add_argument("--json", type=Path, metavar="FILE", help="write the metrics here too")
    group.add_argument(
        "--picture", type=Path, metavar="FILE", help="the live picture (default live.png in DIR)"
    )
    group.add_argument("--headless", action="store_true", help="plain lines in place of a table")
