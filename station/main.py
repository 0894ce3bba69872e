"""`earshot`: the one command, and what each of its subcommands does with an error.

Every command has a module of its own, which says its options and imports what it needs only when
it is run: `earshot robot` starts without the report's pictures, `--help` without anything.
"""

import argparse
import logging
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version

from protocol.errors import EarshotError
from station import (
    command_doctor,
    command_keys,
    command_maps,
    command_merge,
    command_optimise,
    command_radio,
    command_robot,
    command_run,
    command_slam,
    command_warm_up,
    command_world,
)

COMMANDS = (
    command_run,
    command_world,
    command_robot,
    command_keys,
    command_slam,
    command_merge,
    command_optimise,
    command_maps,
    command_radio,
    command_warm_up,
    command_doctor,
)
EXAMPLES = """examples:
  earshot run                                  three robots map the shipped office
  earshot run --robots 2 --map loop --range 6  two robots that hear each other up to 6 m
  earshot run runs/latest/scenario.yaml        the last run again
  earshot doctor                               is everything here that a run needs?

`earshot COMMAND --help` has more of each."""

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code. Errors of ours are one line and exit code 2."""
    args = make_parser().parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, format="earshot: %(message)s", stream=sys.stderr)
    try:
        code: int = args.run(args)
    except EarshotError as error:
        print(f"earshot: {error}", file=sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt:
        print("earshot: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    return code


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="earshot",
        description="A team of robots that map a building together and can talk only within "
        "earshot of each other.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"earshot {_version()}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add_parser(commands)
    return parser


def _version() -> str:
    try:
        return version("earshot-slam")
    except PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    sys.exit(main())
