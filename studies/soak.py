"""A team that patrols for long: does it keep its pace, and does its memory stay where it is?

    python -m studies.soak --minutes 20 --robots 4 --json soak.json

Robots in processes, in lockstep as fast as it goes, with the policy `patrol`, which goes round
the building again and again once it is explored. Told each simulated minute: the pace (simulated
over wall time) and the memory of the world. Growth of memory is from the fifth minute to the end;
the pace at the end is that of the last tenth of the run, held against the first tenth.
"""

import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from station.hosts import Unwatched
from station.launch import launch
from station.memory_use import MemorySample, memory_sample
from station.observer import RunOutcome
from station.warm_up import ensure_warm
from studies.command import aligned, one_line_errors, study_parser, write_figures
from world.scenario import PaceConfig, RobotSpec, Scenario
from world.simulation import Simulation

SETTLED_S = 300.0
SAMPLE_EVERY_S = 10.0  # simulated
MINUTE_S = 60.0


@dataclass(frozen=True, slots=True)
class Course:
    """Wall times (s) at simulated times (s), and the world's memory."""

    stamps: list[float]
    walls: list[float]
    memory: list[MemorySample]

    def pace(self, start: float, end: float) -> float:
        """Simulated over wall time between two simulated times."""
        walls = np.interp([start, end], self.stamps, self.walls)
        return (end - start) / float(walls[1] - walls[0])


class Watch(Unwatched):
    """Looks at clock and memory every few simulated seconds."""

    def __init__(self) -> None:
        self.course = Course([0.0], [time.monotonic()], [])

    def started(self, simulation: Simulation) -> None:
        del simulation
        self.course.walls[0] = time.monotonic()

    def ticked(self, simulation: Simulation, reports: Any) -> None:
        course, stamp = self.course, simulation.stamp
        if stamp < course.stamps[-1] + SAMPLE_EVERY_S:
            return
        course.stamps.append(stamp)
        course.walls.append(time.monotonic())
        sample = memory_sample(stamp)
        if sample is not None:
            course.memory.append(sample)
        if stamp % MINUTE_S < SAMPLE_EVERY_S and stamp >= MINUTE_S:
            entries = max((report.journal_entries for report in reports.values()), default=0)
            pace = course.pace(stamp - MINUTE_S, stamp)
            rss_mb = course.memory[-1].rss_mb if course.memory else float("nan")
            print(
                f"  minute {stamp / MINUTE_S:3.0f}: pace {pace:5.2f}, world {rss_mb:.0f} MB, "
                f"{entries} journal entries",
                flush=True,
            )


def measure(scenario: Scenario) -> dict[str, Any]:
    """Play a scenario in processes, and say how pace and memory went."""
    watch = Watch()
    outcome = launch(scenario, "processes", watch)
    course, end = watch.course, outcome.simulation.stamp
    part = end / 10.0
    first, last = course.pace(0.0, part), course.pace(end - part, end)
    memory = {"world": course.memory, **{n: list(r.memory) for n, r in outcome.robots.items()}}
    return {
        "sim_s": end,
        "wall_s": outcome.wall_s,
        "exit_reason": outcome.exit_reason,
        "notes": {name: robot.note for name, robot in outcome.robots.items() if robot.note},
        "pace_first": first,
        "pace_last": last,
        "pace_ratio": last / first,
        "growth": {name: growth(samples) for name, samples in memory.items()},
        "journal_entries": _journal(outcome),
        "pace": [
            [stamp, course.pace(stamp - MINUTE_S, stamp)] for stamp in np.arange(60.0, end, 60.0)
        ],
        "memory": {
            name: [[s.stamp, s.rss_mb, s.pss_mb] for s in samples]
            for name, samples in memory.items()
        },
    }


def growth(samples: list[MemorySample]) -> float | None:
    """How much greater the RSS is at the end than when the team had settled; None where the run
    was too short. Either is the median of a minute's samples: planners need memory in bursts."""
    if not samples or samples[-1].stamp < SETTLED_S + 2.0 * MINUTE_S:
        return None
    end = samples[-1].stamp
    settled = [s.rss_mb for s in samples if abs(s.stamp - SETTLED_S) <= MINUTE_S]
    final = [s.rss_mb for s in samples if s.stamp >= end - 2.0 * MINUTE_S]
    if not settled:
        return None
    return float(np.median(final) / np.median(settled)) - 1.0


def _journal(outcome: RunOutcome) -> list[list[float]]:
    """Simulated times (s) and the greatest number of entries that a robot held, each minute."""
    tick_s = outcome.simulation.scenario.tick_s
    most: dict[int, int] = {}
    for log in outcome.reports.values():
        for tick, entries in zip(log.ticks.tolist(), log.journal_entries.tolist(), strict=True):
            minute = int(tick * tick_s // MINUTE_S)
            most[minute] = max(most.get(minute, 0), entries)
    return [[minute * MINUTE_S, most[minute]] for minute in sorted(most)]


def table(result: dict[str, Any]) -> str:
    rows = [
        ("simulated", f"{result['sim_s']:.0f} s in {result['wall_s']:.0f} s"),
        ("pace of the first tenth", f"{result['pace_first']:.2f} × real time"),
        ("pace of the last tenth", f"{result['pace_last']:.2f} × real time"),
        ("last over first", f"{result['pace_ratio']:.2f}"),
        *(
            (f"growth of {name} after 5 minutes", "-" if g is None else f"{100.0 * g:+.1f} %")
            for name, g in result["growth"].items()
        ),
    ]
    return aligned(rows)


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.soak", __doc__)
    parser.add_argument("--minutes", type=float, default=20.0, metavar="M", help="simulated")
    parser.add_argument("--robots", type=int, default=4)
    parser.add_argument("--map", default="office")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    ensure_warm()
    names = [f"r{n + 1}" for n in range(arguments.robots)]
    scenario = Scenario(
        map=arguments.map,
        seed=arguments.seed,
        robots=tuple(RobotSpec(name=name, policy="patrol") for name in names),
        starts="known",
        max_sim_s=60.0 * arguments.minutes,
        pace=PaceConfig(deadline_s=60.0),
    )
    result = measure(scenario)
    print(table(result))
    write_figures(result, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
