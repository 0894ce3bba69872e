"""One robot that patrols for hours: do its graph and its memory end with the building?

    python -m studies.lifelong --hours 2 --json lifelong.json

Inline, as fast as it goes. Told every ten simulated minutes: the nodes of the pose graph (one for
each submap) and its edges, entries of the journal, the memory of the process once what is free was
given back, and errors against the truth: of the whole trajectory so far as optimised now, and
online over the last ten minutes. The process holds the world too, and both keep every step: by
about 100 bytes each of the robot's, 50 of the world's.
"""

import ctypes
import gc
import sys
import time
from collections.abc import Iterator
from typing import Any

from protocol.errors import EarshotError
from protocol.model import Model
from robot.brain import Brain
from station.memory_use import MemorySample, memory_sample
from station.warm_up import ensure_warm
from studies.command import aligned, one_line_errors, study_parser, write_figures
from world.accuracy import align, distances, match, rmse
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

SAMPLE_EVERY_S = 600.0


class Sample(Model):
    """What a robot has become at a simulated time (s)."""

    stamp: float
    driven_m: float
    nodes: int
    edges: int
    loop_closures: int
    journal_entries: int
    rss_mb: float | None
    error_m: float
    """RMSE of the whole trajectory so far, as optimised now."""
    online_m: float
    """RMSE of the last ten minutes, as estimated at each tick."""
    pace: float
    """Simulated over wall time since the sample before."""


def patrol(scenario: Scenario) -> Iterator[Sample]:
    """Play the one robot of a scenario to its end; a sample every `SAMPLE_EVERY_S`."""
    simulation = Simulation(scenario)
    (name,) = simulation.names
    mind = Brain(simulation.robot_config(name))
    every = round(SAMPLE_EVERY_S / scenario.tick_s)
    began = time.monotonic()
    senses = simulation.step({})
    while not simulation.done:
        action = mind.step(senses[name])
        mind.take_records()
        if simulation.tick and simulation.tick % every == 0:
            yield _sample(simulation, mind, time.monotonic() - began)
            began = time.monotonic()
        senses = simulation.step({name: action})


def _sample(simulation: Simulation, mind: Brain, wall_s: float) -> Sample:
    memory = _settled_memory(simulation.stamp)
    reply, report = mind.trajectory_reply(), mind.report()
    track = match(reply, simulation.history.poses[:, 0])
    assert track is not None
    T_world_map = align(track.final, track.true)
    recent = -round(SAMPLE_EVERY_S / simulation.scenario.tick_s)
    error = rmse([distances(T_world_map, track.final, track.true)])
    online = rmse([distances(T_world_map, track.online[recent:], track.true[recent:])])
    assert error is not None and online is not None
    return Sample(
        stamp=simulation.stamp,
        driven_m=simulation.history.driven_m(0),
        nodes=len(reply.nodes),
        edges=len(reply.edge_nodes),
        loop_closures=report.loop_closures,
        journal_entries=report.journal_entries,
        rss_mb=memory.rss_mb if memory else None,
        error_m=error,
        online_m=online,
        pace=SAMPLE_EVERY_S / wall_s,
    )


def _settled_memory(stamp: float) -> MemorySample | None:
    """What a process needs, without what is only kept for later."""
    gc.collect()
    if sys.platform == "linux":
        ctypes.CDLL(None).malloc_trim(0)
    return memory_sample(stamp)


def summary(samples: list[Sample]) -> dict[str, Any]:
    """The figures of a study: the first sample beside the last one."""
    first, last = samples[0], samples[-1]
    return {
        "hours": last.stamp / 3600.0,
        "driven_m": last.driven_m,
        "nodes": [first.nodes, last.nodes],
        "journal_entries": [first.journal_entries, last.journal_entries],
        "error_m": [first.error_m, last.error_m],
        "online_m": [first.online_m, last.online_m],
        "rss_mb": [first.rss_mb, last.rss_mb],
        "samples": [sample.model_dump() for sample in samples],
    }


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.lifelong", __doc__)
    parser.add_argument("--hours", type=float, default=2.0, metavar="H", help="simulated")
    parser.add_argument("--map", default="office")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    ensure_warm()
    scenario = Scenario(
        map=arguments.map,
        seed=arguments.seed,
        robots=(RobotSpec(name="r1", policy="patrol"),),
        starts="known",
        # A little more, so that the last sample is of the full time.
        max_sim_s=3600.0 * arguments.hours + 1.0,
    )
    samples: list[Sample] = []
    for sample in patrol(scenario):
        samples.append(sample)
        print(_line(sample), flush=True)
    if not samples:
        raise EarshotError(f"nothing to tell of less than {SAMPLE_EVERY_S:g} s")
    figures = summary(samples)
    rows = [
        (label, f"{figures[name][0]:.4g} → {figures[name][1]:.4g}")
        for name, label in (
            ("nodes", "nodes, first sample → last"),
            ("journal_entries", "journal entries"),
            ("error_m", "error of all so far (m)"),
            ("online_m", "online error of the last 10 min (m)"),
        )
    ]
    print(aligned(rows))
    write_figures(figures, arguments.json)
    return 0


def _line(sample: Sample) -> str:
    rss = f"{sample.rss_mb:.0f} MB" if sample.rss_mb is not None else "-"
    return (
        f"  {sample.stamp / 60.0:4.0f} min: {sample.driven_m:5.0f} m, {sample.nodes} nodes, "
        f"{sample.edges} edges, {sample.journal_entries} entries, RSS {rss}, "
        f"error {sample.error_m:.4f} m, "
        f"online {sample.online_m:.4f} m, pace {sample.pace:.1f}"
    )


if __name__ == "__main__":
    sys.exit(main())
