"""Packed submaps: how finished submaps are kept, for most are not looked at for a long time."""

import zlib
from dataclasses import dataclass

import numpy as np

from protocol.pose import FloatArray
from robot.perception.field import ByteArray, CorrelationField
from robot.perception.search import Blocks
from robot.slam.submap import Submap

# The least effort: fields are mostly empty, and more takes a control step's time for little.
LEVEL = 1


@dataclass(frozen=True, slots=True)
class PackedGrid:
    """An array of bytes, compressed without loss."""

    data: bytes
    shape: tuple[int, ...]

    @staticmethod
    def of(grid: ByteArray) -> "PackedGrid":
        return PackedGrid(zlib.compress(grid.tobytes(), LEVEL), grid.shape)

    def unpack(self) -> ByteArray:
        """The array, to be written to like any other: kernels take no others."""
        data = bytearray(zlib.decompress(self.data))
        return np.frombuffer(data, dtype=np.uint8).reshape(self.shape)


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
        return Submap(
            self.index, field, list(self.keyframes), self.travel_m, True, Blocks.of(field)
        )
