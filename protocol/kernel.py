"""The one decorator with which hot loops are compiled.

One place, because identical hashes on both sides of the wire need identical compilation:
no `fastmath`, no `parallel`, errors as numpy treats them, the GIL released so that a job can
run beside the control step. Kernels live in modules named `kernels.py` that hold nothing else.
"""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function with numba on first use and keep it on disk."""
    return cast(
        Callable[P, R],
        numba.njit(cache=True, nogil=True, error_model="numpy")(function),
    )


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a helper that only other kernels call (not cached: it is part of its callers)."""
    return cast(Callable[P, R], numba.njit(nogil=True, error_model="numpy")(function))
