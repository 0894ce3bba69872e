"""`earshot radio`: where on a map a transmitter is heard."""

import argparse
from pathlib import Path

from station.options import SubParsers, add_command

EXAMPLES = """examples:
  earshot radio office --at 9.5,4
  earshot radio office --at 9.5,4 --gate line-of-sight --range 15 --out walls.png
  earshot radio ../shared/maps/intel.yaml --at 0,0 --gate shadowing --seed 3
  earshot radio office --at 9.5,4 --gate line-of-sight --set wall_loss_db_per_m=80

--set takes any field of `radio` in a scenario file. What is drawn is what the gate of a run with
the same options and seed does with a frame, loss and capacity apart."""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "radio", "draw where on a map a transmitter is heard", EXAMPLES)
    parser.add_argument("map", metavar="MAP", help="a shipped map's name or a map_server .yaml")
    parser.add_argument(
        "--at", required=True, type=place, metavar="X,Y", help="the transmitter, in m on the map"
    )
    parser.add_argument(
        "--gate", choices=("disc", "line-of-sight", "shadowing"), help="the model (default disc)"
    )
    parser.add_argument("--range", type=float, metavar="METRES", help="d: radio range")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the shadowing")
    parser.add_argument(
        "--set", action="append", default=[], metavar="FIELD=VALUE", help="one field of the gate"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("radio.png"), metavar="FILE", help="default radio.png"
    )
    parser.set_defaults(run=run)


def place(text: str) -> tuple[float, float]:
    """`X,Y` as numbers; argparse turns the ValueError into a usage message."""
    x, y = text.split(",")
    return float(x), float(y)


def run(args: argparse.Namespace) -> int:
    from maps.library import load_map
    from protocol.errors import EarshotError
    from station.radio_picture import describe, draw_coverage
    from station.scenario_file import changed
    from world.channel import Channel
    from world.noise import Noise
    from world.scenario import Scenario
    from world.terrain import Terrain

    fields: dict[str, object] = {"model": args.gate, "range_m": args.range}
    for setting in args.set:
        name, equals, value = setting.partition("=")
        if not equals:
            raise EarshotError(f"--set {setting}: expected FIELD=VALUE")
        fields[name] = value
    scenario = changed(Scenario(), {"seed": args.seed, "radio": fields})
    gate, grid = scenario.radio, load_map(args.map)
    terrain = Terrain(grid)
    if terrain.disc_overlaps(args.at[0], args.at[1], 1e-6):
        left, right = grid.origin_x, grid.origin_x + grid.cells.shape[1] * grid.resolution
        bottom, top = grid.origin_y, grid.origin_y + grid.cells.shape[0] * grid.resolution
        raise EarshotError(
            f"({args.at[0]:g}, {args.at[1]:g}) is not free ground of {args.map}, which reaches "
            f"from ({left:g}, {bottom:g}) to ({right:g}, {top:g}) m"
        )
    heard = Channel(gate, terrain, Noise(scenario.seed)).heard(args.at)
    share = 100.0 * float(heard.sum()) / float(grid.free.sum())
    area = float(heard.sum()) * grid.resolution**2
    title = f"{Path(args.map).stem}: {area:.0f} m² hear ({args.at[0]:g}, {args.at[1]:g})"
    args.out.parent.mkdir(parents=True, exist_ok=True)
    draw_coverage(grid, heard, args.at, gate, title, args.out)
    print(f"{describe(gate)}: heard on {area:.0f} m², {share:.0f} % of the free ground")
    print(args.out)
    return 0
