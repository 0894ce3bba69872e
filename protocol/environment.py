"""The process environment on which identical results on every side of the wire depend."""

import hashlib
import os
import tempfile
from pathlib import Path

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMBA_NUM_THREADS",
)
PACKAGES = ("maps", "protocol", "robot", "world")


def prepare_environment() -> None:
    """Set one BLAS thread and the kernel cache; must run before numpy and numba are imported.

    A sum that is split over threads is rounded differently on another machine, so threads are
    fixed at one however the process was started.
    """
    for variable in THREAD_VARIABLES:
        os.environ[variable] = "1"
    os.environ.setdefault("NUMBA_CACHE_DIR", str(kernel_cache()))


def kernel_files() -> list[Path]:
    """Every file that holds compiled kernels, in a fixed order."""
    root = Path(__file__).resolve().parent.parent
    files = [path for package in PACKAGES for path in (root / package).rglob("*kernels.py")]
    return sorted(files)


def kernel_cache() -> Path:
    """The folder for compiled kernels, named by the content of all kernel files.

    numba looks only at the file of the kernel that is called: one that calls a kernel of
    another file stays stale when that one changes. A new folder for new content cannot.
    """
    digest = hashlib.sha256()
    for path in kernel_files():
        digest.update(path.read_bytes())
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "earshot"
    if not _is_writable(base):
        base = Path(tempfile.gettempdir()) / f"earshot-{os.getuid()}"
    return base / f"kernels-{digest.hexdigest()[:16]}"


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
