"""`earshot merge`: one map from robots that did not know where the others started."""

import argparse
import time
from pathlib import Path

from station.options import SubParsers, add_command

EXAMPLES = """examples:
  earshot merge wean-1.clf wean-2.clf wean-3.clf --json metrics.json
  earshot merge intel-910.clf --split 4
  earshot merge runs/latest

A source is a CARMEN log (a robot each), the folder of a run in processes (its robots' journals),
or a .journal file. What a journal says of start poses and of links to others is not used: the
alignment comes from the scans alone. Robots that cannot be aligned for certain stay apart, and the
table says why. The folder that is written holds metrics.json and .txt, merged.png, map.yaml with
map.pgm, and for each aligned robot NAME.tum, its keyframes in the common frame.

exit codes: 0 done (see `aligned` for what came of it), 2 an error, 130 interrupted"""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "merge", "merge maps of robots with unknown starts", EXAMPLES)
    parser.add_argument(
        "sources", nargs="+", type=Path, metavar="RUN_OR_LOG", help="logs, journals, run folders"
    )
    parser.add_argument(
        "--split", type=int, default=1, metavar="N", help="each log as N robots, one after another"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results")
    parser.add_argument("--json", type=Path, metavar="FILE", help="the metrics also here")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from protocol.config import LidarConfig
    from robot.team.journal import LogName
    from station.formats import write_text
    from station.merge import merge
    from station.merge_metrics import measure_merge
    from station.merge_report import PICTURE, merge_table, write_merge
    from station.merge_sources import MergeError, read_sources
    from station.progress_bar import progress_bar
    from station.report_folder import run_folder
    from station.warm_up import ensure_warm

    if args.split < 1:
        raise MergeError(f"--split {args.split}: a log has one part at least")
    ensure_warm()
    began = time.perf_counter()
    sources, wholes = read_sources(args.sources, args.split)
    folder = run_folder(args.out)
    names = {LogName(source.name, 0): source for source in sources}
    simulated = any(source.simulated for source in sources)
    lidar = LidarConfig(noise="modern" if simulated else "none")
    with progress_bar("places") as progress:
        merged = merge({name: source.entries for name, source in names.items()}, lidar, progress)
    metrics, grids = measure_merge(merged, names, wholes, lidar, time.perf_counter() - began)
    write_merge(merged, metrics, grids, names, folder)
    if args.json is not None:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        write_text(args.json, metrics.model_dump_json(indent=2) + "\n")
    print(merge_table(metrics), end="")
    print(f"report: {folder}  picture: {folder / PICTURE}", flush=True)
    return 0
