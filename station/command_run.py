"""`earshot run`: a whole run, world and robots, with one command."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from station.desk_options import add_desk_options
from station.options import SubParsers, add_command, add_scenario_options, scenario_from

if TYPE_CHECKING:
    from station.observer import Observer, RunOutcome

EXAMPLES = """examples:
  earshot run
  earshot run --robots 5 --seed 7 --range 6 --loss 0.2
  earshot run --map rooms-small --robots 2 --headless --json metrics.json
  earshot run --map ../shared/maps/intel.yaml --max-time 3600
  earshot run runs/latest/scenario.yaml --mode inline --out again

The same scenario gives the same result in every mode. Ctrl-C ends the run and still writes a
report; a second one ends at once. The last line printed is the report's folder and its picture.

exit codes: 0 ended, 1 no robot was left, 2 an error, 130 interrupted"""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "run", "run a team of robots and report on it", EXAMPLES)
    add_scenario_options(parser)
    parser.add_argument(
        "--mode",
        choices=("processes", "memory", "inline"),
        default="processes",
        help="robots as processes over Zenoh (default), as threads over it, or without it",
    )
    parser.add_argument(
        "--restart",
        action="store_true",
        help="start robot processes again that are killed: they go on from their journals",
    )
    add_desk_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from station.desk import run_at_desk
    from station.launch import launch
    from station.warm_up import ensure_warm

    scenario = scenario_from(args)
    ensure_warm()

    def play(observer: "Observer", folder: Path) -> "RunOutcome":
        robots = folder / "robots"
        return launch(scenario, args.mode, observer, folder=robots, restart=args.restart)

    return run_at_desk(args, play)
