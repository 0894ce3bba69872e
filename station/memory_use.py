"""How much memory processes need: at most, and over the time of a run."""

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class MemorySample:
    """Memory of a process (MB = 10⁶ bytes) at a simulated time (s).

    `rss_mb` is what of it is in memory; `pss_mb` is its share of that, where a page that n
    processes have in common counts one nth to each.
    """

    stamp: float
    rss_mb: float
    pss_mb: float


def peak_rss_mb(pid: int | None = None) -> float | None:
    """Peak resident memory (MB = 10⁶ bytes) of a live process, by default this one's.

    None where the system does not say. `ru_maxrss` would not do: a child inherits the peak of
    the process that it was forked from.
    """
    return _read_mb(pid, "status").get("VmHWM")


def memory_sample(stamp: float, pid: int | None = None) -> MemorySample | None:
    """The present memory of a live process; None where the system does not say. Takes 2 ms."""
    use = _read_mb(pid, "smaps_rollup")
    if "Rss" not in use or "Pss" not in use:
        return None
    return MemorySample(stamp, use["Rss"], use["Pss"])


def _read_mb(pid: int | None, name: str) -> dict[str, float]:
    """The lines of a file of /proc that are sizes."""
    try:
        text = (Path("/proc") / str(pid or os.getpid()) / name).read_text(encoding="ascii")
    except OSError:
        return {}
    words = [line.split() for line in text.splitlines()]
    return {w[0].rstrip(":"): int(w[1]) * 1024 / 1e6 for w in words if w[2:] == ["kB"]}
