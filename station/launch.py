"""A run in one call, hosted in one of three ways that give identical results.

`processes`: the world here, each robot in a process of its own, Zenoh on the loopback.
`memory`: robots as threads on one in-memory Zenoh session. `inline`: no Zenoh at all.
"""

from pathlib import Path

from maps.grid import OccupancyGrid
from protocol.bus import open_bus
from protocol.bus_config import BusConfig
from protocol.interrupt import interrupts
from station.hosts import Mode, Played, Timed, Unwatched, played
from station.memory_use import peak_rss_mb
from station.observer import Observer, RunOutcome
from world.process import INTERRUPTED, WorldProcess
from world.scenario import Scenario
from world.simulation import Simulation


def launch(
    scenario: Scenario,
    mode: Mode = "processes",
    observer: Observer | None = None,
    *,
    folder: Path | None = None,
    grid: OccupancyGrid | None = None,
    restart: bool = False,
) -> RunOutcome:
    """Play a scenario to its end and return what is left of it.

    `folder` is where robot processes write their logs and journals; without one they go with the
    run. `grid` takes the place of the scenario's map. With `restart`, robot processes that are
    killed are started again and go on from their journals. SIGINT and SIGTERM end the run in an
    orderly way; a second one raises KeyboardInterrupt, and also then nothing is left running.
    """
    simulation = Simulation(scenario, grid)
    timed = Timed(observer or Unwatched())
    with interrupts() as interrupt:
        if mode == "inline":
            from station.host_inline import play_inline

            result = play_inline(simulation, timed, interrupt)
        elif mode == "memory":
            from station.host_memory import play_in_memory

            result = play_in_memory(simulation, timed, interrupt)
        else:
            from station.host_processes import play_processes

            result = play_processes(simulation, timed, interrupt, folder, restart)
    outcome = _outcome(simulation, timed.wall_s, mode, result)
    timed.ended(outcome)
    return outcome


def host_world(scenario: Scenario, config: BusConfig, observer: Observer) -> RunOutcome:
    """Be the world alone, for robots that others start. Raises RosterError if they do not come."""
    simulation = Simulation(scenario)
    timed = Timed(observer)
    with interrupts() as interrupt, open_bus(config) as bus:
        world = WorldProcess(simulation, bus, timed, interrupt)
        world.run()
    outcome = _outcome(simulation, timed.wall_s, "world", played(world))
    timed.ended(outcome)
    return outcome


def _outcome(simulation: Simulation, wall_s: float, mode: str, robots: Played) -> RunOutcome:
    return RunOutcome(
        simulation=simulation,
        exit_reason=simulation.exit_reason or INTERRUPTED,
        wall_s=wall_s,
        mode=mode,
        robots=robots.robots,
        world_peak_rss_mb=peak_rss_mb() or 0.0,
        reports=robots.reports,
    )
