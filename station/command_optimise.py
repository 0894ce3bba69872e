"""`earshot optimise GRAPH.g2o`: the pose graph optimiser by itself."""

import argparse
from pathlib import Path

from station.options import SubParsers, add_command

EXAMPLES = """examples:
  earshot optimise manhattan.g2o
  earshot optimise MIT.g2o --start chordal --json result.json
  earshot optimise intel.g2o --peer gtsam
  earshot optimise intel.g2o --false-closures 0.3 --seed 1

A graph of edges alone starts where its odometry edges put it. --start says from where: the better
of the file's odometry and a chordal start (auto), or one of them. --robust decides which edges
count, the first ones between consecutive nodes excepted. --false-closures 0.3 adds false ones, 30 %
of the file's closures, and solves the graph robustly, by least squares, and without them.

exit codes: 0 done, 2 an error, 130 interrupted"""


def add_parser(commands: SubParsers) -> None:
    parser = add_command(commands, "optimise", "optimise a pose graph", EXAMPLES)
    parser.add_argument("graph", type=Path, metavar="GRAPH", help="a .g2o file of planar poses")
    parser.add_argument("--start", choices=("auto", "odometry", "chordal", "file"), default="auto")
    parser.add_argument("--robust", action="store_true", help="refuse edges that are false")
    parser.add_argument(
        "--false-closures",
        type=float,
        metavar="SHARE",
        help="add this share of closures",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the false closures")
    parser.add_argument("--peer", choices=("gtsam",), help="solve it by this library too")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results")
    parser.add_argument("--json", type=Path, metavar="FILE", help="the figures also here")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from station.formats import PoseGraph, read_g2o, write_g2o, write_text
    from station.graph_picture import draw_graph
    from station.graph_solution import among_false, peer_gtsam, require_gtsam, solve
    from station.report_folder import run_folder
    from station.warm_up import ensure_warm

    if args.peer is not None:
        require_gtsam()
    graph = read_g2o(args.graph)
    ensure_warm()
    if args.false_closures is None:
        figures, nodes = solve(graph, args.start, args.robust)
    else:
        figures, nodes = among_false(graph, args.false_closures, args.seed)
    if args.peer is not None:
        figures = figures.model_copy(update={"peer": peer_gtsam(graph)})
    folder = run_folder(args.out)
    text = figures.model_dump_json(indent=2) + "\n"
    write_text(folder / "metrics.json", text)
    if args.json is not None:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        write_text(args.json, text)
    solved = PoseGraph(nodes, graph.edge_nodes, graph.edge_values)
    write_g2o(solved, folder / "graph.g2o")
    title = f"{args.graph.name}: {figures.nodes} nodes, {figures.edges} edges"
    told = f"χ² {figures.chi2:.4f} in {figures.iterations} iterations, {figures.seconds:.3f} s"
    draw_graph(solved, folder / "graph.png", title=title, subtitle=told)
    print(title)
    print(
        f"{told}, from a start by {figures.start}{'' if figures.converged else ': NOT converged'}"
    )
    if figures.refused:
        print(f"edges refused as false: {figures.refused}")
    if figures.false_closures is not None:
        found = figures.false_closures
        print(
            f"{found.added} false closures: χ² of the others {found.true_chi2:.4f}, "
            f"{found.off_m:.3f} m off (least squares {found.plain_true_chi2:.4g}, "
            f"{found.plain_off_m:.2f} m; without them {found.clean_chi2:.4f} in "
            f"{found.clean_seconds:.3f} s)"
        )
    if figures.peer is not None:
        print(f"gtsam: χ² {figures.peer.chi2:.4f}, {figures.peer.seconds:.3f} s")
    print(f"report: {folder}  picture: {folder / 'graph.png'}", flush=True)
    return 0
