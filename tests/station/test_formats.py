"""TUM and g2o files: what is written is read back, and what is malformed is named."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from protocol.pose import FloatArray
from station.formats import (
    FormatError,
    PoseGraph,
    Trajectory,
    read_g2o,
    read_tum,
    write_g2o,
    write_text,
    write_tum,
)

metres = st.floats(-1e4, 1e4, allow_nan=False)
radians = st.floats(-np.pi, np.pi - 1e-9, allow_nan=False)
relaxed = settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@st.composite
def poses(draw: st.DrawFn, least: int = 0) -> FloatArray:
    count = draw(st.integers(least, 12))
    xy = draw(arrays(np.float64, (count, 2), elements=metres))
    theta = draw(arrays(np.float64, (count, 1), elements=radians))
    return np.hstack([xy, theta])


@relaxed
@given(poses=poses())
def test_a_trajectory_is_read_back(tmp_path: Path, poses: FloatArray) -> None:
    written = Trajectory(np.linspace(0.0, 0.1 * len(poses), len(poses)), poses)
    write_tum(written, tmp_path / "trajectory.tum")
    back = read_tum(tmp_path / "trajectory.tum")
    np.testing.assert_allclose(back.stamps, written.stamps, atol=1e-6)
    np.testing.assert_allclose(back.poses[:, :2], poses[:, :2], atol=1e-8)
    turned = (back.poses[:, 2] - poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(turned, 0.0, atol=1e-9)


@relaxed
@given(nodes=poses(least=2), data=st.data())
def test_a_graph_is_read_back(tmp_path: Path, nodes: FloatArray, data: st.DataObject) -> None:
    count = data.draw(st.integers(0, 8))
    ends = data.draw(
        arrays(np.int32, (count, 2), elements=st.integers(0, len(nodes) - 1)), label="ends"
    )
    values = data.draw(arrays(np.float64, (count, 9), elements=st.floats(-3, 3)), label="values")
    write_g2o(PoseGraph(nodes, ends, values), tmp_path / "graph.g2o")
    back = read_g2o(tmp_path / "graph.g2o")
    np.testing.assert_allclose(back.nodes, nodes, atol=1e-8)
    np.testing.assert_array_equal(back.edge_nodes, ends)
    np.testing.assert_allclose(back.edge_values, values, atol=1e-8)


def test_ids_may_be_sparse_and_edges_may_come_first(tmp_path: Path) -> None:
    path = tmp_path / "graph.g2o"
    path.write_text(
        "# by hand\nEDGE_SE2 7 3 1 2 0.5 1 0 0 1 0 1\n\nVERTEX_SE2 7 0 0 0\nVERTEX_SE2 3 1 2 0.5\n"
    )
    graph = read_g2o(path)
    assert graph.edge_nodes.tolist() == [[0, 1]]
    assert graph.nodes[1].tolist() == [1.0, 2.0, 0.5]


def test_a_graph_of_edges_alone_is_chained_odometry_first(tmp_path: Path) -> None:
    """The edge 10 → 12 comes first and disagrees; 20 hangs on an edge that leads to 11."""
    path = tmp_path / "graph.g2o"
    tail = "1 0 0 1 0 1"
    path.write_text(
        f"EDGE_SE2 10 12 9 9 1 {tail}\nEDGE_SE2 10 11 1 0 {np.pi / 2} {tail}\n"
        f"EDGE_SE2 11 12 1 0 0 {tail}\nEDGE_SE2 20 11 1 0 0 {tail}\n"
    )
    graph = read_g2o(path)
    assert graph.edge_nodes.tolist() == [[0, 2], [0, 1], [1, 2], [3, 1]]
    np.testing.assert_allclose(graph.nodes[:, :2], [[0, 0], [1, 0], [1, 1], [1, -1]], atol=1e-12)


def test_edges_alone_that_do_not_hang_together_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(FormatError, match="no chain of edges ties node 5 to node 0"):
        read_g2o(path)


def test_empty_files_are_empty(tmp_path: Path) -> None:
    (tmp_path / "empty").write_text("# nothing yet\n")
    assert read_tum(tmp_path / "empty").poses.shape == (0, 3)
    graph = read_g2o(tmp_path / "empty")
    assert graph.nodes.shape == (0, 3)
    assert graph.edge_values.shape == (0, 9)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("0 1 2 0 0 0 0\n", "x:1: found 7 fields"),
        ("# c\n0 1 2 0 0 0 0 1\n0 1 2 0 0 0 0 1\n", "x:3: found a stamp not after"),
        ("0 1 two 0 0 0 0 1\n", "x:1: found a field that is no number"),
        ("0 1 nan 0 0 0 0 1\n", "x:1: found a number that is not finite"),
        ("0 1 2 0 0 0 0 2\n", "x:1: found no unit quaternion"),
        ("0 1 2 0 0.6 0 0 0.8\n", "x:1: found a rotation that is not about z"),
    ],
)
def test_malformed_trajectories_are_named(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "x").write_text(text)
    with pytest.raises(FormatError, match=says):
        read_tum(tmp_path / "x")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("VERTEX_SE2 0 1 2\n", "x:1: found 4 fields, expected VERTEX_SE2 id x y theta"),
        ("VERTEX_SE2 a 1 2 3\n", "x:1: found node id 'a'"),
        ("VERTEX_SE2 0 1 2 3\nVERTEX_SE2 0 1 2 3\n", "x:2: found node 0 for the second time"),
        ("VERTEX_SE2 0 1 2 3\nEDGE_SE2 0 9 1 2 3 1 0 0 1 0 1\n", "x:2: found an edge to node 9"),
        ("EDGE_SE2 0 9 1 2 3 1 0 0 1 0\n", "x:1: found 11 fields"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", "x:1: found 'VERTEX_SE3:QUAT'"),
        ("VERTEX_SE2 0 inf 2 3\n", "x:1: found a number that is not finite"),
    ],
)
def test_malformed_graphs_are_named(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "x").write_text(text)
    with pytest.raises(FormatError, match=says):
        read_g2o(tmp_path / "x")


@relaxed
@given(content=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x").write_bytes(content)
    for read in (read_tum, read_g2o):
        try:
            read(tmp_path / "x")
        except FormatError as error:
            assert str(tmp_path / "x") in str(error)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="nowhere: cannot be read: No such file"):
        read_tum(tmp_path / "nowhere")


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    write_text(tmp_path / "x", "old")
    broken = Trajectory(np.arange(2.0), np.zeros((1, 3)))  # one pose too few
    with pytest.raises(ValueError, match="zip"):
        write_tum(broken, tmp_path / "x")
    assert (tmp_path / "x").read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["x"]
    assert (tmp_path / "x").stat().st_mode & 0o777 == 0o644


def test_a_graph_of_toro_is_read_too(tmp_path: Path) -> None:
    path = tmp_path / "old.graph"
    path.write_text(
        "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 2 0.5 11 12 22 33 13 23\nEQUIV 0 1\n"
    )
    graph = read_g2o(path)
    assert graph.edge_values.tolist() == [[1.0, 2.0, 0.5, 11.0, 12.0, 13.0, 22.0, 23.0, 33.0]]
