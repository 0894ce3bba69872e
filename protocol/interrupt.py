"""Ending on request: SIGINT and SIGTERM become a wish that a loop looks at between two steps.

A KeyboardInterrupt in the middle of a step would leave half a step behind, and a Zenoh session
that is not closed keeps the interpreter from ending. The second signal insists: it raises.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """A wish to end, set by a signal or by another thread.

    `on_request` are called in the signal handler: they may only do what is safe there, such as
    `queue.SimpleQueue.put`.
    """

    def __init__(self) -> None:
        self.requested = False
        self.on_request: list[Callable[[], None]] = []

    def request(self) -> None:
        self.requested = True
        for call in tuple(self.on_request):
            call()


@contextmanager
def interrupts() -> Iterator[Interrupt]:
    """Catch SIGINT and SIGTERM while the block runs; outside the main thread nothing is caught."""
    interrupt = Interrupt()
    if threading.current_thread() is not threading.main_thread():
        yield interrupt
        return

    def handle(number: int, frame: FrameType | None) -> None:
        del number, frame
        if interrupt.requested:
            raise KeyboardInterrupt
        interrupt.request()

    before = {number: signal.signal(number, handle) for number in SIGNALS}
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
