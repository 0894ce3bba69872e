"""A map to keep: the submaps of a robot and the pose graph that holds them, as bytes and back.

The format (docs/map-format.md) is msgpack without any code in it: a stranger's file can be wrong,
but not run anything. What is read is checked before it is used.
"""

import dataclasses
import hashlib
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
import numpy.typing as npt

from protocol.errors import EarshotError
from protocol.pose import FloatArray
from robot.slam.engine import Engine, GraphSnapshot
from robot.slam.packed_submap import PackedGrid, PackedSubmap

FORMAT, VERSION = "earshot-map", 1
LEVEL = 1  # of compression: fields are mostly empty, and more takes long for little
MAX_ROWS = 1 << 24  # of nodes, edges and keyframes
MAX_SIDE = 1 << 14  # nodes of a grid: 400 m


class SavedMapError(EarshotError):
    """Bytes that are no saved map; the message says what is wrong with them."""


@dataclass(frozen=True, slots=True)
class SavedMap:
    """A pose graph over anchors, and submaps whose anchors are among its nodes."""

    graph: GraphSnapshot
    submaps: tuple[PackedSubmap, ...]

    @staticmethod
    def of(engine: Engine, anchors: FloatArray | None = None) -> "SavedMap":
        """All that an engine has mapped so far, or that with its anchors elsewhere (m×3, all of
        them)."""
        graph = engine.graph()
        if anchors is not None:
            graph = dataclasses.replace(graph, nodes=anchors)
        return SavedMap(graph, engine.mapped())

    @staticmethod
    def joined(maps: Sequence["SavedMap"]) -> "SavedMap":
        """One map of several that share a frame, one after the other; no edge ties them."""
        offsets = np.cumsum([0, *(len(one.graph.nodes) for one in maps)]).tolist()
        parts = list(zip(maps, offsets, strict=False))
        graph = GraphSnapshot(
            np.concatenate([one.graph.nodes for one in maps]),
            np.concatenate([one.graph.edge_nodes + np.int32(offset) for one, offset in parts]),
            np.concatenate([one.graph.measurements for one in maps]),
            np.concatenate([one.graph.information for one in maps]),
        )
        submaps = tuple(
            dataclasses.replace(submap, index=submap.index + offset)
            for one, offset in parts
            for submap in one.submaps
        )
        return SavedMap(graph, submaps)

    def digest(self) -> str:
        """A hash of the content: equal for equal maps, however their grids were compressed."""
        total = hashlib.sha256()
        graph = self.graph
        for values in (graph.nodes, graph.edge_nodes, graph.measurements, graph.information):
            total.update(_packed(values, _DTYPES[values.dtype.kind]))
        for submap in self.submaps:
            total.update(np.array([submap.index, submap.travel_m], dtype="<f8").tobytes())
            total.update(_packed(submap.keyframes, "<f8") + _packed(submap.origin, "<f8"))
            for grid in (submap.nodes, submap.free):
                total.update(np.array(grid.shape, dtype="<i8").tobytes())
                total.update(grid.unpack().tobytes())
        return total.hexdigest()

    def encode(self) -> bytes:
        """The bytes of the file."""
        graph = self.graph
        packed: bytes = msgpack.packb(
            {
                "format": FORMAT,
                "version": VERSION,
                "nodes": _packed(graph.nodes, "<f8"),
                "edge_nodes": _packed(graph.edge_nodes, "<i4"),
                "measurements": _packed(graph.measurements, "<f8"),
                "information": _packed(graph.information, "<f8"),
                "submaps": [_fields(submap) for submap in self.submaps],
            },
            use_bin_type=True,
        )
        return packed

    @staticmethod
    def decode(data: bytes) -> "SavedMap":
        """The map in a file's bytes. Raises SavedMapError on anything that `encode` does not
        write."""
        try:
            fields = msgpack.unpackb(data, raw=False, max_ext_len=0)
        except Exception as error:  # msgpack raises many types, all of which mean the same here
            raise SavedMapError(f"no saved map: {str(error)[:100]}") from error
        if not isinstance(fields, dict) or fields.get("format") != FORMAT:
            raise SavedMapError(f"no saved map: the field format is not {FORMAT!r}")
        if fields.get("version") != VERSION:
            raise SavedMapError(
                f"a saved map of version {fields.get('version')}; this is for version {VERSION}"
            )
        try:
            graph = GraphSnapshot(
                _read(fields["nodes"], "<f8", (3,)),
                _read(fields["edge_nodes"], "<i4", (2,)),
                _read(fields["measurements"], "<f8", (3,)),
                _read(fields["information"], "<f8", (3, 3)),
            )
            submaps = tuple(_read_submap(one) for one in _list(fields["submaps"]))
            _check(graph, submaps)
        except (KeyError, TypeError, ValueError, zlib.error) as error:
            raise SavedMapError(f"a damaged map: {str(error)[:100]}") from error
        return SavedMap(graph, submaps)


_DTYPES = {"f": "<f8", "i": "<i4"}


def _packed(values: npt.NDArray[Any], dtype: str) -> bytes:
    return np.ascontiguousarray(values, dtype=dtype).tobytes()


def _fields(submap: PackedSubmap) -> dict[str, Any]:
    return {
        "index": submap.index,
        "travel_m": submap.travel_m,
        "keyframes": _packed(submap.keyframes, "<f8"),
        "origin": _packed(submap.origin, "<f8"),
        "walls": _grid(submap.nodes),
        "free": _grid(submap.free),
    }


def _grid(grid: PackedGrid) -> list[Any]:
    return [*grid.shape, zlib.compress(grid.unpack().tobytes(), LEVEL)]


def _read_submap(fields: Any) -> PackedSubmap:
    if not isinstance(fields, dict):
        raise ValueError("a submap is no map of fields")
    index, travel = fields["index"], float(fields["travel_m"])
    if type(index) is not int or index < 0 or not 0.0 <= travel < math.inf:
        raise ValueError("a submap's index or travel is out of bounds")
    origin = _read(fields["origin"], "<f8", ())
    if origin.shape != (2,):
        raise ValueError("an origin is not x, y")
    keyframes = _read(fields["keyframes"], "<f8", (3,))
    if len(keyframes) == 0:
        raise ValueError("a submap without keyframes")
    return PackedSubmap(
        index, keyframes, travel, _read_grid(fields["walls"]), _read_grid(fields["free"]), origin
    )


def _read_grid(fields: Any) -> PackedGrid:
    rows, columns, data = _list(fields)
    for side in (rows, columns):
        if type(side) is not int or not 2 <= side <= MAX_SIDE:
            raise ValueError(f"a grid of {rows} × {columns}")
    inflate = zlib.decompressobj()
    values = inflate.decompress(data, rows * columns + 1)
    if len(values) != rows * columns or not inflate.eof:
        raise ValueError(f"a grid that does not hold {rows} × {columns} bytes")
    return PackedGrid.of(np.frombuffer(values, dtype=np.uint8).reshape(rows, columns))


def _read(data: Any, dtype: str, row: tuple[int, ...]) -> npt.NDArray[Any]:
    """Rows of finite numbers, to be written to like any other array."""
    if not isinstance(data, bytes):
        raise ValueError("expected bytes")
    values = np.frombuffer(data, dtype=dtype).astype(dtype[1:]).reshape(-1, *row)
    if len(values) > MAX_ROWS or not np.isfinite(values).all():
        raise ValueError("numbers that are not finite, or too many")
    return values


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError("expected a list")
    return value


def _check(graph: GraphSnapshot, submaps: tuple[PackedSubmap, ...]) -> None:
    edges = len(graph.edge_nodes)
    if len(graph.measurements) != edges or len(graph.information) != edges:
        raise ValueError("edges, measurements and information differ in number")
    nodes = len(graph.nodes)
    if edges and not (graph.edge_nodes.min() >= 0 and graph.edge_nodes.max() < nodes):
        raise ValueError("an edge to a node that is not there")
    if any(submap.index >= nodes for submap in submaps):
        raise ValueError("a submap without its anchor among the nodes")
