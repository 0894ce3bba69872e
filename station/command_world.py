"""`earshot world`: the world alone, for robots on this or other machines."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from station.desk_options import add_desk_options
from station.options import (
    SubParsers,
    add_bus_options,
    add_command,
    add_scenario_options,
    bus_config_from,
    scenario_from,
)

if TYPE_CHECKING:
    from station.observer import Observer, RunOutcome

EXAMPLES = """examples:
  earshot keys r1 r2 r3 --out keys
  earshot world --listen tcp/0.0.0.0:7447 --robots 3 --keys keys
  earshot world scenario.yaml -l tcp/127.0.0.1:7447 --keys keys --headless

It waits until every robot of the scenario has come: take each its own key, and start it with
  earshot robot NAME --connect tcp/HOST:7447 --keys NAME.key"""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "world", "be the world of a run, and report on it", EXAMPLES)
    add_scenario_options(parser)
    group = parser.add_argument_group("who may take part (one of these)")
    wall = group.add_mutually_exclusive_group(required=True)
    wall.add_argument(
        "--keys", type=Path, metavar="DIR", help="whose keys are here, made by `earshot keys`"
    )
    wall.add_argument(
        "--open-to-anybody",
        action="store_true",
        help="no keys: whoever reaches the port reads everything and can be any robot",
    )
    add_bus_options(parser)
    add_desk_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from station.desk import run_at_desk
    from station.launch import host_world
    from station.warm_up import ensure_warm

    scenario = scenario_from(args)
    ensure_warm()
    if not args.listen and not args.config:
        args.listen = ["tcp/127.0.0.1:7447"]
    config = bus_config_from(args, "router")
    if args.keys is not None:
        config = config.walled(args.keys, scenario.names)

    def play(observer: "Observer", folder: Path) -> "RunOutcome":
        del folder
        return host_world(scenario, config, observer)

    return run_at_desk(args, play)
