"""`earshot robot NAME`: one robot, as a process that looks for its world."""

import argparse
import sys
from pathlib import Path

from station.options import SubParsers, add_bus_options, add_command, bus_config_from

EXAMPLES = """examples:
  earshot robot r1 --connect tcp/127.0.0.1:7447 --keys keys/r1.key
  earshot robot r2 -e tcp/world:7447 --keys r2.key --journal journals

exit codes: 0 the run has ended, 2 an error, 3 the world is gone, 130 interrupted"""

EXIT_CODES = {"ENDED": 0, "WORLD_LOST": 3, "INTERRUPTED": 130}


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "robot", "be one robot of a run", EXAMPLES)
    parser.add_argument("name", metavar="NAME", help="as in the world's scenario")
    parser.add_argument(
        "--keys", type=Path, metavar="FILE", help="this robot's own key, made by `earshot keys`"
    )
    parser.add_argument(
        "--journal", type=Path, metavar="DIR", help="keep what the robot knows on disk, here"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on after a crash: remember what earlier lives left in --journal",
    )
    parser.add_argument(
        "--wait", type=float, default=60.0, metavar="SECONDS", help="for the world to appear"
    )
    add_bus_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from protocol.bus import open_bus
    from protocol.interrupt import interrupts
    from robot.brain import Brain
    from robot.journal_file import JournalFileError
    from robot.process import run_robot
    from station.warm_up import ensure_warm

    if args.resume and args.journal is None:
        raise JournalFileError("--resume needs --journal DIR: where the memory of earlier lives is")
    ensure_warm()  # before anybody waits for this robot
    if not args.connect and not args.config:
        args.connect = ["tcp/127.0.0.1:7447"]
    own = {"connect_timeout_s": args.wait, "key": args.keys}
    config = bus_config_from(args, "client").model_copy(update=own)
    with interrupts() as interrupt, open_bus(config) as bus:
        farewell = run_robot(
            bus,
            args.name,
            Brain,
            interrupt,
            journal_folder=args.journal,
            resume=args.resume,
            world_wait_s=args.wait,
        )
    print(f"{args.name}: {farewell.value}", file=sys.stderr)
    return EXIT_CODES[farewell.name]
