"""`earshot slam LOG`: SLAM on the log of a real robot."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from station.options import SubParsers, add_command

if TYPE_CHECKING:
    from protocol.pose import Pose2
    from station.replay import ReplaySettings, Whereabouts

EXAMPLES = """examples:
  earshot slam intel.clf
  earshot slam intel.clf.gz --relations intel.relations --json metrics.json
  earshot slam synth.clf --reference synth.truth.tum --reverse
  earshot slam monday.clf --out monday
  earshot slam tuesday.clf --map monday/map.earshot --localise --start unknown
  earshot slam intel.clf --odometry-scale 1.15 --turn-error 0.09 --range-noise 0.02 --seed 3

LOG is a CARMEN log with FLASER or ROBOTLASER lines, plain or gzipped, or a ROS bag (a rosbag2
folder, .mcap, .db3 or .bag; needs pip install "earshot-slam[rosbag]"). The folder that is written
holds metrics.json and .txt, trajectory.tum, odometry.tum, graph.g2o, map.yaml with map.pgm, map.png
and map.earshot, which --map takes. With --localise nothing is mapped: the robot follows where it is
in the map, from --start on, which is its origin or, where nobody knows, found out while it drives.

exit codes: 0 done, 2 an error, 130 interrupted"""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "slam", "map a building from a robot's log", EXAMPLES)
    parser.add_argument("log", type=Path, metavar="LOG", help="a CARMEN log, .gz too, or a ROS bag")
    parser.add_argument("--engine", default="graph", metavar="NAME", help="default: graph")
    parser.add_argument(
        "--relations", type=Path, metavar="FILE", help="relations to measure by (Kümmerle et al.)"
    )
    parser.add_argument(
        "--interpolate", action="store_true", help="also use relations that end between scans"
    )
    parser.add_argument(
        "--reference", type=Path, metavar="FILE", help="a .tum trajectory to measure by"
    )
    known = parser.add_argument_group("in a known map")
    known.add_argument(
        "--map", type=Path, metavar="MAP", help="map.earshot of a run, or a map_server .yaml"
    )
    known.add_argument("--localise", action="store_true", help="follow the robot, map nothing")
    known.add_argument(
        "--start", metavar="X,Y,DEG", help="its first pose in the map (default 0,0,0), or unknown"
    )
    read = parser.add_argument_group("what is read, where a log holds more than one")
    read.add_argument("--laser", metavar="KEYWORD", help="of a CARMEN log: FLASER, ROBOTLASER1, …")
    read.add_argument("--scan-topic", metavar="TOPIC", help="of a ROS bag: of its LaserScan")
    read.add_argument("--odom-topic", metavar="TOPIC", help="of a ROS bag: of its Odometry")
    played = parser.add_argument_group("how the log is played")
    played.add_argument("--reverse", action="store_true", help="from its end to its beginning")
    played.add_argument("--every", type=int, metavar="N", help="only every n-th scan")
    played.add_argument(
        "--odometry-scale", type=float, metavar="F", help="multiply driven distances, as in 1.15"
    )
    played.add_argument(
        "--turn-error", type=float, metavar="F", help="turn this share too far, as in 0.09"
    )
    played.add_argument(
        "--range-noise", type=float, metavar="METRES", help="σ of noise added to every range"
    )
    played.add_argument("--seed", type=int, metavar="S", help="of that noise (default 0)")
    played.add_argument(
        "--max-range", type=float, metavar="METRES", help="longer ranges are no return (default 40)"
    )
    played.add_argument(
        "--field-of-view",
        type=float,
        metavar="DEG",
        help="of the scanner (default: as the log says, or a half turn)",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results")
    parser.add_argument("--json", type=Path, metavar="FILE", help="the metrics also here")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from station.formats import read_tum, write_text
    from station.progress_bar import progress_bar
    from station.relations import read_relations, reference_errors, relation_errors
    from station.replay import play
    from station.replay_report import PICTURE, measure_replay, replay_table, write_replay
    from station.report_folder import run_folder
    from station.scan_log import Channels, read_log
    from station.warm_up import ensure_warm

    settings = _settings(args)
    whereabouts = _whereabouts(args)
    log = read_log(args.log, Channels(args.laser, args.scan_topic, args.odom_topic))
    relations = read_relations(args.relations) if args.relations else None
    reference = read_tum(args.reference) if args.reference else None
    folder = run_folder(args.out)
    ensure_warm()
    with progress_bar(args.log.name) as progress:
        replay = play(log, settings, progress, whereabouts)
    metrics = measure_replay(
        args.log,
        settings,
        replay,
        relation_errors(replay, relations, args.interpolate) if relations else None,
        reference_errors(replay, reference) if reference else None,
    )
    write_replay(replay, metrics, folder)
    if args.json is not None:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        write_text(args.json, metrics.model_dump_json(indent=2) + "\n")
    print(replay_table(metrics))
    print(f"report: {folder}  picture: {folder / PICTURE}", flush=True)
    return 0


def _whereabouts(args: argparse.Namespace) -> "Whereabouts | None":
    """The known map and the start in it, if the robot is to be localised."""
    from station.known_maps import read_known_map
    from station.replay import ReplayError, Whereabouts

    if args.map is None and not args.localise and args.start is None:
        return None
    if args.map is None or not args.localise:
        raise ReplayError("--map MAP, --localise and --start go together: a map to be localised in")
    start = _start(args.start or "0,0,0")
    return Whereabouts(read_known_map(args.map), start)


def _start(text: str) -> "Pose2 | None":
    from protocol.pose import Pose2, wrap_angle
    from station.replay import ReplayError

    if text == "unknown":
        return None
    try:
        x, y, degrees = (float(word) for word in text.split(","))
        if not all(math.isfinite(value) for value in (x, y, degrees)):
            raise ValueError
    except ValueError:
        raise ReplayError(f"--start: expected X,Y,DEG or unknown, got {text!r}") from None
    return Pose2(x, y, wrap_angle(math.radians(degrees)))


def _settings(args: argparse.Namespace) -> "ReplaySettings":
    from pydantic import ValidationError

    from station.replay import ReplayError, ReplaySettings

    asked = {
        "engine": args.engine,
        "reverse": args.reverse,
        "every": args.every,
        "odometry_scale": args.odometry_scale,
        "turn_error": args.turn_error,
        "range_noise_m": args.range_noise,
        "seed": args.seed,
        "max_range_m": args.max_range,
        "field_of_view_deg": args.field_of_view,
    }
    try:
        return ReplaySettings.model_validate(
            {name: value for name, value in asked.items() if value is not None}
        )
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        option = "--" + str(first["loc"][0]).removesuffix("_m").removesuffix("_deg")
        raise ReplayError(f"{option.replace('_', '-')}: {first['msg']}") from None
