"""`earshot warm-up`: compile the kernels before the first run needs them."""

import argparse

from station.options import SubParsers, add_command

EXAMPLES = """examples:
  earshot warm-up
  earshot warm-up && earshot run"""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "warm-up", "compile the kernels, once", EXAMPLES)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    del args
    from station.warm_up import cache_folder, ensure_warm

    ensure_warm()
    print(f"kernels are compiled, in {cache_folder()}")
    return 0
