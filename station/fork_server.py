"""The process from which robots are forked: it has imported and loaded what they all need.

    python -m station.fork_server DESCRIPTOR

A robot that is started by itself imports for a second, loads compiled kernels for another, and
keeps about 100 MB of its own for both. Forked from here it begins at once, and shares those pages
with all others until it writes to them. It is a process like any other: with its own session on
the bus, its own journal and its own death.

The server opens no session and starts no thread, so that a fork is a whole copy. It is asked over
a socket (`station.forks`) and tells who ended and how; its robots do not outlive it.
"""

import ctypes
import gc
import json
import os
import selectors
import signal
import socket
import sys
import time
from contextlib import suppress

from protocol.interrupt import Interrupt
from station.host_inline import play_inline
from station.hosts import Unwatched
from station.main import main
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

MAX_REQUEST_BYTES = 1 << 16
REHEARSED_S = 3.0
FAREWELL_S = 10.0  # for robots to see that their world is gone, when who asked for them is
PR_SET_PDEATHSIG, PR_SET_NAME = 1, 15  # <linux/prctl.h>


class ForkServer:
    """Forks on request, and reaps."""

    def __init__(self, channel: socket.socket) -> None:
        self._channel = channel
        self._selector = selectors.DefaultSelector()
        self._selector.register(channel, selectors.EVENT_READ)
        self._robots: dict[int, int] = {}  # process numbers by descriptor

    def serve(self) -> list[str] | None:
        """Until the asking side hangs up. In the server that is None; in each robot that is forked
        meanwhile this returns too: the arguments of the command that it is to run."""
        while True:
            for key, _ in self._selector.select():
                if key.fd in self._robots:
                    self._reap(key.fd)
                    continue
                request = self._channel.recv(MAX_REQUEST_BYTES)
                if not request:
                    self._await_robots()
                    return None
                arguments = self._fork(**json.loads(request))
                if arguments is not None:
                    return arguments

    def _fork(self, name: str, arguments: list[str], log: str) -> list[str] | None:
        server = os.getpid()
        pid = os.fork()
        if pid == 0:
            self._selector.close()
            self._channel.close()
            _settle(name, log, server)
            return arguments
        descriptor = os.pidfd_open(pid)
        self._robots[descriptor] = pid
        self._selector.register(descriptor, selectors.EVENT_READ)
        self._tell({"started": pid})
        return None

    def _reap(self, descriptor: int) -> None:
        pid = self._robots.pop(descriptor)
        self._selector.unregister(descriptor)
        os.close(descriptor)
        _, status = os.waitpid(pid, 0)
        self._tell({"ended": pid, "code": os.waitstatus_to_exitcode(status)})

    def _tell(self, message: dict[str, int]) -> None:
        with suppress(OSError):  # where who asked is gone, `serve` is about to see it
            self._channel.send(json.dumps(message).encode())

    def _await_robots(self) -> None:
        self._selector.unregister(self._channel)
        deadline = time.monotonic() + FAREWELL_S
        while self._robots and (left := deadline - time.monotonic()) > 0.0:
            for key, _ in self._selector.select(left):
                self._reap(key.fd)


def _settle(name: str, log: str, server: int) -> None:
    """Be a process of its own, but one that ends with the server."""
    os.setsid()
    system = ctypes.CDLL(None)
    system.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != server:  # which ended before it could have taken us along
        os.kill(os.getpid(), signal.SIGKILL)
    system.prctl(PR_SET_NAME, f"robot {name}".encode())  # the first 15 bytes, as ps and top show
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    os.close(descriptor)


def rehearse() -> None:
    """Play a short run, so that kernels are loaded and all that is made once is made."""
    robots = (RobotSpec(name="r1"), RobotSpec(name="r2"))
    simulation = Simulation(Scenario(map="rooms-small", robots=robots, max_sim_s=REHEARSED_S))
    play_inline(simulation, Unwatched(), Interrupt())


def share() -> None:
    """Leave as little as may be that a robot would write to only by being there."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    gc.freeze()


if __name__ == "__main__":
    with socket.socket(fileno=int(sys.argv[1])) as asked:
        rehearse()
        share()
        robot = ForkServer(asked).serve()
    sys.exit(0 if robot is None else main(robot))
