"""Who takes part in a run: the links to all robots, and whom the world still waits for."""

from protocol.allowance import Allowance
from protocol.errors import EarshotError
from protocol.messages import Action
from world.robot_link import RobotLink

# What an honest robot can say in a tick, with room to spare: its action, a report, an answer, and
# to each teammate as many frames as its link carries when they are not even half full.
BASE_MESSAGES = 8
SMALL_FRAME_BYTES = 500


class RosterError(EarshotError):
    """Not every robot arrived in time."""


class Roster:
    """The links to all robots, in the scenario's order. It is `closed` from tick 0 on: who leaves
    later is lost until it comes back in a new life. Who was not there by then may still come."""

    def __init__(self, names: tuple[str, ...], link_bytes_per_tick: int) -> None:
        """`link_bytes_per_tick` is what the radio carries between two robots in one tick."""
        frames = (len(names) - 1) * (2 + link_bytes_per_tick // SMALL_FRAME_BYTES)
        self.links = {name: RobotLink(name, Allowance(BASE_MESSAGES + frames)) for name in names}
        self.closed = False

    @property
    def missing(self) -> list[str]:
        """Who has not come."""
        return [name for name, link in self.links.items() if not link.present]

    @property
    def alive(self) -> list[RobotLink]:
        return [link for link in self.links.values() if link.alive]

    @property
    def awaited(self) -> list[RobotLink]:
        """Whom a tick in lockstep waits for; when all are stalled, for the first to answer."""
        owing = [link for link in self.alive if link.owes]
        prompt = [link for link in owing if not link.stalled]
        return prompt or (owing if len(owing) == len(self.alive) else [])

    def take_actions(self) -> dict[str, Action]:
        """What the robots answered since the last call: the end of a tick, so all may speak
        again."""
        for link in self.links.values():
            link.allowance.refill()
        actions = {link.name: link.take_action() for link in self.alive}
        return {name: action for name, action in actions.items() if action is not None}

    def check_complete(self, seconds: float) -> None:
        """Raise RosterError, naming who did not come in so many seconds of wall time."""
        if self.missing:
            raise RosterError(
                f"{', '.join(self.missing)} did not arrive within {seconds:g} s: start each with "
                "`earshot robot NAME --connect ENDPOINT`, or run with fewer"
            )
