"""The page that tells whoever opens a report's folder what lies in it."""

from robot.team.standing import TEAM_FRAME
from station.observer import RunOutcome
from station.report_metrics import Metrics
from station.wording import (
    NOTHING,
    centimetres,
    clock_time,
    describe,
    percent,
    readable_bytes,
)
from world.accuracy import by_frame


def folder_readme(outcome: RunOutcome, metrics: Metrics) -> str:
    """README.md of a report's folder."""
    silent = [
        f"- **{name}** left no map or trajectory: {robot.note or 'it gave no answer'}.\n"
        for name, robot in metrics.robots.items()
        if robot.ate_rmse_m is None
    ]
    pairs = [
        ("metrics.json", "the run in numbers; null is what could not be computed"),
        ("metrics.txt", "the same as a table"),
        ("scenario.yaml", "every setting; `earshot run scenario.yaml` plays it again"),
        ("team.png", "joint map and everybody's way over the truth"),
        ("progress.png", "known area and position errors over time"),
        ("links.png", "who could talk to whom when, and what each pair carried"),
        ("team.yaml, team.pgm", "the joint map that knows most (ROS map_server)"),
        ("map.earshot", "all their submaps, for `earshot slam LOG --map map.earshot --localise`"),
        ("ledger.json, ledger.txt", "what became of every radio frame"),
        ("ROBOT/own_map.yaml", "map from this robot's scans alone"),
        ("ROBOT/joint_map.yaml", "map from its scans and what it heard from teammates"),
        ("ROBOT/map.earshot", "its own submaps and pose graph, in the frame that it shares"),
        ("ROBOT/true.tum", "where it was"),
        ("ROBOT/estimated.tum", "where it believes at the end that it was"),
        ("ROBOT/online.tum", "where it believed at each tick that it was"),
        ("ROBOT/dead_reckoned.tum", "where wheel counts alone would have it"),
        ("ROBOT/graph.g2o", "its pose graph: submap anchors, ties and loop closures"),
    ]
    table = "".join(f"| `{file}` | {what} |\n" for file, what in pairs)
    return (
        f"# {describe(outcome.simulation.scenario)}\n\n"
        f"Ended after {clock_time(metrics.sim_s)} (min:s) of simulated time: "
        f"{metrics.exit_reason}. Coverage {percent(metrics.coverage)}, "
        f"team error {centimetres(metrics.team.ate_rmse_m)}, "
        f"collisions {metrics.collisions}.\n\n"
        + ("".join(silent) + "\n" if silent else "")
        + _standings(metrics)
        + _bytes(metrics)
        + "| file | what it holds |\n|---|---|\n"
        + table
        + "\nTrajectories: `stamp tx ty tz qx qy qz qw` (s, m), each robot's estimates in its own "
        "map frame.\n"
    )


def _bytes(metrics: Metrics) -> str:
    """What the radio carried and what for: together, and for each pair."""
    purposes = metrics.radio.purposes
    if not purposes:
        return ""
    total = "".join(
        f"| {purpose} | {readable_bytes(score.bytes_delivered)} | "
        f"{_per_metre(score.bytes_per_metre)} |\n"
        for purpose, score in purposes.items()
    )
    pairs = "".join(
        f"| {sender} → {name} | "
        + " | ".join(readable_bytes(usage.get(purpose, 0)) for purpose in purposes)
        + f" | {_per_metre(_by_metre(sum(usage.values()), metrics.robots[sender].driven_m))} |\n"
        for name, robot in metrics.robots.items()
        for sender, usage in sorted(robot.heard_for.items())
        if sender in metrics.robots
    )
    return (
        "What was delivered by radio, by what it was for (`live`: poses, goals and sightings; "
        "`vectors`: who holds what; `frames`: headers), and by metre driven and robot that could "
        "receive it:\n\n| for | delivered | per metre |\n|---|---|---|\n"
        f"{total}| together | {readable_bytes(metrics.radio.bytes_delivered)} | "
        f"{_per_metre(metrics.radio.bytes_per_metre)} |\n\n"
        "By pair, and by metre that the sender drove:\n\n"
        f"| from → to | {' | '.join(purposes)} | per metre |\n{'|---' * (len(purposes) + 2)}|\n"
        f"{pairs}\n"
    )


def _by_metre(size: int, driven_m: float) -> float | None:
    return size / driven_m if driven_m > 0.0 else None


def _per_metre(size: float | None) -> str:
    return NOTHING if size is None else f"{size:.0f} B"


def _standings(metrics: Metrics) -> str:
    """Who shares a frame with whom, and why where somebody does not; nothing where all were told
    where they start."""
    frames = by_frame(
        {name: robot.frame for name, robot in metrics.robots.items() if robot.frame is not None}
    )
    told = {
        (name, mate): standing
        for name, robot in metrics.robots.items()
        for mate, standing in robot.alignment.items()
        if name < mate
    }
    if set(frames) <= {TEAM_FRAME}:
        return ""
    groups = "; ".join(" ".join(names) for names in frames.values())
    rows = "".join(
        f"| {name} – {mate} | {standing.state} | {standing.reason} |\n"
        for (name, mate), standing in sorted(told.items())
    )
    return (
        f"Robots whose maps share a frame: {groups}. Pictures and scores place each such group by "
        "itself, and `team.png` shows the largest: what is not aligned is in no map but its own. "
        "`map.earshot` is that of the largest, `map-ROBOT.earshot` of another by its first robot."
        "\n\n"
        f"| robots | maps are | because |\n|---|---|---|\n{rows}\n"
    )
