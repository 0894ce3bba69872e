"""Robots as forks of one server (`station.fork_server`), seen from who asks for them."""

import json
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from protocol.errors import EarshotError
from station.child import Child, Spawned, children

READY_S = 60.0  # to import and rehearse, on a machine that has other things to do
MAX_MESSAGE_BYTES = 1 << 12
# By default glibc gives each thread a heap of its own, and Zenoh has eight threads; and it learns
# to keep large blocks, which planners need for a moment, instead of giving them back.
HEAP = {"MALLOC_ARENA_MAX": "1", "MALLOC_MMAP_THRESHOLD_": str(256 * 1024)}


class ForkError(EarshotError):
    """The fork server ended, or does not answer."""


class Forks:
    """The channel to the server: asks for robots, hears of their ends."""

    def __init__(self, server: Spawned, channel: socket.socket) -> None:
        self._server = server
        self._channel = channel
        self._started: int | None = None
        self._codes: dict[int, int] = {}
        self._open = True

    def start(self, name: str, arguments: Sequence[str], log_path: Path) -> Child:
        """Fork a process that runs `earshot` with these arguments. Raises ForkError."""
        request = {"name": name, "arguments": list(arguments), "log": str(log_path)}
        try:
            self._channel.send(json.dumps(request).encode())
        except OSError:
            raise self._error("ended") from None
        deadline = time.monotonic() + READY_S
        while self._started is None:
            if not self._hear(deadline - time.monotonic()):
                raise self._error(f"gave no answer in {READY_S:g} s" if self._open else "ended")
        pid, self._started = self._started, None
        return Forked(name, log_path, pid, self)

    def exit_code(self, pid: int) -> int | None:
        """How a process of this server ended; None while it runs. None outlives the server."""
        while pid not in self._codes and self._hear(0.0):
            pass
        return self._codes.get(pid) if self._open else self._codes.get(pid, -signal.SIGKILL)

    def _hear(self, seconds: float) -> bool:
        """Take a message in, waiting for it so long; False where there is none."""
        if not self._open or not select.select([self._channel], [], [], max(0.0, seconds))[0]:
            return False
        try:
            data = self._channel.recv(MAX_MESSAGE_BYTES)
        except OSError:
            data = b""
        if not data:
            self._open = False
            return False
        message = json.loads(data)
        if "started" in message:
            self._started = message["started"]
        else:
            self._codes[message["ended"]] = message["code"]
        return True

    def _error(self, what: str) -> ForkError:
        said = self._server.log_tail() or "it said nothing"
        return ForkError(f"the process that robots are forked from {what}: {said}")


class Spawns:
    """Robots as programs that are started anew, where there is no fork server."""

    def start(self, name: str, arguments: Sequence[str], log_path: Path) -> Child:
        return Spawned(name, [sys.executable, "-m", "station.main", *arguments], log_path)


class Forked(Child):
    """A robot that the server forked, and reaps."""

    def __init__(self, name: str, log_path: Path, pid: int, forks: Forks) -> None:
        super().__init__(name, log_path)
        self._pid = pid
        self._forks = forks

    @property
    def pid(self) -> int:
        return self._pid

    @property
    def exit_code(self) -> int | None:
        return self._forks.exit_code(self._pid)

    def send(self, number: signal.Signals) -> None:
        try:
            os.kill(self._pid, number)
        except ProcessLookupError:  # it has ended; the news is on its way
            return


@contextmanager
def fork_server(folder: Path) -> Iterator[Forks]:
    """A server for the time of a `with` block; what it says goes to a file in the folder."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with children() as family, ours:
        with theirs:
            command = [sys.executable, "-m", "station.fork_server", str(theirs.fileno())]
            server = Spawned(
                "fork-server",
                command,
                folder / "fork-server.log",
                descriptors=(theirs.fileno(),),
                environment=HEAP,
            )
            family.append(server)
        yield Forks(server, ours)


def forked_robots(pid: int) -> dict[str, int]:
    """The process numbers of the live robots that a process has had forked, by name (Linux)."""
    family = list(_processes())
    servers = {number for number, parent, _ in family if parent == pid}
    return {
        name.removeprefix("robot "): number
        for number, parent, name in family
        if parent in servers and name.startswith("robot ")
    }


def _processes() -> Iterator[tuple[int, int, str]]:
    """Number, parent's number and name of every process."""
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                head, _, tail = (folder / "stat").read_text().rpartition(")")
            except OSError:
                continue
            state, parent = tail.split()[:2]
            if state != "Z":
                yield int(folder.name), int(parent), head.partition("(")[2]


@contextmanager
def robot_starter(folder: Path) -> Iterator[Forks | Spawns]:
    """The quickest way to start robots here: the server asks Linux for what others do not have."""
    if sys.platform == "linux":
        with fork_server(folder) as forks:
            yield forks
    else:
        yield Spawns()
