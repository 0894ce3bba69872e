"""Compiling every kernel once, before a robot needs one in the middle of a run.

numba compiles a kernel when it is first called, which takes up to seconds, and keeps it in a
folder that is named by the content of all kernel files (`protocol.environment`). Short runs on
shipped maps call them with the very arguments of real runs.
"""

import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from protocol.environment import kernel_files

DONE_MARK = "warmed-up"
POLL_S = 0.5

Progress = Callable[[int, int], None]


def ensure_warm() -> None:
    """Compile what was not compiled yet, with a line that says how far it is."""
    if is_warm():
        return
    print("compiling kernels (once, about half a minute)", flush=True)
    warm_up(_show)
    print("  done", flush=True)


def _show(compiled: int, total: int) -> None:
    end = "\r" if sys.stdout.isatty() else "\n"
    print(f"  {compiled} of {total} kernels", end=end, flush=True)


def is_warm() -> bool:
    """Whether the kernels, as they are now, were compiled before."""
    return (cache_folder() / DONE_MARK).exists()


def cache_folder() -> Path:
    return Path(os.environ["NUMBA_CACHE_DIR"])


def warm_up(progress: Progress) -> None:
    """Compile what a run needs; `progress` hears now and then how many of how many are done."""
    total = sum(path.read_text(encoding="utf-8").count("\n@kernel") for path in kernel_files())
    done = threading.Event()

    def tell() -> None:
        told = -1
        while not done.wait(POLL_S):
            compiled = _compiled()
            if compiled != told:
                progress(compiled, total)
            told = compiled

    teller = threading.Thread(target=tell)
    teller.start()
    try:
        _call_kernels()
    finally:
        done.set()
        teller.join()
    progress(_compiled(), total)
    cache_folder().mkdir(parents=True, exist_ok=True)
    (cache_folder() / DONE_MARK).touch()


def _compiled() -> int:
    return sum(1 for _ in cache_folder().rglob("*.nbi"))


def _call_kernels() -> None:
    """A team in small rooms, and one robot on a ring with loops to close and a given start."""
    from protocol.interrupt import Interrupt
    from station.host_inline import play_inline
    from station.hosts import Unwatched
    from world.scenario import RobotSpec, Scenario
    from world.simulation import Simulation

    team = Simulation(Scenario(map="rooms-small", max_sim_s=20.0))
    play_inline(team, Unwatched(), Interrupt())
    start = Simulation(Scenario(map="loop")).robot_config("r1").start
    alone = RobotSpec(name="r1", start=start)
    ring = Simulation(Scenario(map="loop", robots=(alone,), max_sim_s=120.0))
    play_inline(ring, Unwatched(), Interrupt())
