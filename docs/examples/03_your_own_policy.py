"""An exploration policy of your own in one file: the longest frontier first, wherever it is.

A policy is a class with `plan`: a snapshot of what the robot knows in, a path out. The planner's
parts do the work; the choice is one line. The command line takes this file too:

    earshot run --map rooms-small --policy docs/examples/03_your_own_policy.py:LongestFrontier
"""

from protocol.pose import Pose2
from robot.explore.frontier import find_frontiers
from robot.explore.planner import NO_PATH, path_to, survey, travel_field
from robot.explore.policy import Plan, View


class LongestFrontier:
    def plan(self, view: View) -> Plan:
        terrain = survey(view.grid, view.body)
        field = travel_field(terrain, view.pose)
        if field is None:
            return Plan(None, NO_PATH, "waiting for a first map", False, 0.0)
        frontiers = find_frontiers(terrain, field, view.refused)
        if not frontiers:
            return Plan(None, NO_PATH, "nothing reachable is left", True, 0.0)
        longest = max(frontiers, key=lambda frontier: frontier.length_m)
        x, y = terrain.point_of(longest.row, longest.column)
        path = path_to(terrain, field, longest.row, longest.column)
        left = sum(frontier.length_m for frontier in frontiers)
        return Plan(Pose2(x, y, 0.0), path, f"a frontier of {longest.length_m:.1f} m", False, left)


def main() -> None:
    # Here and not above: a robot that loads this file needs no station.
    from station.api import RobotSpec, Scenario, run  # noqa: PLC0415

    for policy in ("frontier", f"{__file__}:LongestFrontier"):
        robots = tuple(RobotSpec(name=name, policy=policy) for name in ("r1", "r2"))
        metrics = run(Scenario(map="rooms-small", seed=3, robots=robots)).metrics
        driven = sum(robot.driven_m for robot in metrics.robots.values())
        name = policy.rpartition(":")[2]
        print(f"{name:16} {metrics.exit_reason} after {metrics.sim_s:.1f} s, {driven:.1f} m driven")


if __name__ == "__main__":  # a robot that loads this file for its policy must not start a run
    main()
