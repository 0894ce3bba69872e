"""Robots as threads on one in-memory Zenoh session: the whole protocol without a network."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from protocol.bus import Bus, open_bus
from protocol.bus_config import BusConfig
from protocol.errors import EarshotError
from protocol.interrupt import Interrupt
from robot.brain import Brain
from robot.process import MindMaker, run_robot
from station.hosts import LaunchError, Played, played
from station.observer import Observer
from world.process import WorldProcess
from world.simulation import Simulation

log = logging.getLogger(__name__)

JOIN_S = 30.0


def play_in_memory(
    simulation: Simulation,
    observer: Observer,
    interrupt: Interrupt,
    make_mind: MindMaker = Brain,
) -> Played:
    """Play a run to its end. Raises LaunchError if a robot's thread does not end."""
    with open_bus(BusConfig.memory()) as bus:
        world = WorldProcess(simulation, bus, observer, interrupt)
        with _robot_threads(bus, simulation.names, make_mind):
            world.run()
    return played(world)


@contextmanager
def _robot_threads(bus: Bus, names: tuple[str, ...], make_mind: MindMaker) -> Iterator[None]:
    stop = Interrupt()
    threads = [
        threading.Thread(target=_be_robot, args=(bus, name, make_mind, stop), name=name)
        for name in names
    ]
    for thread in threads:
        thread.start()
    try:
        yield
    except BaseException:
        stop.request()
        raise
    finally:
        for thread in threads:
            thread.join(JOIN_S)
        stop.request()
        for thread in threads:
            thread.join(JOIN_S)
        stuck = [thread.name for thread in threads if thread.is_alive()]
        if stuck:
            raise LaunchError(f"the threads of {', '.join(stuck)} did not end")


def _be_robot(bus: Bus, name: str, make_mind: MindMaker, stop: Interrupt) -> None:
    try:
        run_robot(bus, name, make_mind, stop)
    except EarshotError as error:
        log.error("%s: %s", name, error)
    except Exception:
        # The world sees the robot's token go, as it would see a process die.
        log.exception("%s died", name)
