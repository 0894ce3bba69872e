"""Files that other tools read: TUM trajectories and g2o pose graphs.

TUM: one line per pose, `stamp tx ty tz qx qy qz qw` (seconds, metres, unit quaternion), as the
RGB-D benchmark of Sturm et al. (2012) defined it; evo and most SLAM tools read it. g2o: lines
`VERTEX_SE2 id x y θ` and `EDGE_SE2 i j dx dy dθ I11 I12 I13 I22 I23 I33`, the edge being the pose
of j in the frame of i with the upper triangle of its information matrix (Kümmerle et al., 2011).
Lines that start with # are comments in both.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from maps.pixels import write_whole
from protocol.errors import EarshotError
from protocol.pose import FloatArray, wrap_angles
from robot.slam import chain_kernels
from robot.slam.normal_equations import floats, integers

TUM_FIELDS = "stamp tx ty tz qx qy qz qw"
VERTEX_FIELDS = "VERTEX_SE2 id x y theta"
EDGE_FIELDS = "EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33"
# An EDGE2 of TORO (Grisetti et al., 2007) ends in I11 I12 I22 I33 I13 I23.
TORO_ORDER = (0, 1, 2, 3, 4, 7, 5, 8, 6)
# A quaternion as text is rounded; one that is farther off was not meant as a unit quaternion.
QUATERNION_TOLERANCE = 1e-3


class FormatError(EarshotError):
    """A file that is not what its format promises: names the file, the line and what it expects."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses over time: `stamps` (n) in seconds, `poses` n×3 (x, y, θ) in metres and radians."""

    stamps: FloatArray
    poses: FloatArray


@dataclass(frozen=True, slots=True)
class PoseGraph:
    """`nodes` m×3; `edge_nodes` k×2 are rows of `nodes`; `edge_values` k×9: the measured
    (x, y, θ) of the second node in the frame of the first, and I11 I12 I13 I22 I23 I33."""

    nodes: FloatArray
    edge_nodes: npt.NDArray[np.int32]
    edge_values: FloatArray


def write_text(path: Path, text: str) -> None:
    """Write a file as a whole or not at all: a reader never sees half of it."""
    write_whole(path, text.encode())


def write_tum(trajectory: Trajectory, path: Path) -> None:
    """Write a planar trajectory, with z = 0 and a rotation about z alone."""
    lines = [f"# {TUM_FIELDS}\n"]
    for stamp, (x, y, theta) in zip(trajectory.stamps, trajectory.poses, strict=True):
        qz, qw = math.sin(0.5 * theta), math.cos(0.5 * theta)
        lines.append(f"{stamp:.6f} {x:.9f} {y:.9f} 0 0 0 {qz:.12f} {qw:.12f}\n")
    write_text(path, "".join(lines))


def read_tum(path: Path) -> Trajectory:
    """Read a planar trajectory.

    Raises FormatError on a line without eight finite numbers, on stamps that do not increase, and
    on a quaternion that is no unit quaternion or turns about another axis than z.
    """
    rows: list[list[float]] = []
    for number, words in _lines(path):
        if len(words) != 8:
            raise _malformed(path, number, f"{len(words)} fields", TUM_FIELDS)
        row = _numbers(path, number, words, TUM_FIELDS)
        qx, qy, qz, qw = row[4:]
        if abs(math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw) - 1.0) > QUATERNION_TOLERANCE:
            raise _malformed(path, number, "no unit quaternion", TUM_FIELDS)
        if math.hypot(qx, qy) > QUATERNION_TOLERANCE:
            raise _malformed(path, number, "a rotation that is not about z", TUM_FIELDS)
        if rows and row[0] <= rows[-1][0]:
            raise _malformed(path, number, "a stamp not after the one before it", TUM_FIELDS)
        rows.append(row)
    table = np.array(rows, dtype=np.float64).reshape(-1, 8)
    theta = wrap_angles(2.0 * np.arctan2(table[:, 6], table[:, 7]))
    return Trajectory(table[:, 0].copy(), np.stack([table[:, 1], table[:, 2], theta], axis=-1))


def write_g2o(graph: PoseGraph, path: Path) -> None:
    """Write a pose graph; nodes are named by their row, and row 0 is held fixed."""
    lines = [
        f"VERTEX_SE2 {index} {x:.9f} {y:.9f} {theta:.12f}\n"
        for index, (x, y, theta) in enumerate(graph.nodes)
    ]
    if len(graph.nodes):
        lines.append("FIX 0\n")
    for (i, j), values in zip(graph.edge_nodes, graph.edge_values, strict=True):
        dx, dy, dtheta = values[:3]
        information = " ".join(f"{value:.12g}" for value in values[3:])
        lines.append(f"EDGE_SE2 {i} {j} {dx:.9f} {dy:.9f} {dtheta:.12f} {information}\n")
    write_text(path, "".join(lines))


def read_g2o(path: Path) -> PoseGraph:
    """Read a planar pose graph. Node ids may be any integers; rows keep their order in the file.

    The older VERTEX2 and EDGE2 lines of TORO are read too; its EQUIV lines say nothing more.

    A file may have edges alone: then its nodes, in the order of their ids, stand where the edges
    put them, each by the first edge that ties it to one that stands (`chained`).

    Raises FormatError on an unknown kind of line, a wrong number of fields, a number that is none,
    a node given twice, an edge to a node that the file does not have, and, in a file of edges
    alone, a node that they do not tie to the first one.
    """
    nodes: list[list[float]] = []
    row_of: dict[int, int] = {}
    edges: list[tuple[int, int, int]] = []  # line number and node ids
    values: list[list[float]] = []
    for number, words in _lines(path):
        match words[0]:
            case "VERTEX_SE2" | "VERTEX2":
                if len(words) != 5:
                    raise _malformed(path, number, f"{len(words)} fields", VERTEX_FIELDS)
                index = _integer(path, number, words[1], VERTEX_FIELDS)
                if index in row_of:
                    raise _malformed(path, number, f"node {index} for the second time", "once")
                row_of[index] = len(nodes)
                nodes.append(_numbers(path, number, words[2:], VERTEX_FIELDS))
            case "EDGE_SE2" | "EDGE2":
                if len(words) != 12:
                    raise _malformed(path, number, f"{len(words)} fields", EDGE_FIELDS)
                ends = [_integer(path, number, word, EDGE_FIELDS) for word in words[1:3]]
                edges.append((number, ends[0], ends[1]))
                row = _numbers(path, number, words[3:], EDGE_FIELDS)
                values.append(row if words[0] == "EDGE_SE2" else [row[at] for at in TORO_ORDER])
            case "FIX" | "EQUIV":
                continue
            case kind:
                raise _malformed(path, number, repr(kind[:40]), "VERTEX_SE2, EDGE_SE2 or FIX")
    edges_alone = not nodes
    if edges_alone:
        ids = sorted({index for _, i, j in edges for index in (i, j)})
        row_of = {index: row for row, index in enumerate(ids)}
    edge_nodes = np.empty((len(edges), 2), dtype=np.int32)
    for k, (number, i, j) in enumerate(edges):
        if i not in row_of or j not in row_of:
            missing = i if i not in row_of else j
            raise _malformed(path, number, f"an edge to node {missing}", "a VERTEX_SE2 for it")
        edge_nodes[k] = row_of[i], row_of[j]
    edge_values = np.array(values, dtype=np.float64).reshape(-1, 9)
    if not edges_alone:
        return PoseGraph(np.array(nodes, dtype=np.float64).reshape(-1, 3), edge_nodes, edge_values)
    return PoseGraph(_chained_whole(path, ids, edge_nodes, edge_values), edge_nodes, edge_values)


def _chained_whole(
    path: Path, ids: list[int], edge_nodes: npt.NDArray[np.int32], edge_values: FloatArray
) -> FloatArray:
    nodes = chained(len(ids), edge_nodes, edge_values[:, :3])
    lost = np.flatnonzero(np.isnan(nodes[:, 0]))
    if len(lost):
        raise FormatError(
            f"{path}: no chain of edges ties node {ids[int(lost[0])]} to node {ids[0]}; without "
            "VERTEX_SE2 lines every node must hang together"
        )
    return nodes


def chained(
    count: int,
    edge_nodes: npt.NDArray[np.int32],
    measured: FloatArray,
    first: FloatArray | None = None,
) -> FloatArray:
    """Nodes (count×3) as edges (k×2, k×3) chain them, from node 0 at `first` or the origin.

    Odometry first: a node follows from the one before it where an edge says so. What does not stand
    then follows by any edge from a node that does. NaN where no chain leads.
    """
    nodes = np.empty((count, 3))
    if count:
        origin = np.zeros(3) if first is None else np.array(first, dtype=np.float64)
        chain_kernels.chain(integers(edge_nodes).reshape(-1, 2), floats(measured), origin, nodes)
    return nodes


def read_text(path: Path) -> str:
    """The text of a file; raises FormatError when there is none."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise FormatError(f"{path}: cannot be read: {reason}") from error


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if words and not words[0].startswith("#"):
            yield number, words


def _numbers(path: Path, number: int, words: list[str], expected: str) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise _malformed(path, number, "a field that is no number", expected) from error
    if not all(math.isfinite(value) for value in values):
        raise _malformed(path, number, "a number that is not finite", expected)
    return values


def _integer(path: Path, number: int, word: str, expected: str) -> int:
    try:
        return int(word)
    except ValueError as error:
        raise _malformed(path, number, f"node id {word[:40]!r}", expected) from error


def _malformed(path: Path, number: int, found: str, expected: str) -> FormatError:
    return FormatError(f"{path}:{number}: found {found}, expected {expected}")
