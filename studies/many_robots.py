"""Many robot processes on one machine in real time: what they cost, and whether all is delivered.

    python -m studies.many_robots --robots 32 --factor 0.25 --seconds 60 --json many.json

Shown are the wall time until
all robots had come, the memory of the robots' processes (RSS at its peak; PSS, which counts a page
that n processes share as one nth for each, at its greatest), messages between world and robots that
were sent and not received, ticks that went by before they were answered, and the pace kept.
"""

import sys
import time
from statistics import median
from typing import Any

from station.hosts import Unwatched
from station.launch import launch
from station.observer import RunOutcome
from station.report_metrics import messages_lost
from station.warm_up import ensure_warm
from studies.command import aligned, one_line_errors, study_parser, write_figures
from world.scenario import PaceConfig, RobotSpec, Scenario
from world.simulation import Simulation

OFFICE = "office:width_m=100,height_m=60"
ROSTER_S = 120.0
TELL_EVERY_S = 10.0


class StartTimed(Unwatched):
    """Takes the wall time until the last robot had come, and tells how far the run is."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._next = 0.0
        self.start_s = 0.0

    def started(self, simulation: Simulation) -> None:
        self.start_s = time.monotonic() - self._began
        print(f"{len(simulation.names)} robots started in {self.start_s:.1f} s", flush=True)

    def ticked(self, simulation: Simulation, reports: Any) -> None:
        del reports
        if simulation.stamp >= self._next:
            self._next += TELL_EVERY_S
            wall_s = time.monotonic() - self._began - self.start_s
            print(f"  {simulation.stamp:.0f} s simulated in {wall_s:.0f} s", flush=True)


def measure(scenario: Scenario) -> dict[str, Any]:
    """Play a scenario in processes, and say how it went."""
    observer = StartTimed()
    outcome = launch(scenario, "processes", observer)
    robots = outcome.robots
    return {
        "robots": len(robots),
        "start_s": observer.start_s,
        "sim_s": outcome.simulation.stamp,
        "pace": outcome.simulation.stamp / outcome.wall_s,
        "exit_reason": outcome.exit_reason,
        "alive": len(outcome.simulation.alive),
        "answered": sum(robot.wire is not None for robot in robots.values()),
        "rss_mb": _spread([r.peak_rss_mb for r in robots.values() if r.peak_rss_mb]),
        "pss_mb": _spread(
            [max(s.pss_mb for s in r.memory) for r in robots.values() if r.memory],
        ),
        "world_rss_mb": outcome.world_peak_rss_mb,
        "messages": _messages(outcome),
        "messages_lost": messages_lost(outcome),
        "missed_ticks": sum(robot.missed_ticks for robot in robots.values()),
        "notes": {name: robot.note for name, robot in robots.items() if robot.note},
        "wire": {
            name: {topic: count.model_dump() for topic, count in (robot.wire or {}).items()}
            for name, robot in robots.items()
        },
    }


def _spread(values: list[float]) -> dict[str, float]:
    return {"median": median(values), "max": max(values)} if values else {}


def _messages(outcome: RunOutcome) -> dict[str, dict[str, int]]:
    """Sent and received by topic, all robots together."""
    total: dict[str, dict[str, int]] = {}
    for robot in outcome.robots.values():
        for topic, count in (robot.wire or {}).items():
            row = total.setdefault(topic, {"sent": 0, "received": 0})
            row["sent"] += count.sent
            row["received"] += count.received
    return total


def table(result: dict[str, Any]) -> str:
    rows = [
        ("robots that answered at the end", f"{result['answered']} of {result['robots']}"),
        ("all started in", f"{result['start_s']:.1f} s"),
        ("simulated", f"{result['sim_s']:.0f} s at {result['pace']:.3f} × real time"),
        ("RSS of a robot, peak", _mb(result["rss_mb"])),
        ("PSS of a robot", _mb(result["pss_mb"])),
        ("RSS of the world, peak", f"{result['world_rss_mb']:.0f} MB"),
        *(
            (f"{topic}: sent, received", f"{count['sent']}, {count['received']}")
            for topic, count in result["messages"].items()
        ),
        ("messages lost", str(result["messages_lost"])),
        ("ticks missed", f"{result['missed_ticks']} of {_ticks(result)}"),
    ]
    return aligned(rows)


def _mb(spread: dict[str, float]) -> str:
    return f"median {spread['median']:.0f}, max {spread['max']:.0f} MB" if spread else "unknown"


def _ticks(result: dict[str, Any]) -> int:
    sent: int = result["messages"].get("sense", {"sent": 0})["sent"]
    return sent


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.many_robots", __doc__)
    parser.add_argument("--robots", type=int, default=32)
    parser.add_argument("--factor", type=float, default=0.25, help="simulated per wall second")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="simulated")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--map", default=OFFICE, help="as in a scenario")
    arguments = parser.parse_args(argv)
    ensure_warm()
    scenario = Scenario(
        map=arguments.map,
        seed=arguments.seed,
        robots=tuple(RobotSpec(name=f"r{n + 1}") for n in range(arguments.robots)),
        starts="known",
        max_sim_s=arguments.seconds,
        pace=PaceConfig(mode="realtime", factor=arguments.factor, roster_s=ROSTER_S),
    )
    result = measure(scenario)
    print(table(result))
    write_figures(result, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
