"""The folder of a run: where it is, and how it is found again."""

import os
from datetime import datetime
from pathlib import Path

from protocol.errors import EarshotError

RUNS = Path("runs")
LATEST = "latest"
TRUE_TRAJECTORY = "true.tum"
SAVED_MAP = "map.earshot"
TEAM_FILES = ("team.yaml", "team.pgm", SAVED_MAP)
ROBOT_FILES = (
    TRUE_TRAJECTORY,
    *(f"{what}.tum" for what in ("estimated", "online", "dead_reckoned")),
    *(f"{what}_map.{kind}" for what in ("own", "joint") for kind in ("yaml", "pgm")),
    "graph.g2o",
    SAVED_MAP,
)


class ReportFolderError(EarshotError):
    """A folder in which no report can be written."""


def run_folder(out: Path | None, now: datetime | None = None) -> Path:
    """A folder for a run: `out` as it was asked for, or a new `runs/<time>/`, to which the link
    `runs/latest` then points.

    Raises ReportFolderError when it cannot be made.
    """
    try:
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            return out
        folder = _new_folder(RUNS, now or datetime.now().astimezone())
        _point(RUNS / LATEST, folder.name)
    except OSError as error:
        raise ReportFolderError(
            f"{out or RUNS}: cannot be made a folder for the report ({error.strerror}); "
            "--out DIR puts it elsewhere"
        ) from error
    return folder


def saved_map_of(robot: str) -> str:
    """The file of the map of a group that is not the largest one, by its first robot."""
    return SAVED_MAP.replace(".", f"-{robot}.")


def clear_report(folder: Path) -> None:
    """Remove what an earlier report left that a new one may not write again, and nothing else.

    Otherwise a robot that died this time would seem to have answered.
    """
    robots = [trajectory.parent for trajectory in folder.glob(f"*/{TRUE_TRAJECTORY}")]
    for name in TEAM_FILES:
        (folder / name).unlink(missing_ok=True)
    for place in robots:
        (folder / saved_map_of(place.name)).unlink(missing_ok=True)
        for name in ROBOT_FILES:
            (place / name).unlink(missing_ok=True)
        if not any(place.iterdir()):
            place.rmdir()


def _new_folder(runs: Path, now: datetime) -> Path:
    """Named by the time; a second run within one second gets a number behind it."""
    runs.mkdir(parents=True, exist_ok=True)
    name = f"{now:%Y-%m-%d_%H-%M-%S}"
    for attempt in range(1000):
        folder = runs / (name if attempt == 0 else f"{name}_{attempt + 1}")
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise FileExistsError(17, "a thousand runs in one second", str(runs))


def _point(link: Path, target: str) -> None:
    """Let `link` name `target`, without a moment in which there is none."""
    partial = link.with_name(f".{link.name}.{os.getpid()}")
    partial.unlink(missing_ok=True)
    partial.symlink_to(target)
    partial.replace(link)
