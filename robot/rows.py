"""Rows of numbers that are only ever added to."""

from typing import Any

import numpy as np
import numpy.typing as npt

FIRST_CAPACITY = 64


class Rows:
    """An array (n×columns) that doubles when it is full.

    A number in it takes its eight bytes, where one in a list takes four times that; and arrays are
    made out of it at once. What is not filled yet takes no memory: the system gives pages out as
    they are written to.
    """

    def __init__(self, columns: int, dtype: npt.DTypeLike = np.float64) -> None:
        self._values: npt.NDArray[Any] = np.empty((FIRST_CAPACITY, columns), dtype=dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def values(self) -> npt.NDArray[Any]:
        """All rows (n×columns), not to be written to."""
        return self._values[: self._count]

    def append(self, *row: float) -> None:
        if self._count == len(self._values):
            grown = np.empty((2 * self._count, self._values.shape[1]), dtype=self._values.dtype)
            grown[: self._count] = self._values
            self._values = grown
        self._values[self._count] = row
        self._count += 1

    def snapshot(self) -> "Rows":
        """The rows that there are now. They never change, so they are shared."""
        copy = Rows.__new__(Rows)
        copy._values, copy._count = self._values, self._count
        return copy
