"""The report of a run: one folder that explains itself.

Written in an order in which an interruption half way leaves whole files alone: numbers first,
pictures last.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from maps.grid import OccupancyGrid, write_map
from protocol.messages import MapReply, TrajectoryReply
from protocol.pose import FloatArray
from station.formats import PoseGraph, Trajectory, write_g2o, write_text, write_tum
from station.live_status import grid_of
from station.observer import RunOutcome
from station.report_folder import TRUE_TRAJECTORY, clear_report
from station.report_links import draw_links
from station.report_maps import write_saved_maps
from station.report_metrics import Metrics, measure
from station.report_progress import draw_progress
from station.report_readme import folder_readme
from station.report_tables import ledger_table, metrics_table
from station.report_team import draw_team
from station.report_tracks import Tracks, tracks_of
from station.wording import centimetres, clock_time, describe, percent

TEAM_PICTURE = "team.png"


def write_report(
    outcome: RunOutcome, folder: Path, coverage: Sequence[tuple[float, float]] = ()
) -> Metrics:
    """Write everything that is left of a run into `folder` and return its metrics.

    `coverage` are the shares that were seen on the way (simulated s, share), for the picture. Also
    writes what there is of a run in which robots died or that was interrupted, and says so.
    """
    folder.mkdir(parents=True, exist_ok=True)
    clear_report(folder)
    metrics = measure(outcome)
    _write_scenario(outcome, folder / "scenario.yaml")
    write_text(folder / "metrics.json", metrics.model_dump_json(indent=2) + "\n")
    write_text(folder / "metrics.txt", metrics_table(metrics))
    _write_ledger(outcome, folder)
    write_text(folder / "README.md", folder_readme(outcome, metrics))
    _write_robots(outcome, folder)
    write_saved_maps(outcome, folder)
    tracks = tracks_of(outcome)
    joint = team_map(outcome, tracks.shared)
    if joint is not None:
        write_map(joint, folder / "team.yaml")
    _draw(outcome, metrics, joint, tracks, coverage, folder)
    return metrics


def team_map(outcome: RunOutcome, shared: Sequence[str]) -> OccupancyGrid | None:
    """The joint map that knows most, of the robots that share a frame; of equal ones that of the
    first robot by name. What is not aligned is not drawn into it: its robot never did."""
    robots = [robot for name, robot in sorted(outcome.robots.items()) if name in shared]
    maps = [robot.map for robot in robots if robot.map is not None]
    drawable = [grid_of(reply.joint) for reply in maps if reply.joint.cells.size]
    return max(drawable, key=lambda grid: int(np.count_nonzero(grid.known)), default=None)


def _write_scenario(outcome: RunOutcome, path: Path) -> None:
    """The scenario with nothing left to defaults: `earshot run FILE` plays it again."""
    scenario = outcome.simulation.scenario
    plain = scenario.model_dump(mode="json")
    plain["map"] = _anywhere(scenario.map)
    for robot in plain["robots"]:
        file, colon, name = robot["policy"].partition(":")
        robot["policy"] = f"{_anywhere(file)}{colon}{name}"
    head = "# Every setting of this run. Play it again with: earshot run scenario.yaml\n"
    write_text(path, head + yaml.safe_dump(plain, sort_keys=False, allow_unicode=True))


def _anywhere(name_or_path: str) -> str:
    """A file by a path that holds from every folder; a name as it is."""
    path = Path(name_or_path)
    return str(path.resolve()) if path.is_file() else name_or_path


def _write_ledger(outcome: RunOutcome, folder: Path) -> None:
    ledger = outcome.simulation.ledger
    write_text(folder / "ledger.json", json.dumps(ledger.to_dict(), indent=2) + "\n")
    write_text(folder / "ledger.txt", ledger_table(ledger))


def _write_robots(outcome: RunOutcome, folder: Path) -> None:
    """Each robot's files, in a folder of its name; of a dead robot only the true trajectory."""
    history, tick_s = outcome.simulation.history, outcome.simulation.scenario.tick_s
    for index, name in enumerate(outcome.simulation.names):
        place = folder / name
        place.mkdir(exist_ok=True)
        stamps = np.arange(len(history), dtype=np.float64) * tick_s
        lived = history.present[:, index]
        true = Trajectory(stamps[lived], history.poses[lived, index])
        write_tum(true, place / TRUE_TRAJECTORY)
        robot = outcome.robots.get(name)
        if robot is not None and robot.trajectory is not None:
            _write_trajectories(robot.trajectory, place)
        if robot is not None and robot.map is not None:
            _write_maps(robot.map, place)


def _write_trajectories(reply: TrajectoryReply, place: Path) -> None:
    estimates: dict[str, FloatArray] = {
        "estimated": reply.final,
        "online": reply.online,
        "dead_reckoned": reply.dead_reckoned,
    }
    for what, poses in estimates.items():
        # A robot may have been stopped between noting a tick and a pose: the common part counts.
        length = min(len(poses), len(reply.stamps))
        write_tum(Trajectory(reply.stamps[:length], poses[:length]), place / f"{what}.tum")
    graph = PoseGraph(reply.nodes, reply.edge_nodes, reply.edge_values)
    write_g2o(graph, place / "graph.g2o")


def _write_maps(reply: MapReply, place: Path) -> None:
    for what, patch in (("own_map", reply.own), ("joint_map", reply.joint)):
        if patch.cells.size:
            write_map(grid_of(patch), place / f"{what}.yaml")


def _draw(
    outcome: RunOutcome,
    metrics: Metrics,
    joint: OccupancyGrid | None,
    tracks: Tracks,
    coverage: Sequence[tuple[float, float]],
    folder: Path,
) -> None:
    simulation = outcome.simulation
    run = describe(simulation.scenario)
    ended = f"ended after {clock_time(metrics.sim_s)} (min:s): {metrics.exit_reason}"
    radio = simulation.scenario.radio
    draw_team(
        folder / TEAM_PICTURE,
        truth=simulation.terrain.grid,
        joint=joint,
        tracks=tracks,
        labels=_labels(metrics, tracks),
        title=f"Team map: {run}",
        subtitle=f"coverage {percent(metrics.coverage)} · "
        f"team error {centimetres(metrics.team.ate_rmse_m)} · {ended}",
    )
    draw_progress(
        folder / "progress.png",
        tracks=tracks.robots,
        reports=outcome.reports,
        coverage=_with_last(coverage, metrics),
        target_m2=metrics.target_m2 or None,
        tick_s=simulation.scenario.tick_s,
        title=f"Progress: {run}",
        subtitle=ended,
    )
    draw_links(
        folder / "links.png",
        names=simulation.names,
        links=simulation.link_history,
        delivered_bytes=simulation.ledger.delivered[..., 1],
        tick_s=simulation.scenario.tick_s,
        title=f"Who could talk to whom: {run}",
        subtitle=f"bars: within {radio.range_m:g} m of each other and alive; "
        "percent: share of the time",
    )


def _labels(metrics: Metrics, tracks: Tracks) -> list[str]:
    labels = []
    for track in tracks.robots:
        robot = metrics.robots[track.name]
        apart = "" if track.name in tracks.shared else ", not in this map"
        if robot.ate_rmse_m is None:
            labels.append(
                f"{track.name}: {robot.driven_m:.0f} m driven, {track.note or 'no answer'}"
            )
        else:
            error = centimetres(robot.ate_rmse_m)
            labels.append(f"{track.name}: {robot.driven_m:.0f} m driven, error {error}{apart}")
    return labels


def _with_last(
    coverage: Sequence[tuple[float, float]], metrics: Metrics
) -> list[tuple[float, float]]:
    """What was seen on the way, ending in what the referee says at the end."""
    seen = [point for point in coverage if point[0] < metrics.sim_s]
    if metrics.coverage is None or not seen:
        return seen
    return [*seen, (metrics.sim_s, metrics.coverage)]
