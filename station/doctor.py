"""What a run needs of the machine, checked one by one."""

import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from protocol.bus import open_bus
from protocol.bus_config import BusConfig
from protocol.errors import EarshotError
from protocol.topics import ROBOT_ALIVE
from station.free_port import free_port
from station.warm_up import cache_folder, is_warm

PACKAGES = ("eclipse-zenoh", "numba", "numpy", "opencv-python-headless", "pydantic", "scipy")
ROBOT_MB = 400
WORLD_MB = 400


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at; `advice` says what to do where it is not well."""

    subject: str
    well: bool
    detail: str
    advice: str = ""


def examine() -> Iterator[Finding]:
    """All findings, one after the other, as they are made."""
    yield _python()
    yield Finding("cores", _cores() >= 2, f"{_cores()} usable", "expect a slower run")
    yield from map(_package, PACKAGES)
    yield _cache()
    yield _kernels()
    yield _memory()
    yield _loopback()


def _python() -> Finding:
    well = sys.version_info >= (3, 11)
    return Finding("python", well, sys.version.split()[0], "install Python 3.11 or newer")


def _package(name: str) -> Finding:
    try:
        return Finding(name, True, version(name))
    except PackageNotFoundError:
        return Finding(name, False, "missing", "run deploy/run.sh, or: pip install -e .")


def _cache() -> Finding:
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        advice = "set XDG_CACHE_HOME to a folder that can be written to"
        return Finding("kernel cache", False, f"{folder}: {error.strerror}", advice)
    return Finding("kernel cache", True, str(folder))


def _kernels() -> Finding:
    return Finding(
        "kernels", is_warm(), "compiled" if is_warm() else "not compiled", "run: earshot warm-up"
    )


def _memory() -> Finding:
    available = _available_mb()
    if available is None:
        return Finding("memory", True, "this system does not say how much is free")
    robots = int((available - WORLD_MB) // ROBOT_MB)
    detail = f"{available:.0f} MB free: enough for about {max(0, robots)} robots"
    return Finding("memory", robots >= 3, detail, "close other programs, or run with fewer robots")


def _available_mb() -> float | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((int(n.split()[1]) / 1000 for n in lines if n.startswith("MemAvailable:")), None)


def _loopback() -> Finding:
    """A router and a client of it, and whether one sees the other."""
    subject, port = "zenoh on loopback", free_port()
    try:
        with (
            open_bus(BusConfig.loopback(port, listen=True)) as here,
            open_bus(BusConfig.loopback(port, listen=False)) as there,
        ):
            inbox = here.inbox()
            inbox.watch(ROBOT_ALIVE, "doctor")
            there.declare_alive(ROBOT_ALIVE, "doctor")
            met = inbox.get(5.0) is not None
    except EarshotError as error:
        return Finding(subject, False, str(error), "allow TCP on 127.0.0.1")
    detail = "two sessions met" if met else "two sessions did not meet in 5 s"
    return Finding(subject, met, detail, "allow TCP on 127.0.0.1")


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
