"""Does a match lengthen the way, or turn it, the same each time?

    python -m studies.match_bias
    python -m studies.match_bias --map MAPS/willow.yaml --views 4000 --json bias.json

Errors that average out cost little. One that does not, a millimetre in the direction of travel or a
tenth of a milliradian to one side, bends or stretches a whole map. Here a robot stands at a random
free pose, in a field that is drawn from scans at the true poses of the way that led there; one more
scan is matched, begun at the truth. Told are the mean error, its standard error and the spread.
"""

import math
import sys

import numpy as np

from protocol.pose import IDENTITY, Pose2
from robot.perception.field import CorrelationField
from robot.perception.matching import match_returns
from robot.perception.returns import Returns, describe_returns, noise_model
from station.warm_up import ensure_warm
from studies.command import one_line_errors, print_figures, study_parser, write_figures
from studies.views import LIDAR, Views

WAY, STEP_M = 8, 0.15
RIGHT_M = 0.05
NOISE = noise_model(LIDAR)


def measure(name: str, views: int, seed: int, noisy: bool) -> dict[str, float]:
    """Figures over so many places; matches more than `RIGHT_M` off are another matter."""
    building = Views(name, seed)
    errors = []
    for _ in range(views):
        error = _error(building, noisy)
        if math.hypot(error.x, error.y) < RIGHT_M:
            errors.append(error.to_array())
    found = 1e3 * np.array(errors)
    mean, spread = found.mean(axis=0), found.std(axis=0)
    figures: dict[str, float] = {"matches": len(found)}
    for axis, label in enumerate(("forward_mm", "left_mm", "turn_mrad")):
        figures[f"{label}_mean"] = float(mean[axis])
        figures[f"{label}_standard_error"] = float(spread[axis] / math.sqrt(len(found)))
        figures[f"{label}_sigma"] = float(spread[axis])
    return figures


def _error(building: Views, noisy: bool) -> Pose2:
    """Where the match ends, as seen from the truth."""
    behind = [Pose2(-STEP_M * step, 0.0, 0.0) for step in range(1, WAY + 1)]
    here = building.free_pose()
    while not all(building.is_free(here @ T_here_then) for T_here_then in behind):
        here = building.free_pose()
    field = CorrelationField.around(LIDAR.max_range_m + 2.0)
    for T_here_then in behind:
        field.draw(T_here_then, _returns(building, here @ T_here_then, noisy))
    return match_returns(field, _returns(building, here, noisy), IDENTITY).T_field_base


def _returns(building: Views, pose: Pose2, noisy: bool) -> Returns:
    return describe_returns(building.scan(pose, noisy), NOISE, LIDAR.max_range_m)


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.match_bias", __doc__)
    parser.add_argument("--map", default="office", help="a shipped map or a map_server YAML file")
    parser.add_argument("--views", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--exact", action="store_true", help="without the range finder's noise")
    arguments = parser.parse_args(argv)
    ensure_warm()
    figures = measure(arguments.map, arguments.views, arguments.seed, not arguments.exact)
    print_figures(figures)
    write_figures(figures, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
