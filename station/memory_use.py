"""How much memory a process needed at most."""

import os
from pathlib import Path


def peak_rss_mb(pid: int | None = None) -> float | None:
    """Peak resident memory (MB = 10⁶ bytes) of a live process, by default this one's.

    None where the system does not say. `ru_maxrss` would not do: a child inherits the peak of
    the process that it was forked from.
    """
    try:
        status = Path(f"/proc/{pid or os.getpid()}/status").read_text(encoding="ascii")
    except OSError:
        return None
    for line in status.splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024 / 1e6
    return None
