"""Compiling every kernel once, before a robot needs one in the middle of a run.

numba compiles a kernel when it is first called, which takes up to seconds, and keeps it in a
folder that is named by the content of all kernel files (`protocol.environment`). Short runs on
shipped maps call them with the very arguments of real runs.
"""

import hashlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from protocol.environment import kernel_files

POLL_S = 0.5


def ensure_warm() -> None:
    """Compile what was not compiled yet, with a line that says how far it is."""
    if is_warm():
        return
    print("compiling kernels (once, about half a minute)", flush=True)
    with _ended_by_interrupt(), _progress_shown():
        warm_up()
    print("  done                 ", flush=True)


def is_warm() -> bool:
    """Whether the kernels, as they are now and where they are now, were compiled before."""
    return _mark().exists()


def cache_folder() -> Path:
    return Path(os.environ["NUMBA_CACHE_DIR"])


def warm_up() -> None:
    """Call every kernel that a run needs, so that each is compiled and kept."""
    _call_kernels()
    cache_folder().mkdir(parents=True, exist_ok=True)
    _mark().touch()


@contextmanager
def _ended_by_interrupt() -> Iterator[None]:
    """A KeyboardInterrupt within numba comes out as errors of its own: let the signal end us."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _progress_shown() -> Iterator[None]:
    """Print how many kernels are in the cache whenever there are more, while the block runs."""
    total = sum(path.read_text(encoding="utf-8").count("\n@kernel") for path in kernel_files())
    end = "\r" if sys.stdout.isatty() else "\n"
    done = threading.Event()

    def tell() -> None:
        told = -1
        while not done.wait(POLL_S):
            compiled = min(_compiled(), total)
            if compiled != told:
                print(f"  {compiled} of {total} kernels", end=end, flush=True)
            told = compiled

    teller = threading.Thread(target=tell)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()


def _mark() -> Path:
    """numba compiles anew for a file elsewhere or with another time stamp, also if it is equal."""
    stamps = [(str(path), path.stat().st_mtime_ns) for path in kernel_files()]
    return cache_folder() / f"warm-{hashlib.sha256(repr(stamps).encode()).hexdigest()[:16]}"


def _compiled() -> int:
    return sum(1 for _ in cache_folder().rglob("*.nbi"))


def _call_kernels() -> None:
    """A team in small rooms that is told where it starts, and one that is not, one robot on a ring
    with loops to close and a given start, one in a known map, and a graph by itself."""
    from protocol.interrupt import Interrupt
    from station import graph_solution, known_maps
    from station.host_inline import play_inline
    from station.hosts import Unwatched
    from world.scenario import RobotSpec, Scenario
    from world.simulation import Simulation

    for starts in ("known", "unknown"):
        team = Simulation(Scenario(map="rooms-small", starts=starts, max_sim_s=20.0))
        play_inline(team, Unwatched(), Interrupt())
    start = Simulation(Scenario(map="loop", starts="known")).robot_config("r1").start
    alone = RobotSpec(name="r1", start=start)
    ring = Simulation(Scenario(map="loop", robots=(alone,), starts="known", max_sim_s=120.0))
    play_inline(ring, Unwatched(), Interrupt())
    known_maps.load_kernels()
    graph_solution.load_kernels()
