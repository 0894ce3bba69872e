"""Does SLAM stand logs of other buildings, range finders and wheels than those it was made with?

    python -m studies.synthetic_logs
    python -m studies.synthetic_logs --maps MAPS/aces.yaml,MAPS/willow.yaml --json logs.json
    python -m studies.synthetic_logs --maps office --kinds sick-8m,sparse --seeds 0-4
    python -m studies.synthetic_logs --maps office --kinds frozen --out LOGS

A robot drives round a building, visits places again and comes back. What its range finder and its
wheels said is written as a CARMEN log, in `--out` together with the truth (TUM), and played as
`earshot slam` plays it: forwards, backwards and decimated. Told is the ATE against the truth. The
kinds of logs are those that circulate: `KINDS` below has beams, field of view, what is reported
where nothing was met, the time between scans, the wheels' errors, and people who walk about.
"""

import math
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from maps.library import load_map
from protocol.config import LidarConfig
from protocol.errors import EarshotError
from protocol.pose import FloatArray, compose, invert
from station.formats import Trajectory, read_tum, write_tum
from station.relations import reference_errors
from station.replay import ReplaySettings, play
from station.scan_log import read_log
from station.warm_up import ensure_warm
from studies.command import one_line_errors, study_parser, write_figures
from studies.tours import STEP_S, Roads, drive, plan_tour
from world.lidar import Lidars
from world.noise import Noise
from world.terrain import Terrain

PERSON_RADIUS_M, PERSON_KEEPS_OFF_M = 0.2, 0.7
# Ranges of a SICK scatter by this, and are told in centimetres.
SIGMA_RANGE_M = 0.012
# Decimated replay leaves no more than this between scans.
MAX_APART_S = 2.5


@dataclass(frozen=True, slots=True)
class Wheels:
    """What odometry gets wrong: the share that distances and turns are too long, a turn to one side
    (rad/m), noise (m per √m, rad per √m, rad per √rad), and how often (1/s) it freezes for a second
    and then jumps, or slips by up to 0.3 m and 12°."""

    scale: float = 0.0
    turn: float = 0.0
    bias_rad_per_m: float = 0.0
    noise: tuple[float, float, float] = (0.01, 0.005, 0.01)
    freezes_hz: float = 0.0
    slips_hz: float = 0.0


GOOD = Wheels(0.005, 0.01, 0.001)
BIASED = Wheels(0.05, -0.06, 0.03, (0.02, 0.01, 0.03))
FROZEN = Wheels(-0.02, 0.03, -0.01, freezes_hz=1 / 30)
SLIPPING = Wheels(0.03, 0.05, 0.01, (0.03, 0.02, 0.03), slips_hz=1 / 20)


@dataclass(frozen=True, slots=True)
class Kind:
    """A range finder, the wheels under it, and how many people are about.

    `nothing_m` is what is logged where nothing was met within `max_range_m`. A field of view other
    than a SICK's half turn is told in ROBOTLASER lines.
    """

    beams: int
    every_s: float
    wheels: Wheels
    max_range_m: float = 80.0
    nothing_m: float = 81.83
    people: int = 0
    view_deg: float | None = None

    @property
    def lidar(self) -> LidarConfig:
        """Beams as `station.replay.lidar_of` has them."""
        if self.view_deg is not None:
            view = math.radians(self.view_deg)
        else:
            view = math.pi * (1.0 if self.beams % 2 else (self.beams - 1) / self.beams)
        first = -0.5 * (math.pi if self.view_deg is None else view)
        return LidarConfig(
            beams=self.beams,
            field_of_view_rad=view,
            angle_min_rad=first,
            min_range_m=0.02,
            max_range_m=self.max_range_m,
            noise="none",
        )


KINDS = {
    "sick-180": Kind(180, 0.2, BIASED),
    "sick-361": Kind(361, 0.2, GOOD, nothing_m=81.91),
    "frozen": Kind(361, 0.2, FROZEN, nothing_m=81.91, people=2),
    "slipping": Kind(181, 0.3, SLIPPING, 50.0, 50.0),
    "sick-8m": Kind(361, 0.25, BIASED, 8.0, 8.19, people=2),
    "slow": Kind(181, 1.0, BIASED, 50.0, 50.0, people=3),
    "sparse": Kind(180, 3.0, GOOD),
    "all-round": Kind(360, 0.5, BIASED, 20.0, 20.0, people=3, view_deg=360.0),
    "urg": Kind(341, 0.2, GOOD, 5.6, 5.6, view_deg=240.0),
}


def wheels_said(truth: FloatArray, wheels: Wheels, rng: np.random.Generator) -> FloatArray:
    """Odometry (n×3) of a way that was driven (n×3)."""
    steps = compose(invert(truth[:-1]), truth[1:])
    metres, turned = np.abs(steps[:, 0]), np.abs(steps[:, 2])
    along, drift, scrub = wheels.noise
    draws = rng.standard_normal((3, len(steps)))
    steps[:, 0] += wheels.scale * steps[:, 0] + along * np.sqrt(metres) * draws[0]
    steps[:, 2] += wheels.turn * steps[:, 2] + wheels.bias_rad_per_m * metres
    steps[:, 2] += drift * np.sqrt(metres) * draws[1] + scrub * np.sqrt(turned) * draws[2]
    slips = np.flatnonzero((rng.random(len(steps)) < wheels.slips_hz * STEP_S) & (metres > 0.0))
    steps[slips, 0] += rng.uniform(-0.1, 0.3, len(slips))
    steps[slips, 2] += np.radians(rng.uniform(-12.0, 12.0, len(slips)))
    said = [np.array([3.0, -2.0, 0.7])]
    for step in steps:
        said.append(compose(said[-1], step))
    odometry = np.array(said)
    for start in np.flatnonzero(rng.random(len(odometry)) < wheels.freezes_hz * STEP_S):
        end = start + round(rng.uniform(0.4, 1.5) / STEP_S)
        odometry[start:end] = odometry[start].copy()
    return odometry


def people_about(truth: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Where people stand (count×n×3) who walk to and fro before and behind the robot."""
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    seconds = STEP_S * np.arange(len(truth))
    found = np.empty((count, len(truth), 3))
    for person in found:
        period, phase, beside = rng.uniform((15, 0, -0.6), (40, 2 * math.pi, 0.6))
        ahead = rng.uniform(0.0, 3.0) + 4.0 * np.sin(2 * math.pi * seconds / period + phase)
        where = np.searchsorted(travelled, np.clip(travelled + ahead, 0.0, travelled[-1] - 1e-6))
        person[:] = truth[where]
        person[:, 0] -= beside * np.sin(person[:, 2])
        person[:, 1] += beside * np.cos(person[:, 2])
        # Who comes too close steps out of the way altogether.
        near = np.hypot(*(person[:, :2] - truth[:, :2]).T) < PERSON_KEEPS_OFF_M
        person[near, :2] = 1e4
    return found


def make_log(terrain: Terrain, kind: Kind, metres: float, seed: int, folder: Path) -> Path:
    """Drive, and write LOG.clf and LOG.truth.tum; the log's path."""
    rng = np.random.default_rng(seed)
    truth = drive(plan_tour(Roads(terrain), metres, rng), rng)
    odometry = wheels_said(truth, kind.wheels, rng)
    people = people_about(truth, kind.people, rng)
    names = ("robot", *(f"person{number}" for number in range(kind.people)))
    lidars = Lidars(kind.lidar, names, PERSON_RADIUS_M)
    noise = Noise(seed)
    stamps, lines = [], []
    for tick in range(0, len(truth), round(kind.every_s / STEP_S)):
        bodies = np.vstack([truth[tick], people[:, tick]])
        bodies = bodies[bodies[:, 0] < 1e3]
        ranges = lidars.scan(terrain, bodies, tick, noise)[0].astype(np.float64)
        ranges += SIGMA_RANGE_M * rng.standard_normal(len(ranges))
        ranges = np.where(np.isfinite(ranges), np.maximum(ranges, 0.0), kind.nothing_m)
        stamps.append(1000.0 + STEP_S * tick)
        lines.append(_line(kind, ranges, odometry[tick], stamps[-1]))
    path = folder / "log.clf"
    path.write_text("# simulated\n" + "".join(lines), encoding="ascii")
    ticks = slice(0, len(truth), round(kind.every_s / STEP_S))
    write_tum(Trajectory(np.array(stamps), truth[ticks]), folder / "log.truth.tum")
    return path


def _line(kind: Kind, ranges: FloatArray, odometry: FloatArray, stamp: float) -> str:
    said = " ".join(f"{value:.2f}" for value in ranges)
    pose = " ".join(f"{value:.6f}" for value in odometry)
    tail = f"{stamp:.6f} simulated {stamp - 1000.0:.6f}\n"
    if kind.view_deg is None:
        return f"FLASER {len(ranges)} {said} {pose} {pose} {tail}"
    lidar = kind.lidar
    head = f"{lidar.angle_min_rad:.6f} {lidar.field_of_view_rad:.6f} {lidar.increment_rad:.6f}"
    return (
        f"ROBOTLASER1 0 {head} {kind.max_range_m:.2f} 0.01 0 {len(ranges)} {said} 0 "
        f"{pose} {pose} 0 0 0.3 0.3 1e6 {tail}"
    )


def measure(path: Path, every: int) -> dict[str, float]:
    """ATE (m) of a log that was made, played each way; `metres` of it."""
    log, truth = read_log(path), read_tum(path.with_suffix(".truth.tum"))
    figures = {"metres": float(np.hypot(*np.diff(truth.poses[:, :2], axis=0).T).sum())}
    ways = {"forwards": ReplaySettings(), "backwards": ReplaySettings(reverse=True)}
    if every > 1:
        ways[f"every {every}"] = ReplaySettings(every=every)
    for way, settings in ways.items():
        figures[way] = reference_errors(play(log, settings), truth).ate_rmse_m
    return figures


def _seeds(text: str) -> range:
    first, _, last = text.partition("-")
    try:
        return range(int(first), int(last or first) + 1)
    except ValueError:
        raise EarshotError(f"--seeds: expected a number or FIRST-LAST, got {text!r}") from None


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.synthetic_logs", __doc__)
    parser.add_argument("--maps", default="office", help="shipped maps or map_server files, by ,")
    parser.add_argument("--kinds", default=",".join(KINDS), help="of logs, by , (default: all)")
    parser.add_argument("--metres", type=float, default=300.0, help="of a drive, about")
    parser.add_argument("--seeds", default="0", help="a number or FIRST-LAST")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep logs and truths there")
    arguments = parser.parse_args(argv)
    kinds, seeds = arguments.kinds.split(","), _seeds(arguments.seeds)
    unknown = [name for name in kinds if name not in KINDS]
    if unknown:
        raise EarshotError(f"--kinds: no {unknown[0]!r}; there are {', '.join(KINDS)}")
    ensure_warm()
    found: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in arguments.maps.split(","):
            terrain = Terrain(load_map(name))
            for kind in kinds:
                for seed in seeds:
                    place = (arguments.out or Path(scratch)) / f"{Path(name).stem}-{kind}-{seed}"
                    place.mkdir(parents=True, exist_ok=True)
                    path = make_log(terrain, KINDS[kind], arguments.metres, seed, place)
                    every = min(3, int(MAX_APART_S / KINDS[kind].every_s))
                    figures = measure(path, every)
                    found.append({"map": Path(name).stem, "kind": kind, "seed": seed, **figures})
                    told = "  ".join(f"{what} {value:.3f}" for what, value in figures.items())
                    print(f"{place.name:>28}  {told}", flush=True)
    write_figures(found, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
