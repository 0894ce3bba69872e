"""The robot processes of a run: started, and started again when they were killed."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from protocol.messages import Report
from station.child import Child
from station.forks import Forks, Spawns
from station.hosts import Relay
from station.observer import Observer
from world.simulation import Simulation


class Crew:
    """Starts robots, each life of one with a log of its own; `family` holds them all."""

    def __init__(
        self,
        starter: Forks | Spawns,
        family: list[Child],
        folder: Path,
        arguments: Mapping[str, Sequence[str]],
    ) -> None:
        """`arguments` of the command `earshot`, by robot."""
        self.family = family
        self._starter = starter
        self._folder = folder
        self._arguments = arguments

    def start(self, name: str, *more: str) -> None:
        """Start a life of a robot, with more arguments."""
        earlier = sum(child.name == name for child in self.family)
        log = self._folder / (f"{name}.{earlier}.log" if earlier else f"{name}.log")
        self.family.append(self._starter.start(name, [*self._arguments[name], *more], log))

    def was_killed(self, name: str) -> bool:
        """Whether the last life of a robot ended by a signal. One that ended by an error of its own
        would do so again."""
        last = next(child for child in reversed(self.family) if child.name == name)
        code = last.exit_code
        return code is not None and code < 0


class Restarted(Relay):
    """Starts a robot again, with the memory of its journal, when the world has given it up."""

    def __init__(self, observer: Observer, crew: Crew) -> None:
        super().__init__(observer)
        self._crew = crew

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        super().ticked(simulation, reports)
        for name in simulation.names:
            if name not in simulation.alive and self._crew.was_killed(name):
                self._crew.start(name, "--resume")
