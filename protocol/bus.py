"""The bus: typed messages over Zenoh, opened in one of four ways.

Zenoh calls back in threads of its own. Nothing is done there but to put what came into the
inbox of the loop that owns it; decoding, counting and answering happen in that loop. What one
session puts is received in the order of put, across keys: a loop that reads one inbox sees the
radio frames before the message that counts them.
"""

import itertools
import logging
import queue
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import zenoh

from protocol.allowance import Allowance
from protocol.bus_config import BusConfig
from protocol.codec import decode, encode, encoding_of
from protocol.errors import EarshotError, MalformedMessageError
from protocol.model import Message
from protocol.topics import Style, Topic

log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)


class BusError(EarshotError):
    """The network could not be opened; the message names the endpoints."""


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

SEQUENCE = struct.Struct("<Q")


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

    def subscribe(self, topic: Topic, robot: str = "", allowance: Allowance | None = None) -> None:
        """Receive the messages of a topic, with an allowance no more than it grants."""
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


class Bus:
    """One Zenoh session; made by `open_bus` alone, which also closes it."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self._publishers: dict[str, zenoh.Publisher] = {}
        self.sent: Counter[tuple[str, str]] = Counter()
        """Messages published so far, by topic and robot."""
        # From the time on, so that a process that is started again goes on above where it was.
        self._sequence = itertools.count(time.time_ns())
        self._order = threading.Lock()

    def inbox(self) -> Inbox:
        """An empty inbox; subscribe it to what its loop needs."""
        return Inbox(self._session)

    def publish(self, topic: Topic, message: Message, robot: str = "") -> None:
        """Send a message on a topic."""
        publisher, payload = self._publisher(topic, robot), encode(message)
        with self._order:  # numbers must leave in their order, also from two threads
            publisher.put(payload, attachment=SEQUENCE.pack(next(self._sequence)))
            self.sent[topic.name, robot] += 1

    def is_heard(self, topic: Topic, robot: str = "") -> bool:
        """Whether anyone listens to a topic now."""
        status: Any = self._publisher(topic, robot).matching_status
        return bool(status.matching)

    def declare_alive(self, topic: Topic, robot: str = "") -> None:
        """Announce presence until the bus is closed, the process ends or the link is lost."""
        key = topic.key_for(robot)
        self._tokens[key] = self._session.liveliness().declare_token(key)

    def withdraw(self, topic: Topic, robot: str = "") -> None:
        """Take an announced presence back."""
        token = self._tokens.pop(topic.key_for(robot), None)
        if token is not None:
            token.undeclare()  # type: ignore[no-untyped-call]  # zenoh leaves the result open

    def query(
        self, topic: Topic, schema: type[M], robot: str = "", timeout_s: float = 5.0
    ) -> M | None:
        """Ask on a topic and wait for the first answer; None if there is none in time."""
        inbox = self.inbox()
        inbox.ask(topic, robot, timeout_s, wake_at_end=True)
        event = inbox.get(timeout_s)
        if isinstance(event, Arrival) and isinstance(event.message, schema):
            return event.message
        return None

    def _publisher(self, topic: Topic, robot: str) -> zenoh.Publisher:
        key = topic.key_for(robot)
        publisher = self._publishers.get(key)
        if publisher is None:
            if topic.schema is None:
                raise ValueError(f"topic {topic.name} carries no messages")
            control = zenoh.CongestionControl
            publisher = self._session.declare_publisher(
                key,
                encoding=encoding_of(topic.schema),
                congestion_control=control.BLOCK if topic.reliable else control.DROP,
                express=True,
            )
            self._publishers[key] = publisher
        return publisher


@contextmanager
def open_bus(config: BusConfig) -> Iterator[Bus]:
    """Open a session for the time of a `with` block.

    Only so: a session that is left open with a subscriber keeps the interpreter from ending.
    Raises BusError when an endpoint cannot be bound or reached in time.
    """
    try:
        session = zenoh.open(config.to_zenoh())
    except zenoh.ZError as error:
        hint = config.refusal_hint()
        raise BusError(f"{config.summary()}: {error}{hint}") from error
    with session:
        yield Bus(session)
