"""Options that several commands share, and the scenario and bus settings they come to."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from protocol.bus_config import BusConfig
    from world.scenario import Scenario

# argparse's own type, which is not meant to be named but is what add_subparsers returns.
SubParsers = Any


def add_command(
    commands: SubParsers, name: str, summary: str, examples: str
) -> argparse.ArgumentParser:
    """A subcommand with its help and examples."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=summary,
        description=summary[0].upper() + summary[1:] + ".",
        epilog=examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    return parser


# -- the scenario


def add_scenario_options(parser: argparse.ArgumentParser) -> None:
    """A scenario file and what can be changed in it."""
    group = parser.add_argument_group("scenario")
    group.add_argument(
        "scenario", nargs="?", type=Path, metavar="SCENARIO", help="a .yaml or .json scenario file"
    )
    group.add_argument("--robots", type=int, metavar="N", help="number of robots (default 3)")
    group.add_argument(
        "--map", metavar="MAP", help="a shipped map's name or a map_server .yaml (default office)"
    )
    group.add_argument("--seed", type=int, metavar="S", help="what all chance is drawn from")
    group.add_argument(
        "--range", type=float, metavar="METRES", help="d: radio range (default 10 m)"
    )
    group.add_argument(
        "--gate",
        choices=("disc", "line-of-sight", "shadowing"),
        help="what weakens radio links within d: nothing (default), walls, or shadowing",
    )
    group.add_argument("--loss", type=float, metavar="P", help="probability that a frame is lost")
    group.add_argument("--latency", type=int, metavar="TICKS", help="ticks from sent to heard")
    group.add_argument(
        "--starts",
        choices=("known", "same", "unknown"),
        help="are robots told where they start: in one frame, beside each other, or not (default)?",
    )
    group.add_argument("--engine", metavar="NAME", help="SLAM engine of all robots")
    group.add_argument("--policy", metavar="NAME", help="exploration policy of all robots")
    group.add_argument(
        "--noise", choices=("modern", "paper", "none"), help="noise of the range finder"
    )
    group.add_argument(
        "--max-time", type=float, metavar="SECONDS", help="simulated time after which a run ends"
    )
    group.add_argument(
        "--pace", choices=("lockstep", "realtime"), help="does the world wait for robots?"
    )
    group.add_argument(
        "--factor", type=float, metavar="F", help="with --pace realtime: simulated per wall second"
    )


def scenario_from(args: argparse.Namespace) -> "Scenario":
    """The scenario of a file, or the default one, with the options' changes.

    Raises ScenarioFileError when the file or the result is not a scenario.
    """
    from station.scenario_file import changed, read_scenario
    from world.scenario import Scenario

    scenario = read_scenario(args.scenario) if args.scenario else Scenario()
    changes: dict[str, Any] = {
        "map": args.map,
        "seed": args.seed,
        "starts": args.starts,
        "max_sim_s": args.max_time,
        "radio": {
            "model": args.gate,
            "range_m": args.range,
            "loss": args.loss,
            "latency_ticks": args.latency,
        },
        "lidar": {"noise": args.noise},
        "pace": {"mode": args.pace, "factor": args.factor},
    }
    return changed(scenario, changes, args.robots, args.engine, args.policy)


# -- the bus


def add_bus_options(parser: argparse.ArgumentParser) -> None:
    """Options named as in Zenoh's own examples."""
    group = parser.add_argument_group("network (Zenoh)")
    group.add_argument("--mode", choices=("peer", "client", "router"), help="how to take part")
    group.add_argument(
        "-e", "--connect", action="append", default=[], metavar="ENDPOINT", help="tcp/HOST:PORT"
    )
    group.add_argument(
        "-l", "--listen", action="append", default=[], metavar="ENDPOINT", help="tcp/HOST:PORT"
    )
    group.add_argument("-c", "--config", type=Path, metavar="FILE", help="Zenoh's json5 file")
    group.add_argument(
        "--cfg", action="append", default=[], metavar="KEY:VALUE", help="one setting of Zenoh's"
    )
    group.add_argument(
        "--namespace", default="earshot", metavar="NAME", help="prefix of all keys of a run"
    )


def bus_config_from(args: argparse.Namespace, mode: str) -> "BusConfig":
    """The bus settings; `mode` is what the command opens unless --mode says otherwise."""
    from pydantic import ValidationError

    from protocol.bus_config import BusConfig, BusConfigError

    try:
        return BusConfig.model_validate(
            {
                "mode": args.mode or mode,
                "connect": tuple(args.connect),
                "listen": tuple(args.listen),
                "namespace": args.namespace,
                "file": args.config,
                "overrides": tuple(args.cfg),
            }
        )
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise BusConfigError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
