"""`earshot keys r1 r2 …`: what robots prove their names with to a world on another machine."""

import argparse
from pathlib import Path

from station.options import SubParsers, add_command

EXAMPLES = """examples:
  earshot keys r1 r2 r3 --out keys
  earshot keys r4 --out keys             one more; the others keep theirs

The world takes the folder, and each robot the one file that is its own:
  earshot world --keys keys --listen tcp/0.0.0.0:7447
  earshot robot r1 --keys r1.key --connect tcp/HOST:7447
`earshot run` makes keys for itself and throws them away at its end."""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "keys", "make keys for the robots of a team", EXAMPLES)
    parser.add_argument("names", nargs="+", metavar="NAME", help="of a robot")
    parser.add_argument(
        "--out", type=Path, default=Path("keys"), metavar="DIR", help="their folder (default keys)"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from protocol.keys import make_keys

    made = make_keys(args.out, args.names)
    for path in made:
        print(path)
    if not made:
        print(f"all of them have keys in {args.out} already")
    return 0
