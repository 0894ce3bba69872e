"""`earshot maps`: the maps that ship."""

import argparse

from station.options import SubParsers, add_command

EXAMPLES = """examples:
  earshot maps
  earshot run --map loop"""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "maps", "list the maps that ship", EXAMPLES)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    del args
    from maps.library import load_map, shipped_maps

    for name in shipped_maps():
        grid = load_map(name)
        height, width = (n * grid.resolution for n in grid.cells.shape)
        free_m2 = float(grid.free.sum()) * grid.resolution**2
        print(f"{name:16} {width:5.1f} × {height:4.1f} m   {free_m2:6.0f} m² free")
    return 0
