"""Many robots that drive, in one world: how long a tick takes, and where the time goes.

    python -m studies.crowd --robots 1000 --json crowd.json

The robots wander: straight on until the scan says that something is near, then they turn to the
side that is more open. A tick is timed from the actions to the senses, without the wandering. What
was made in the set-up is kept out of Python's garbage collection: looking through it again and
again is no part of a tick.
"""

import gc
import sys
import time

import numpy as np

from maps.building import BuildingConfig
from maps.generator import make_building
from protocol.messages import Action, DriveCommand, Sense
from studies.command import one_line_errors, print_figures, study_parser, write_figures
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

BUILDING = BuildingConfig(layout="office", seed=4, width_m=300.0, height_m=200.0)
# The first scans are fuller than later ones, and what is compiled or read is done by then.
WARM_UP_TICKS = 10


def measure(robots: int, ticks: int, seed: int) -> dict[str, float]:
    """Milliseconds that a tick takes, and how much of the time the robots drove."""
    scenario = Scenario(
        seed=seed, robots=tuple(RobotSpec(name=f"r{i}") for i in range(robots)), max_sim_s=1e6
    )
    simulation = Simulation(scenario, make_building(BUILDING))
    senses = simulation.step({})
    took_ms, worked_ms = [], []
    gc.collect()
    gc.freeze()
    for _ in range(WARM_UP_TICKS + ticks):
        actions = {name: wander(sense) for name, sense in senses.items()}
        began, began_work = time.perf_counter(), time.process_time()
        senses = simulation.step(actions)
        took_ms.append(1e3 * (time.perf_counter() - began))
        worked_ms.append(1e3 * (time.process_time() - began_work))
    gc.unfreeze()
    timed = np.array(took_ms[WARM_UP_TICKS:])
    driven = [simulation.history.driven_m(i) for i in range(robots)]
    simulated_s = (WARM_UP_TICKS + ticks) * scenario.tick_s
    return {
        "robots": robots,
        "beams": scenario.lidar.beams,
        "ticks": ticks,
        "tick_cpu_ms_median": float(np.median(worked_ms[WARM_UP_TICKS:])),
        "tick_ms_mean": float(timed.mean()),
        "tick_ms_median": float(np.median(timed)),
        "tick_ms_p99": float(np.percentile(timed, 99)),
        "times_real_time": float(1e3 * scenario.tick_s / timed.mean()),
        "mean_speed_mps": float(np.mean(driven) / simulated_s),
        "share_of_robots_that_drove": float(np.mean(np.array(driven) > 0.0)),
        "contacts_per_robot_and_minute": float(
            60.0 * sum(simulation.collisions.values()) / robots / simulated_s
        ),
    }


def wander(sense: Sense) -> Action:
    """Straight on, slower as it gets narrow; beside something near, towards the open side."""
    if sense.ranges is None:
        raise ValueError("a robot that wanders needs a scan in every sense")
    beams = len(sense.ranges)
    ahead = np.minimum(sense.ranges[beams // 4 : beams - beams // 4], 3.0)  # right to left
    middle = len(ahead) // 2
    nearest = float(ahead[middle // 2 : -(middle // 2)].min())
    turn = 1.5 if float(ahead[middle:].sum()) > float(ahead[:middle].sum()) else -1.5
    command = DriveCommand(
        forward_mps=0.6 * min(max(nearest - 0.4, 0.0), 1.0), turn_rps=turn if nearest < 0.9 else 0.0
    )
    return Action(tick=sense.tick, drive=command)


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.crowd", __doc__)
    parser.add_argument("--robots", type=int, default=1000)
    parser.add_argument("--ticks", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    result = measure(arguments.robots, arguments.ticks, arguments.seed)
    print_figures(result)
    write_figures(result, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
