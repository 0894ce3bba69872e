"""Gossip: robots in range send each other what the other lacks.

Every beacon carries the sender's version vector, so whoever hears it knows what to send. What
was sent is not sent again until the answer, a newer vector, has had time to come. Entries of
third robots travel too, unless the receiver gets them from their owner: then the owner sends them.
Of several who could pass them on, all in range of each other, the first by name does.
Loss, repetition and reordering can delay this but not corrupt it.
"""

from dataclasses import dataclass, field

from protocol.messages import RadioFrame
from robot.team.journal import EntryName, Journal, LogName, decode_record
from robot.team.parcels import ENTRIES, Named, cost_of, pack, unpack_entries, unpack_part

SPEAK_EVERY_TICKS = 20  # what comes in between shares a frame
IN_RANGE_TICKS = 45  # two beacons missed: out of range
RESEND_TICKS = 40  # a newer vector would have come by now
RELAY_TICKS = 80  # the owner had its chance
GREETING_TICKS = 25  # its first beacon was sent before it heard anybody


@dataclass(slots=True)
class Peer:
    """A robot that was heard: what it holds, whom it hears, and what it was sent when."""

    heard: int
    met: int
    """Since when it has been in range."""
    vector: dict[LogName, int] = field(default_factory=dict)
    hears: tuple[str, ...] = ()
    sent: dict[EntryName, int] = field(default_factory=dict)
    stuck: dict[LogName, int] = field(default_factory=dict)
    """Since when it has lacked the same next entry of a log that it could have from the owner."""
    pieces: dict[EntryName, dict[int, bytes]] = field(default_factory=dict)
    """Parts of long records that came from it."""


class Gossip:
    """The exchange of journals between one robot and those it hears."""

    def __init__(self, name: str, journal: Journal, bytes_per_tick: int) -> None:
        self._name = name
        self._journal = journal
        self._bytes_per_tick = bytes_per_tick
        self.peers: dict[str, Peer] = {}

    def in_range(self, tick: int) -> tuple[str, ...]:
        """Who was heard lately, in order of names."""
        return tuple(
            name for name in sorted(self.peers) if tick - self.peers[name].heard <= IN_RANGE_TICKS
        )

    def is_held(self, vector: dict[LogName, int], tick: int) -> bool:
        """Whether everybody in range was last heard to hold what that vector names."""
        heard = [self.peers[name].vector for name in self.in_range(tick)]
        return all(held.get(log, 0) >= count for held in heard for log, count in vector.items())

    def lacks(self, name: str) -> bool:
        """Whether a robot, by its last beacon, does not hold all that is held here."""
        vector = self.peers[name].vector
        return any(_lacks(vector, log, self._journal) for log in self._journal.logs())

    def hear_vector(
        self, tick: int, sender: str, vector: dict[LogName, int], hears: tuple[str, ...]
    ) -> None:
        """Take in what a beacon says of its sender."""
        peer = self.peers.setdefault(sender, Peer(tick, tick))
        if tick - peer.heard > IN_RANGE_TICKS:
            peer.met = tick
        lacking = [log for log in self._journal.logs() if _lacks(vector, log, self._journal)]
        peer.stuck = {
            log: peer.stuck.get(log, tick) if vector.get(log) == peer.vector.get(log) else tick
            for log in lacking
        }
        peer.heard, peer.hears, peer.vector = tick, hears, vector
        peer.sent = {
            name: when
            for name, when in peer.sent.items()
            if name.sequence >= vector.get(name.log, 0)
        }

    def hear_entries(self, sender: str, kind: str, payload: bytes) -> list[Named]:
        """The entries in a frame. Raises MalformedMessageError on one that is none of ours."""
        if kind == ENTRIES:
            return unpack_entries(payload)
        part = unpack_part(payload)
        peer = self.peers.get(sender)
        if peer is None:  # its beacon has not come yet; the part will come again
            return []
        pieces = peer.pieces.setdefault(part.name, {})
        pieces[part.number] = part.piece
        if any(number not in pieces for number in range(part.of)):
            return []
        del peer.pieces[part.name]
        return [decode_record(b"".join(pieces[number] for number in range(part.of)))]

    def speak(self, tick: int, spent_bytes: int = 0, at_once: bool = False) -> list[RadioFrame]:
        """Frames for everyone in range, within what the link carries in one tick.

        `spent_bytes` go to each of them this tick already. With `at_once` nothing waits for what
        could share a frame with it.
        """
        frames: list[RadioFrame] = []
        at_once = at_once or tick % SPEAK_EVERY_TICKS == 0
        for name in self.in_range(tick):
            chosen = self._choose(name, tick, self._bytes_per_tick - spent_bytes, at_once)
            frames += pack(name, chosen)
        return frames

    def _choose(self, receiver: str, tick: int, budget: int, at_once: bool) -> list[Named]:
        """What to send: own entries first, then those of others, oldest first in each log. What
        fills the link goes at once anyway."""
        peer = self.peers[receiver]
        wanted = [
            name
            for name in self._journal.beyond(peer.vector)
            if tick - peer.sent.get(name, -RESEND_TICKS) >= RESEND_TICKS
            if self._is_mine_to_send(receiver, name.log, tick)
        ]
        chosen: list[Named] = []
        for name in sorted(wanted, key=lambda name: name.log.robot != self._name):
            body = self._journal.body(name)
            budget -= cost_of(body)
            if budget < 0:
                break
            chosen.append((name, body))
        if not at_once and budget >= 0:
            return []
        peer.sent.update((name, tick) for name, _ in chosen)
        return chosen

    def _is_mine_to_send(self, receiver: str, log: LogName, tick: int) -> bool:
        """Whether it is this robot's log, or one that its owner does not seem to send. The owner
        itself lacks of it what it lost in a crash, not what its last beacon did not know yet."""
        peer = self.peers[receiver]
        if log.robot == self._name:
            return True
        if log.robot == receiver or log.robot in peer.hears or self._another_sends(receiver, log):
            return tick - peer.stuck.get(log, tick) >= RELAY_TICKS
        return tick - peer.met >= GREETING_TICKS

    def _another_sends(self, receiver: str, log: LogName) -> bool:
        """Whether a robot before this one in the alphabet is at it: it holds more of a log than the
        receiver, and by the last beacons of both they hear each other. What it does not hold itself
        it is told meanwhile."""
        peer = self.peers[receiver]
        return any(
            name < self._name
            and receiver in other.hears
            and other.vector.get(log, 0) > peer.vector.get(log, 0)
            for name, other in self.peers.items()
            if name in peer.hears
        )


def _lacks(vector: dict[LogName, int], log: LogName, journal: Journal) -> bool:
    return vector.get(log, 0) < journal.prefix(log)
