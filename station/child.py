"""Child processes that never outlive the block that started them."""

import os
import signal
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from station.memory_use import MemorySample, memory_sample, peak_rss_mb

END_S = 10.0  # to end by itself, once told
INTERRUPT_S = 3.0  # to end after SIGINT, before SIGKILL
TAIL_BYTES = 2000


class Child(ABC):
    """One process of ours, in a session of its own: Ctrl-C reaches it through us alone."""

    def __init__(self, name: str, log_path: Path) -> None:
        self.name = name
        self.log_path = log_path
        self.peak_rss_mb: float | None = None
        self.memory: list[MemorySample] = []

    @property
    @abstractmethod
    def pid(self) -> int: ...

    @property
    @abstractmethod
    def exit_code(self) -> int | None:
        """None while it runs, as `subprocess` has it otherwise: −9 after SIGKILL."""

    @abstractmethod
    def send(self, number: signal.Signals) -> None:
        """Send a signal; nothing happens if it has just ended."""

    def note_peak(self) -> None:
        """Remember the peak so far: after its death the system no longer says."""
        if self.exit_code is None:
            self.peak_rss_mb = peak_rss_mb(self.pid) or self.peak_rss_mb

    def sample_memory(self, stamp: float) -> None:
        """Add to its course of memory."""
        sample = memory_sample(stamp, self.pid) if self.exit_code is None else None
        if sample is not None:
            self.memory.append(sample)

    def log_tail(self) -> str:
        """The last lines of what it wrote."""
        data = self.log_path.read_bytes()[-TAIL_BYTES:]
        return data.decode("utf-8", "replace").strip()


class Spawned(Child):
    """A program that is started anew."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        log_path: Path,
        *,
        descriptors: tuple[int, ...] = (),
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """`descriptors` stay open in it; `environment` is added to ours."""
        super().__init__(name, log_path)
        root = str(Path(__file__).resolve().parent.parent)
        before = os.environ.get("PYTHONPATH")
        path = root + (os.pathsep + before if before else "")
        with log_path.open("wb") as log:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                pass_fds=descriptors,
                env={
                    **os.environ,
                    **(environment or {}),
                    "PYTHONUNBUFFERED": "1",
                    "PYTHONPATH": path,
                },
            )

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        return self._process.poll()

    def send(self, number: signal.Signals) -> None:
        self._process.send_signal(number)


@contextmanager
def children() -> Iterator[list[Child]]:
    """A list for children; whatever happens in the block, none of them is left at its end.

    After an orderly block they have some seconds to end by themselves, after an error none.
    """
    family: list[Child] = []
    try:
        yield family
        _await_exit(family, END_S)
    finally:
        _send_all(family, signal.SIGINT)
        try:
            _await_exit(family, INTERRUPT_S)
        finally:
            _send_all(family, signal.SIGKILL)
            _await_exit(family, END_S)


def _send_all(family: Sequence[Child], number: signal.Signals) -> None:
    for child in family:
        if child.exit_code is None:
            child.send(number)


def _await_exit(family: Sequence[Child], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while any(child.exit_code is None for child in family) and time.monotonic() < deadline:
        time.sleep(0.02)
