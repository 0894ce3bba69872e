"""A child process that never outlives the block that started it."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from station.memory_use import peak_rss_mb

END_S = 10.0  # to end by itself, once told
INTERRUPT_S = 3.0  # to end after SIGINT, before SIGKILL
TAIL_BYTES = 2000


class Child:
    """One process of ours, in a process group of its own: Ctrl-C reaches it through us alone."""

    def __init__(self, name: str, command: Sequence[str], log_path: Path) -> None:
        self.name = name
        self.log_path = log_path
        self.peak_rss_mb: float | None = None
        with log_path.open("wb") as log:
            self._process = _start(command, log)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while it runs, as `subprocess` has it otherwise: −9 after SIGKILL."""
        return self._process.poll()

    def sample_memory(self) -> None:
        """Remember the peak so far: after its death the system no longer says."""
        if self.exit_code is None:
            self.peak_rss_mb = peak_rss_mb(self.pid) or self.peak_rss_mb

    def log_tail(self) -> str:
        """The last lines of what it wrote."""
        data = self.log_path.read_bytes()[-TAIL_BYTES:]
        return data.decode("utf-8", "replace").strip()

    def interrupt(self) -> None:
        if self.exit_code is None:
            self._process.send_signal(signal.SIGINT)

    def kill(self) -> None:
        if self.exit_code is None:
            self._process.kill()
        self._process.wait()


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
        for child in family:
            child.interrupt()
        try:
            _await_exit(family, INTERRUPT_S)
        finally:
            for child in family:
                child.kill()


def _start(command: Sequence[str], log: IO[bytes]) -> subprocess.Popen[bytes]:
    root = str(Path(__file__).resolve().parent.parent)
    before = os.environ.get("PYTHONPATH")
    path = root + (os.pathsep + before if before else "")
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONPATH": path},
    )


def _await_exit(family: Sequence[Child], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while any(child.exit_code is None for child in family) and time.monotonic() < deadline:
        time.sleep(0.02)
