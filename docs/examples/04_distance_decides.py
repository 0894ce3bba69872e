"""The same team with two radio ranges d: what they know of each other's work, and when.

Nothing is shared beyond d. A team that seldom meets explores the same rooms twice.
"""

from pathlib import Path

from station.api import GateConfig, run
from station.scenario_file import read_scenario

scenario = read_scenario(Path(__file__).with_suffix(".yaml"))
print("   d   ended   first contact   in range   driven    carried   map of the poorer robot")
for range_m in (10.0, 2.0):
    radio = GateConfig(range_m=range_m)
    result = run(scenario.model_copy(update={"radio": radio}))
    metrics, world = result.metrics, result.outcome.simulation
    linked = world.link_history[:, 0, 1]
    first = f"{linked.argmax() * scenario.tick_s:5.1f} s" if linked.any() else "  never"
    driven = sum(robot.driven_m for robot in metrics.robots.values())
    print(
        f"{range_m:4.0f} m {metrics.sim_s:5.1f} s   {first:>13}   {linked.mean():8.0%}   "
        f"{driven:4.0f} m   {metrics.radio.bytes_delivered / 1000:5.0f} kB   "
        f"{metrics.coverage_worst_joint:.1%}"
    )
