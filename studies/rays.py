"""Ray casting beside a plain walk cell by cell, on a 1000 × 1000 cell window of a map.

    python -m studies.rays --map ../shared/maps/intel.yaml --json rays.json

Both run in turns in the same process: the ratio is the median over the rounds. The map is brought
to 0.05 m cells; the window is the one with the most free ground. Every range must be, to the last
bit, that of a walk which computes each border anew.
"""

import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import numpy.typing as npt

from maps.grid import UNKNOWN, OccupancyGrid
from maps.library import load_map
from protocol.pose import FloatArray
from studies import walk_kernels
from studies.command import one_line_errors, study_parser, write_figures
from world import ray_kernels
from world.terrain import Terrain

SIDE, CELL_M, RANGE_M, BEAMS = 1000, 0.05, 12.0, 257

Caster = Callable[[npt.NDArray[Any], float, float, FloatArray, float, FloatArray], None]


def measure(grid: OccupancyGrid, poses: int, rounds: int, seed: int) -> dict[str, float]:
    """Million beams a second of both, their ratio, and how many beams differ."""
    terrain = Terrain(window(grid))
    rng = np.random.default_rng(seed)
    rows, columns = np.nonzero(~terrain.solid)
    chosen = rng.integers(0, len(rows), poses)
    points = np.stack([columns[chosen], rows[chosen]], axis=1) + rng.random((poses, 2))
    fan = np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
    angles = fan + rng.uniform(-math.pi, math.pi, (poses, 1))

    def cast(caster: Caster, field: npt.NDArray[Any]) -> tuple[FloatArray, float]:
        ranges = np.empty((poses, BEAMS))
        began = time.perf_counter()
        for (x, y), at, found in zip(points.tolist(), angles, ranges, strict=True):
            caster(field, x, y, at, RANGE_M / CELL_M, found)
        return ranges, ranges.size / (time.perf_counter() - began) / 1e6

    right, _ = cast(walk_kernels.walk_rays, terrain.solid)
    cast(walk_kernels.dda_rays, terrain.solid)  # compiles
    ranges, _ = cast(ray_kernels.cast_rays, terrain.squares)
    ours, plain = [], []
    for _ in range(rounds):
        plain.append(cast(walk_kernels.dda_rays, terrain.solid)[1])
        ours.append(cast(ray_kernels.cast_rays, terrain.squares)[1])
    return {
        "beams": ranges.size,
        "mean_range_m": float(np.minimum(right * CELL_M, RANGE_M).mean()),
        "plain_walk_mbeams_per_s": median(plain),
        "earshot_mbeams_per_s": median(ours),
        "ratio": median(a / b for a, b in zip(ours, plain, strict=True)),
        "beams_that_differ": int(np.sum(ranges != right)),
    }


def window(grid: OccupancyGrid) -> OccupancyGrid:
    """The `SIDE`² cells of `CELL_M` with the most free ground; unknown where the map ends."""
    times = max(1, round(grid.resolution / CELL_M))
    cells = np.repeat(np.repeat(grid.cells, times, axis=0), times, axis=1)
    missing = [(0, max(0, SIDE - size)) for size in cells.shape]
    cells = np.pad(cells, missing, constant_values=UNKNOWN)
    free = np.pad(np.cumsum(np.cumsum(cells == 0, axis=0), axis=1), ((1, 0), (1, 0)))
    inside = free[SIDE:, SIDE:] - free[:-SIDE, SIDE:] - free[SIDE:, :-SIDE] + free[:-SIDE, :-SIDE]
    r, c = np.unravel_index(int(np.argmax(inside)), inside.shape)
    found = np.ascontiguousarray(cells[r : r + SIDE, c : c + SIDE])
    return OccupancyGrid(found, CELL_M, 0.0, 0.0)


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.rays", __doc__)
    parser.add_argument(
        "--map", action="append", required=True, help="a map; may be given several times"
    )
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    results = {}
    for name in arguments.map:
        found = measure(load_map(name), arguments.poses, arguments.rounds, arguments.seed)
        results[Path(name).stem] = found
        print(
            f"{Path(name).stem:16} plain walk {found['plain_walk_mbeams_per_s']:5.2f}   "
            f"earshot {found['earshot_mbeams_per_s']:5.2f} million beams/s   "
            f"ratio {found['ratio']:.2f}   {found['beams_that_differ']:.0f} of "
            f"{found['beams']:.0f} beams differ"
        )
    write_figures(results, arguments.json)
    return 1 if any(found["beams_that_differ"] for found in results.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
