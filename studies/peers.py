"""Earshot beside MRPT's icp-slam and rbpf-slam on one log, in one run by one metric.

    python -m studies.peers LOGS/synth-361.clf --reference LOGS/synth-361.truth.tum
    python -m studies.peers LOGS/intel-910.clf --relations LOGS/intel.relations --interpolate

Needs Debian's mrpt-apps, with the settings of mrpt-common. Both run with their shipped settings for
scans, icp-slam also with `fine`: every point of a scan, each 5 cm or 2°. The log is one of CARMEN
with FLASER lines alone. Poses are Earshot's final ones, and what a peer said at each scan: they
write no others for all scans.

Times are of the processor. Each system plays the first `HEAD` scans (half of a shorter log) by
themselves and then the whole log: `ms_per_scan` is what a scan more takes, `start_s` what is left
of the first run, for a peer its process with its settings and libraries, for Earshot the reading
of compiled kernels (imports and the log are read before).
"""

import dataclasses
import itertools
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from protocol.errors import EarshotError
from protocol.model import Model
from protocol.pose import FloatArray
from station.formats import Trajectory, read_text, read_tum, write_text
from station.relations import Relations, read_relations, reference_errors, relation_errors
from station.replay import Replay, ReplaySettings, play
from station.scan_log import ScanLog, read_log
from station.warm_up import ensure_warm
from studies.command import one_line_errors, study_parser, write_figures
from studies.rawlog import mended, paired

PROGRAMS = ("icp-slam", "rbpf-slam", "carmen2rawlog")
SETTINGS = Path("/usr/share/mrpt/config_files")
FINE = {
    "corresponding_points_decimation": "1",
    "localizationLinDistance": "0.05",
    "localizationAngDistance": "2",
}
# What draws or stores what nobody looks at.
QUIET = {
    "SAVE_3D_SCENE": "0",
    "SAVE_MAP_IMAGES": "0",
    "SHOW_PROGRESS_3D_REAL_TIME": "0",
    "SHOW_PROGRESS_IN_WINDOW": "0",
    "LOG_FREQUENCY": "1000000",
}


@dataclasses.dataclass(frozen=True, slots=True)
class Setting:
    """A program with the settings of a shipped file (its name without .ini), some changed."""

    program: str
    file: str
    changed: dict[str, str]


PEERS = {
    "icp-slam classic": Setting("icp-slam", "icp-slam_demo_classic", {}),
    "icp-slam gridmatch": Setting("icp-slam", "icp-slam_demo_classic_gridmatch", {}),
    "icp-slam LM": Setting("icp-slam", "icp-slam_demo_LM", {}),
    "icp-slam fine": Setting("icp-slam", "icp-slam_demo_classic", FINE),
    "rbpf-slam ICP, intel": Setting("rbpf-slam", "gridmapping_RBPF_ICPbased_intel", {}),
    "rbpf-slam ICP, malaga": Setting("rbpf-slam", "gridmapping_RBPF_ICPbased_malaga", {}),
    "rbpf-slam grid ICP": Setting("rbpf-slam", "gridmapping_RBPF_grid_ICPbased_malaga", {}),
    "rbpf-slam optimal": Setting("rbpf-slam", "gridmapping_optimal_sampling", {}),
    "rbpf-slam intel": Setting("rbpf-slam", "gridmapping_intel", {}),
}


HEAD = 100  # scans: enough to meet all that is loaded late, few beside any log


class PeerError(EarshotError):
    """A peer that is not there, or gave no trajectory; the message says what to do."""


class Figures(Model):
    """One system with one setting on one log; the errors that were asked for."""

    ms_per_scan: float
    start_s: float
    ate_rmse_m: float | None = None
    translation_mean_m: float | None = None
    rotation_mean_deg: float | None = None


@dataclasses.dataclass(frozen=True, slots=True)
class Measure:
    """What trajectories are held against."""

    reference: Trajectory | None
    relations: Relations | None
    interpolate: bool

    def figures(self, replay: Replay, scan_s: float, start_s: float) -> Figures:
        found: dict[str, float] = {}
        if self.reference is not None:
            found["ate_rmse_m"] = reference_errors(replay, self.reference).ate_rmse_m
        if self.relations is not None:
            errors = relation_errors(replay, self.relations, self.interpolate)
            found["translation_mean_m"] = errors.translation_mean_m
            found["rotation_mean_deg"] = errors.rotation_mean_deg
        return Figures(ms_per_scan=1e3 * scan_s, start_s=start_s, **found)


def require_peer() -> None:
    """Raises PeerError when a program or its settings are not installed."""
    missing = [program for program in PROGRAMS if shutil.which(program) is None]
    if missing or not SETTINGS.is_dir():
        raise PeerError(
            f"{' and '.join(missing) or SETTINGS} not found: Debian's mrpt-apps and mrpt-common "
            "have them"
        )


def path_of(
    setting: Setting, rawlog: Path, scans: int, place: Path, limit_s: float
) -> tuple[FloatArray, float]:
    """The peer's pose at every scan (n×3), as it said it at once, and its processor time in s."""
    out = place / "out"
    shutil.rmtree(out, ignore_errors=True)
    text = read_text(SETTINGS / setting.program / f"{setting.file}.ini")
    changed = {**QUIET, **setting.changed, "rawlog_file": str(rawlog), "logOutput_dir": str(out)}
    for name, value in changed.items():
        line = f"{name}={value}".replace("\\", "\\\\")
        text = re.sub(rf"(?m)^{name}\s*=.*$", line, text)
    write_text(place / "settings.ini", text)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    _run([setting.program, "settings.ini"], place, limit_s)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    path = out / "log_estimated_path.txt"
    if not path.is_file():
        raise PeerError(f"{setting.program} with {setting.file} left no path")
    rows = np.loadtxt(path, ndmin=2, comments="%")
    # icp-slam has a row each for odometry and scan, rbpf-slam z before the yaw.
    poses = rows[1::2, 1:4] if setting.program == "icp-slam" else rows[:, [1, 2, 4]]
    if len(poses) != scans:
        raise PeerError(f"{setting.program} gave {len(poses)} poses for {scans} scans")
    return np.ascontiguousarray(poses, dtype=np.float64), seconds


def _run(command: list[str], place: Path, limit_s: float) -> None:
    try:
        subprocess.run(
            command,
            cwd=place,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=limit_s,
            check=True,
        )
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        raise PeerError(f"{command[0]} gave no answer: {error}") from error


def compare(
    path: Path, log: ScanLog, measure: Measure, limit_s: float, only: str = ""
) -> Iterator[tuple[str, Figures | PeerError]]:
    """Earshot and each peer with each of its settings on one log, or why there is no answer; with
    `only` those peers whose names hold that."""
    few = min(HEAD, len(log.scans) // 2)
    head = dataclasses.replace(log, scans=log.scans[:few])
    (start, start_s), (replay, seconds) = _played(head), _played(log)
    scan_s = seconds / len(replay.stamps)
    yield "earshot", measure.figures(replay, scan_s, start_s - scan_s * len(start.stamps))
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        some = place / "head.clf"
        write_text(some, _first_lines(path, few))
        heads, wholes = (
            _rawlogs(*of, place, limit_s) for of in ((some, start), (path.resolve(), replay))
        )
        more = len(replay.stamps) - len(start.stamps)
        chosen = {name: setting for name, setting in PEERS.items() if only in name}
        for name, setting in chosen.items():
            kind = setting.program == "icp-slam"
            try:
                _, start_s = path_of(setting, heads[kind], len(start.stamps), place, limit_s)
                poses, seconds = path_of(setting, wholes[kind], len(replay.stamps), place, limit_s)
            except PeerError as error:
                yield name, error
                continue
            scan_s = (seconds - start_s) / more
            start_s -= scan_s * len(start.stamps)
            yield name, measure.figures(dataclasses.replace(replay, poses=poses), scan_s, start_s)


def _played(log: ScanLog) -> tuple[Replay, float]:
    began = time.process_time()
    return play(log, ReplaySettings()), time.process_time() - began


def _first_lines(path: Path, scans: int) -> str:
    lines = (line for line in read_text(path).splitlines() if line.startswith("FLASER"))
    return "".join(f"{line}\n" for line in itertools.islice(lines, scans))


def _rawlogs(log: Path, replay: Replay, place: Path, limit_s: float) -> tuple[Path, Path]:
    """The log as pairs of an action and its scan for rbpf-slam, and one by one for icp-slam."""
    raw, single, pairs = (place / f"{log.stem}-{of}.rawlog" for of in ("raw", "single", "pairs"))
    _run(["carmen2rawlog", "-w", "-q", "-i", str(log), "-o", str(raw)], place, limit_s)
    single.write_bytes(mended(raw.read_bytes(), replay.stamps, replay.lidar))
    pairs.write_bytes(paired(single.read_bytes()))
    return pairs, single


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.peers", __doc__)
    parser.add_argument("log", type=Path, metavar="LOG", help="a CARMEN log with FLASER lines")
    parser.add_argument("--reference", type=Path, metavar="FILE", help="a .tum trajectory")
    parser.add_argument("--relations", type=Path, metavar="FILE", help="of Kümmerle et al.")
    parser.add_argument("--interpolate", action="store_true", help="also between scans")
    parser.add_argument(
        "--limit", type=float, default=1800.0, metavar="S", help="for each peer, by the clock"
    )
    parser.add_argument("--only", default="", metavar="TEXT", help="peers named so, as classic")
    arguments = parser.parse_args(argv)
    require_peer()
    measure = Measure(
        read_tum(arguments.reference) if arguments.reference else None,
        read_relations(arguments.relations) if arguments.relations else None,
        arguments.interpolate,
    )
    log = read_log(arguments.log)
    ensure_warm()
    found: dict[str, dict[str, float] | str] = {}
    for name, outcome in compare(arguments.log, log, measure, arguments.limit, arguments.only):
        if isinstance(outcome, PeerError):
            found[name] = told = str(outcome)
        else:
            found[name] = figures = outcome.model_dump(exclude_none=True)
            told = ", ".join(f"{what} {value:.4g}" for what, value in figures.items())
        print(f"{name:>21}  {told}", flush=True)
    write_figures(found, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
