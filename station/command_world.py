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
  earshot world --listen tcp/0.0.0.0:7447 --robots 3
  earshot world scenario.yaml -l tcp/127.0.0.1:7447 --headless

It waits until every robot of the scenario has come: start each with
  earshot robot NAME --connect tcp/HOST:7447"""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "world", "be the world of a run, and report on it", EXAMPLES)
    add_scenario_options(parser)
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

    def play(observer: "Observer", folder: Path) -> "RunOutcome":
        del folder
        return host_world(scenario, config, observer)

    return run_at_desk(args, play)
