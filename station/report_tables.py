"""Metrics and ledger as tables for people."""

from collections.abc import Sequence
from typing import Any

from station.report_metrics import Metrics
from station.wording import NOTHING, centimetres, clock_time, percent, readable_bytes, times
from world.ledger import Ledger

COLUMNS = ("delivered", "range", "loss", "capacity", "absent", "in flight")


def metrics_table(metrics: Metrics) -> str:
    """metrics.txt: the run, then one row for each robot."""
    peak = {name: value for name, value in metrics.peak_rss_mb.items() if value is not None}
    run = [
        ("map, seed, mode", f"{metrics.map}, {metrics.seed}, {metrics.mode}"),
        ("ended", metrics.exit_reason),
        ("simulated time", f"{clock_time(metrics.sim_s)} (min:s)"),
        ("wall time", f"{clock_time(metrics.wall_s)} (min:s)"),
        ("pace", f"{times(metrics.realtime_factor)} real time"),
        (
            "coverage, own maps together",
            f"{percent(metrics.coverage)} of {metrics.target_m2:.0f} m²",
        ),
        ("coverage, poorest joint map", percent(metrics.coverage_worst_joint)),
        ("walls mapped", percent(metrics.walls.recall)),
        ("mapped walls that are true", percent(metrics.walls.precision)),
        ("team error, final", centimetres(metrics.team.ate_rmse_m)),
        ("team error, online", centimetres(metrics.team.ate_online_rmse_m)),
        ("team error, dead reckoning", centimetres(metrics.team.dead_reckoning_rmse_m)),
        ("collisions", str(metrics.collisions)),
        ("radio, delivered", readable_bytes(metrics.radio.bytes_delivered)),
        ("ledger equals robots' counts", _yes(metrics.ledger.equal)),
        ("peak memory", ", ".join(f"{name} {value:.0f} MB" for name, value in peak.items())),
    ]
    heads = ["robot", "final", "online", "dead reck.", "own map", "joint map", "driven", "hits"]
    rows = [
        [
            name,
            centimetres(robot.ate_rmse_m),
            centimetres(robot.ate_online_rmse_m),
            centimetres(robot.dead_reckoning_rmse_m),
            percent(robot.coverage_own),
            percent(robot.coverage_joint),
            f"{robot.driven_m:.1f} m",
            str(robot.collisions),
            robot.note or (robot.activity or "finished" if robot.finished else ""),
        ]
        for name, robot in metrics.robots.items()
    ]
    width = max(len(what) for what, _ in run)
    lines = [f"{what:<{width}}  {value}" for what, value in run]
    return "\n".join(lines) + "\n\n" + _table([*heads, "became of it"], rows)


def ledger_table(ledger: Ledger) -> str:
    """ledger.txt: what became of all frames, by ordered pair and by kind."""
    told = ledger.to_dict()
    heads = ["from → to", "offered", *COLUMNS, "bytes delivered"]
    rows = [_amounts(f"{row['sender']} → {row['receiver']}", row) for row in told["pairs"]]
    rows.append(_amounts("together", told["total"]))
    kinds = [_amounts(kind, row) for kind, row in told["kinds"].items()]
    return (
        "Frames on the radio, each offered to every robot it is meant for: delivered, dropped\n"
        "(out of range, lost, no capacity left, receiver absent) or still in flight.\n\n"
        + _table(heads, rows)
        + "\n"
        + _table(["kind", *heads[1:]], kinds)
    )


def _amounts(label: str, row: dict[str, Any]) -> list[str]:
    dropped = row["dropped"]
    frames = [row["offered"], row["delivered"], *dropped.values(), row["in_flight"]]
    return [
        label,
        *(str(amount["frames"]) for amount in frames),
        readable_bytes(row["delivered"]["bytes"]),
    ]


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns as wide as what stands in them; the first is flush left, as is one of words."""
    widths = [max(len(row[k]) for row in [heads, *rows]) for k in range(len(heads))]
    left = {0} | ({len(heads) - 1} if heads[-1] == "became of it" else set())
    lines = []
    for row in [heads, *rows]:
        cells = [
            f"{cell:<{width}}" if k in left else f"{cell:>{width}}"
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join(lines) + "\n"


def _yes(value: bool | None) -> str:
    return NOTHING if value is None else "yes" if value else "NO"
