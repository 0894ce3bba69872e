"""Packed submaps: how finished submaps are kept, for most are not looked at for a long time."""

from dataclasses import dataclass

import numpy as np

from protocol.pose import FloatArray
from robot.perception.field import ByteArray, CorrelationField
from robot.slam.submap import Submap

# Bytes of a run: fields are mostly empty, and what is empty is told apart by whole runs.
RUN = 8


@dataclass(frozen=True, slots=True)
class PackedGrid:
    """A mostly empty array of bytes, without its empty runs of 8 (the last one filled up).

    `marks` has a bit for every run, from the highest bit of its first byte on; `runs` are those
    that hold anything. General compression takes ten times as long, to half the size.
    """

    marks: bytes
    runs: bytes
    shape: tuple[int, int]

    @staticmethod
    def of(grid: ByteArray) -> "PackedGrid":
        flat, whole = grid.ravel(), grid.size // RUN * RUN
        rest = np.zeros(RUN if whole < grid.size else 0, dtype=np.uint8)
        rest[: grid.size - whole] = flat[whole:]
        parts = [part.view(np.uint64) for part in (flat[:whole], rest)]
        marks = [part != 0 for part in parts]
        held = [part[mark].tobytes() for part, mark in zip(parts, marks, strict=True)]
        rows, columns = grid.shape
        bits = np.packbits(np.concatenate(marks))
        return PackedGrid(bits.tobytes(), b"".join(held), (rows, columns))

    def unpack(self) -> ByteArray:
        """The array, to be written to like any other: kernels take no others."""
        size = self.shape[0] * self.shape[1]
        runs = np.zeros(-(-size // RUN), dtype=np.uint64)
        marks = np.unpackbits(np.frombuffer(self.marks, dtype=np.uint8), count=len(runs))
        runs[marks.view(np.bool_)] = np.frombuffer(self.runs, dtype=np.uint64)
        return runs.view(np.uint8)[:size].reshape(self.shape)


@dataclass(frozen=True, slots=True)
class PackedSubmap:
    """A finished submap with the grids of its field compressed. It never changes.

    `keyframes` (k×3) are the poses `T_anchor_keyframe` of every scan drawn.
    """

    index: int
    keyframes: FloatArray
    travel_m: float
    nodes: PackedGrid
    free: PackedGrid
    origin: FloatArray

    @staticmethod
    def of(submap: Submap) -> "PackedSubmap":
        field = submap.field
        return PackedSubmap(
            submap.index,
            np.array(submap.keyframes),
            submap.travel_m,
            PackedGrid.of(field.nodes),
            PackedGrid.of(field.free),
            field.origin,
        )

    @property
    def way(self) -> FloatArray:
        """Where its scans were taken (k×2, m, anchor's frame)."""
        return self.keyframes[:, :2]

    def unpack(self) -> Submap:
        """The submap as it was when it was finished, to the last bit."""
        field = CorrelationField(self.nodes.unpack(), self.free.unpack(), self.origin)
        return Submap(self.index, field, list(self.keyframes), self.travel_m, True)
