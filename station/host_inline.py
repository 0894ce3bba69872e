"""Robots as plain objects in one thread: no bus, no processes, the quickest way to many runs."""

import time

from protocol.interrupt import Interrupt
from protocol.messages import Report
from robot.brain import Brain
from robot.process import Mind, ReportClock
from station.hosts import Played
from station.observer import Observer, RobotOutcome
from world.process import INTERRUPTED, MAP_EVERY_S, MAP_PAUSE_S
from world.report_log import ReportLog
from world.simulation import Simulation


def play_inline(simulation: Simulation, observer: Observer, interrupt: Interrupt) -> Played:
    """Play a run to its end."""
    minds: dict[str, Mind] = {
        name: Brain(simulation.robot_config(name)) for name in simulation.names
    }
    clocks = {name: ReportClock() for name in minds}
    reports = {name: ReportLog() for name in minds}
    latest: dict[str, Report] = {}
    maps = _MapRounds()
    observer.started(simulation)
    senses = simulation.step({})
    while not simulation.done:
        actions = {}
        for name, sense in senses.items():
            mind = minds[name]
            actions[name] = mind.step(sense)
            mind.take_records()
            if clocks[name].due(sense.stamp, actions[name].finished):
                latest[name] = mind.report()
                reports[name].append(latest[name])
        if interrupt.requested:
            simulation.end(INTERRUPTED)
        senses = simulation.step(actions)
        observer.ticked(simulation, latest)
        if maps.due(simulation.stamp):
            for name, mind in minds.items():
                observer.mapped(name, mind.map_reply())
    return Played({name: _last_words(mind) for name, mind in minds.items()}, reports)


def _last_words(mind: Mind) -> RobotOutcome:
    return RobotOutcome(mind.map_reply(exact=True), mind.trajectory_reply(), peak_rss_mb=None)


class _MapRounds:
    """When the observer is shown maps: as often as over the bus."""

    def __init__(self) -> None:
        self._stamp = 0.0
        self._wall = 0.0

    def due(self, stamp: float) -> bool:
        wall = time.monotonic()
        if stamp < self._stamp + MAP_EVERY_S or wall < self._wall + MAP_PAUSE_S:
            return False
        self._stamp, self._wall = stamp, wall
        return True
