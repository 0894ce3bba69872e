"""Scan matching against the Cramér-Rao bound: two scans, a wrong guess, one answer.

    python -m studies.matching --pairs 10000 --peer small_gicp --json matching.json
    python -m studies.matching --map corridor

Two scans of 257 beams (`modern` noise) are taken up to 0.5 m and 15° apart and matched from a guess
that is up to 0.3 m and 15° off. Each pair's bound (Censi, "On achievable accuracy for range-finder
localization", 2007, and "... for pose tracking", 2009) follows from the surfaces' normals: a beam
of range noise σ that meets a surface at an angle β tells the pose along the normal n with σ cos β:
I = Σ h hᵀ / (σ cos β)², h = (n, p × n). Both scans are noisy: C = I_b⁻¹ + Ad I_a⁻¹ Adᵀ, with
normals from scans without noise. A pair whose bound leaves more than `DEGENERATE_M` in some
direction is degenerate and listed apart, with how many of those, and of the others, the matcher
flags by its own covariance; the others succeed when they end within 0.1 m and 2°. RMSE is over
those that succeed, as a multiple of the bound's; NEES is by the covariance that the matcher gives.
`unflagged_success` knows no bound: the share that ends as near of all pairs that are not flagged.
Times are of one thread, from ranges (for the peer: points) to the pose.
"""

import importlib.util
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from protocol.errors import EarshotError
from protocol.pose import FloatArray, Pose2
from robot.perception.pair_matching import PairMatch, match_pair
from robot.perception.returns import Returns, describe_returns, noise_model
from robot.perception.scan import LaserScan
from robot.slam.gaussian import carry, invert_spd
from station.warm_up import ensure_warm
from studies.command import one_line_errors, print_figures, study_parser, write_figures
from studies.views import EXACT, LIDAR, Views

NOISE = noise_model(LIDAR)
APART_M, APART_RAD = 0.5, math.radians(15.0)
OFF_M, OFF_RAD = 0.3, math.radians(15.0)
SUCCESS_M, SUCCESS_RAD = 0.1, math.radians(2.0)
DEGENERATE_M = 0.05

Method = Callable[[LaserScan, LaserScan, Pose2], PairMatch]


@dataclass(frozen=True, slots=True)
class Pair:
    """Two scans, the true T_a_b, a guess of it, and the bound's covariance (3×3)."""

    a: LaserScan
    b: LaserScan
    T_a_b: Pose2
    guess: Pose2
    covariance: FloatArray


def bound(returns: Returns) -> FloatArray:
    """Information (3×3, tangent space at the scan) in returns whose normals are exact."""
    points, normals = returns.points, returns.values[:, 2:4]
    kept = np.abs(normals).sum(axis=1) > 0.0
    points, normals = points[kept], normals[kept]
    r = np.hypot(points[:, 0], points[:, 1])
    facing = (points * normals).sum(axis=1) / r
    along = (NOISE[0] + NOISE[1] * r) ** 2 * facing**2
    sideways = (r * NOISE[3]) ** 2 * (1.0 - facing**2)
    lever = points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]
    h = np.column_stack([normals, lever])
    return np.asarray((h / (along + sideways)[:, None]).T @ h, dtype=np.float64)


class Pairs:
    """Random pairs of scans in one building, the same for every matcher."""

    def __init__(self, name: str, seed: int) -> None:
        self._views = Views(name, seed)

    def next(self) -> Pair:
        views = self._views
        while True:
            a = views.free_pose()
            T_a_b = views.offset(APART_M, APART_RAD)
            b = a @ T_a_b
            if views.is_free(b):
                break
        (scan_a, of_a), (scan_b, of_b) = self._scan(a), self._scan(b)
        covariance = invert_spd(of_b) + carry(invert_spd(of_a), T_a_b)
        return Pair(scan_a, scan_b, T_a_b, T_a_b @ views.offset(OFF_M, OFF_RAD), covariance)

    def _scan(self, pose: Pose2) -> tuple[LaserScan, FloatArray]:
        """A scan as the robot sees it, and the information that the same one without noise has."""
        scan, exact = self._views.scan(pose), self._views.scan(pose, noisy=False)
        returns = describe_returns(exact, noise_model(EXACT), LIDAR.max_range_m)
        return scan, bound(returns) + 1e-6 * np.eye(3)


def by_earshot(a: LaserScan, b: LaserScan, guess: Pose2) -> PairMatch:
    """Our own matcher."""
    target, source = (describe_returns(scan, NOISE, LIDAR.max_range_m) for scan in (a, b))
    return match_pair(target, source, guess, NOISE)


def small_gicp_method() -> Method:
    """small_gicp's ICP on the points of both scans, one thread, else as it comes."""
    if importlib.util.find_spec("small_gicp") is None:
        raise EarshotError(
            "--peer small_gicp: it is not installed; `pip install small_gicp` installs it"
        )
    library = importlib.import_module("small_gicp")

    def match(a: LaserScan, b: LaserScan, guess: Pose2) -> PairMatch:
        target, source = (_points(scan) for scan in (a, b))
        start = np.eye(4)
        c, s = math.cos(guess.theta), math.sin(guess.theta)
        start[:2, :2] = [[c, -s], [s, c]]
        start[:2, 3] = guess.x, guess.y
        found = library.align(
            target,
            source,
            init_T_target_source=start,
            registration_type="ICP",
            downsampling_resolution=0.01,
            max_correspondence_distance=1.0,
            num_threads=1,
        )
        T = found.T_target_source
        pose = Pose2(T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0]))
        return PairMatch(pose, np.eye(3), 1.0, int(found.iterations), bool(found.converged))

    return match


def _points(scan: LaserScan) -> FloatArray:
    ranges, angles = np.asarray(scan.ranges), np.asarray(scan.angles)
    seen = np.isfinite(ranges) & (ranges <= LIDAR.max_range_m)
    r, angle = ranges[seen], angles[seen]
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), np.zeros(len(r))])


class Tally:
    """What one method made of all pairs."""

    def __init__(self, method: Method) -> None:
        self._method = method
        self._seconds: list[float] = []
        self._matches: list[PairMatch] = []
        self._pairs: list[Pair] = []

    def take(self, pair: Pair) -> None:
        began = time.perf_counter()
        match = self._method(pair.a, pair.b, pair.guess)
        self._seconds.append(time.perf_counter() - began)
        self._matches.append(match)
        self._pairs.append(pair)

    def figures(self) -> dict[str, float]:
        bounds = np.array([pair.covariance for pair in self._pairs])
        errors = np.array(
            [
                (pair.T_a_b.inverse() @ match.T_target_source).log()
                for pair, match in zip(self._pairs, self._matches, strict=True)
            ]
        )
        flagged = np.array([match.sigma_m > DEGENERATE_M for match in self._matches])
        held = np.array([np.linalg.eigvalsh(C[:2, :2])[-1] <= DEGENERATE_M**2 for C in bounds])
        near = np.hypot(errors[:, 0], errors[:, 1]) < SUCCESS_M
        right = near & (np.abs(errors[:, 2]) < SUCCESS_RAD)
        good = held & right
        e, C = errors[good], bounds[good]
        information = np.array([match.information for match in self._matches])[good]
        far, turn = (e[:, :2] ** 2).sum(axis=1).mean(), (e[:, 2] ** 2).mean()
        return {
            "success": float(good.sum() / held.sum()),
            "rmse_m": math.sqrt(far),
            "rmse_by_bound_m": math.sqrt(far / (C[:, 0, 0] + C[:, 1, 1]).mean()),
            "rmse_rad": math.sqrt(turn),
            "rmse_by_bound_rad": math.sqrt(turn / C[:, 2, 2].mean()),
            "nees_per_dof": float(np.einsum("ni,nij,nj->n", e, information, e).mean() / 3.0),
            "degenerate": int((~held).sum()),
            "degenerate_flagged": int((~held & flagged).sum()),
            "others_flagged": int((held & flagged).sum()),
            "unflagged_success": float((right & ~flagged).sum() / max((~flagged).sum(), 1)),
            "ms_median": 1e3 * float(np.median(self._seconds)),
            "ms_least": 1e3 * min(self._seconds),
        }


def measure(name: str, pairs: int, seed: int, methods: dict[str, Method]) -> dict[str, float]:
    """Figures over so many pairs, matched by one method after the other."""
    source = Pairs(name, seed)
    tallies = {method: Tally(match) for method, match in methods.items()}
    for _ in range(pairs):
        pair = source.next()
        for tally in tallies.values():
            tally.take(pair)
    figures: dict[str, float] = {"pairs": pairs}
    for method, tally in tallies.items():
        figures |= {f"{method}_{figure}": value for figure, value in tally.figures().items()}
    return figures


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.matching", __doc__)
    parser.add_argument("--map", default="office")
    parser.add_argument("--pairs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--peer", choices=("small_gicp",), help="match by this library too")
    arguments = parser.parse_args(argv)
    methods: dict[str, Method] = {"earshot": by_earshot}
    if arguments.peer:
        methods[arguments.peer] = small_gicp_method()
    ensure_warm()
    measure(arguments.map, 1, 0, methods)  # loads the kernels
    figures = measure(arguments.map, arguments.pairs, arguments.seed, methods)
    for method in methods.keys() - {"earshot"}:  # a peer has no covariance of its own
        for figure in ("nees_per_dof", "degenerate_flagged", "others_flagged", "unflagged_success"):
            del figures[f"{method}_{figure}"]
    print_figures(figures)
    write_figures(figures, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
