"""What one loop listens to: typed events, in the order in which they came.

Zenoh calls back in threads of its own. Nothing is done there but to put what came into the inbox
of the loop that owns it; decoding, counting and answering happen in that loop. What one session
puts is received in the order of put, across keys: a loop that reads one inbox sees the radio
frames before the message that counts them.
"""

import logging
import queue
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import zenoh

from protocol.allowance import Allowance
from protocol.codec import decode, encode, encoding_of
from protocol.errors import MalformedMessageError
from protocol.model import Message
from protocol.topics import Style, Topic

log = logging.getLogger(__name__)

# Beside each published message: a number that only rises within one sender.
SEQUENCE = struct.Struct("<Q")


@dataclass(frozen=True, slots=True)
class Arrival:
    """A message on a topic, or the answer to a question asked on it."""

    topic: Topic
    robot: str
    message: Message


@dataclass(frozen=True, slots=True)
class Question:
    """Someone asks for what a topic offers: answer once, with `reply`."""

    topic: Topic
    robot: str
    _query: zenoh.Query

    def reply(self, message: Message) -> None:
        with self._query as query:
            query.reply(
                self.topic.key_for(self.robot),
                encode(message),
                encoding=encoding_of(type(message)),
                express=True,
            )

    def pass_over(self) -> None:
        """Give no answer, so that who asks need not wait for one."""
        with self._query:
            pass


@dataclass(frozen=True, slots=True)
class Presence:
    """The owner of a topic appeared (`alive`) or is gone."""

    topic: Topic
    robot: str
    alive: bool


@dataclass(frozen=True, slots=True)
class Flood:
    """A robot used up its allowance: more of it is dropped unread until the next refill, and had
    better be muted."""

    robot: str


Event = Arrival | Question | Presence | Flood


def _accept(message: Message) -> None:
    """Take any message that fits its schema."""
    del message


class _Limited:
    """A subscription or queryable that can be closed and opened again."""

    def __init__(self, declare: Callable[..., Any], key: str, handler: Any) -> None:
        self._declare = declare
        self._key = key
        self._handler = handler
        self._entity: Any = None
        self.open()

    def open(self) -> None:
        if self._entity is None:
            self._entity = self._declare(self._key, self._handler)

    def close(self) -> None:
        if self._entity is not None:
            self._entity.undeclare()
            self._entity = None


class Inbox:
    """All that one loop listens to, in the order of arrival. Read it from one thread alone."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._queue: queue.SimpleQueue[tuple[Topic, str, Any] | None] = queue.SimpleQueue()
        self._entities: list[Any] = []
        self._limited: dict[str, list[_Limited]] = {}
        self.malformed: Counter[tuple[str, str]] = Counter()
        """Messages that were dropped, by topic and kind of defect."""
        self.received: Counter[tuple[str, str]] = Counter()
        """Published messages that came and were taken, by topic and robot."""
        self._sequences: dict[tuple[str, str], int] = {}
        self._checks: dict[tuple[str, str], Callable[[Any], None]] = {}

    def subscribe(
        self,
        topic: Topic,
        robot: str = "",
        allowance: Allowance | None = None,
        check: Callable[[Any], None] | None = None,
    ) -> None:
        """Receive the messages of a topic, with an allowance no more than it grants.

        `check` raises MalformedMessageError for what fits the schema, but not this receiver.
        """
        if check is not None:
            self._checks[topic.name, robot] = check
        self._declare(self._session.declare_subscriber, topic, robot, allowance)

    def serve(self, topic: Topic, robot: str = "", allowance: Allowance | None = None) -> None:
        """Receive the questions on a topic; each must be answered."""
        self._declare(self._session.declare_queryable, topic, robot, allowance)

    def watch(self, topic: Topic, robot: str = "") -> None:
        """Receive the presence of a topic's owner, also if it is there already."""
        key, handler = topic.key_for(robot), self._handler(topic, robot)
        liveliness = self._session.liveliness()
        self._entities.append(liveliness.declare_subscriber(key, handler, history=True))

    def mute(self, robot: str) -> None:
        """Take no more of what comes from a robot under an allowance: the router keeps it."""
        for limited in self._limited.get(robot, ()):
            limited.close()

    def unmute(self, robot: str) -> None:
        """Listen again after `mute`."""
        for limited in self._limited.get(robot, ()):
            limited.open()

    def ask(
        self, topic: Topic, robot: str = "", timeout_s: float = 10.0, *, wake_at_end: bool = False
    ) -> None:
        """Ask without waiting: the answer, if there is one, arrives like any message.

        With `wake_at_end` a None follows when no (further) answer will come.
        """
        handler = self._handler(topic, robot, at_end=self.wake if wake_at_end else None)
        self._session.get(topic.key_for(robot), handler, timeout=timeout_s, express=True)

    def wake(self) -> None:
        """Make a waiting `get` return None; may be called anywhere, also by a signal handler."""
        self._queue.put(None)

    def get(self, timeout_s: float) -> Event | None:
        """The next event, or None after the timeout. Malformed messages are passed over."""
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                item = self._queue.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                return None
            if item is None:
                return None
            event = self._read(*item)
            if event is not None:
                return event

    def drain(self) -> Iterator[Event]:
        """What has arrived already, without waiting."""
        while not self._queue.empty():
            event = self.get(0.0)
            if event is not None:
                yield event

    def _declare(
        self, declare: Callable[..., Any], topic: Topic, robot: str, allowance: Allowance | None
    ) -> None:
        key, handler = topic.key_for(robot), self._handler(topic, robot, allowance=allowance)
        if allowance is None:
            self._entities.append(declare(key, handler))
        else:
            self._limited.setdefault(robot, []).append(_Limited(declare, key, handler))

    def _handler(
        self,
        topic: Topic,
        robot: str,
        *,
        allowance: Allowance | None = None,
        at_end: Callable[[], None] | None = None,
    ) -> Any:
        put = self._queue.put

        def receive(item: Any) -> None:
            if allowance is None or allowance.take(len(item.payload or b"")):
                put((topic, robot, item))
            elif allowance.turned_empty():
                put((topic, robot, Flood(robot)))

        # Directly in Zenoh's receiving thread: a thread per callback would lose the order.
        return zenoh.handlers.Callback(receive, at_end, indirect=False)

    def _read(self, topic: Topic, robot: str, item: Any) -> Event | None:
        if isinstance(item, Flood):
            return item
        if isinstance(item, zenoh.Query):
            return Question(topic, robot, item)
        sample = item.ok if isinstance(item, zenoh.Reply) else item
        if sample is None:
            return None
        if topic.schema is None:
            return Presence(topic, robot, sample.kind == zenoh.SampleKind.PUT)
        try:
            message = decode(topic.schema, sample.payload.to_bytes(), str(sample.encoding))
            if topic.style is Style.PUBLISH:
                self._check_sequence(topic, robot, sample.attachment)
                self._checks.get((topic.name, robot), _accept)(message)
                self.received[topic.name, robot] += 1
        except MalformedMessageError as error:
            self._drop(topic, robot, error)
            return None
        return Arrival(topic, robot, message)

    def _check_sequence(self, topic: Topic, robot: str, attachment: zenoh.ZBytes | None) -> None:
        """Refuse what was heard before, or is older than what was."""
        data = b"" if attachment is None else attachment.to_bytes()
        if len(data) != SEQUENCE.size:
            raise MalformedMessageError("sequence", "its sequence number is missing")
        (number,) = SEQUENCE.unpack(data)
        if number <= self._sequences.get((topic.name, robot), -1):
            raise MalformedMessageError("replay", "it is a repetition of an earlier message")
        self._sequences[topic.name, robot] = number

    def _drop(self, topic: Topic, robot: str, error: MalformedMessageError) -> None:
        self.malformed[topic.name, error.kind] += 1
        if self.malformed[topic.name, error.kind] == 1:
            log.warning("%s of %s: %s; dropped and counted", topic.name, robot or "world", error)
