"""The bus: typed messages over Zenoh, opened in one of four ways; `protocol.inbox` is its ear."""

import itertools
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import zenoh

from protocol.bus_config import BusConfig
from protocol.codec import encode, encoding_of
from protocol.errors import EarshotError
from protocol.inbox import SEQUENCE, Arrival, Inbox
from protocol.model import Message
from protocol.topics import Topic

M = TypeVar("M", bound=Message)


class BusError(EarshotError):
    """The network could not be opened; the message names the endpoints."""


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
