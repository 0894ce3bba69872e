"""Map files: what is written is what is read, and what is wrong is refused in one clear line."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from maps.grid import FREE, OCCUPIED, UNKNOWN, MapFileError, OccupancyGrid, read_map, write_map

SETTINGS = {
    "image": "map.pgm",
    "resolution": 0.05,
    "origin": [-1.0, 2.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}


def pgm(width: int = 2, height: int = 2, data: bytes = b"\x00\xcd\xfe\xfe") -> bytes:
    return b"P5\n%d %d\n255\n" % (width, height) + data


def map_file(
    folder: Path, pixels: bytes | None = None, text: str | None = None, **changes: object
) -> Path:
    settings = {key: value for key, value in (SETTINGS | changes).items() if value != "absent"}
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(settings) if text is None else text)
    (folder / "map.pgm").write_bytes(pgm() if pixels is None else pixels)
    return path


@settings(max_examples=60, deadline=None)
@given(
    states=st.lists(
        st.lists(st.sampled_from([FREE, OCCUPIED, UNKNOWN]), min_size=3, max_size=3),
        min_size=1,
        max_size=7,
    ),
    resolution=st.floats(0.001, 10.0),
    x=st.floats(-1e4, 1e4),
    y=st.floats(-1e4, 1e4),
)
def test_reading_inverts_writing(
    tmp_path_factory: pytest.TempPathFactory,
    states: list[list[int]],
    resolution: float,
    x: float,
    y: float,
) -> None:
    path = tmp_path_factory.mktemp("map") / "map.yaml"
    grid = OccupancyGrid(np.array(states, dtype=np.int8), resolution, x, y)
    write_map(grid, path)
    back = read_map(path)
    assert np.array_equal(back.cells, grid.cells)
    assert (back.resolution, back.origin_x, back.origin_y) == (resolution, x, y)
    assert sorted(p.name for p in path.parent.iterdir()) == ["map.pgm", "map.yaml"]


def test_row_zero_of_the_image_is_the_top(tmp_path: Path) -> None:
    grid = read_map(map_file(tmp_path))
    assert grid.cells.tolist() == [[FREE, FREE], [OCCUPIED, UNKNOWN]]
    assert (grid.origin_x, grid.origin_y) == (-1.0, 2.0)


def test_probabilities_are_written_as_three_states(tmp_path: Path) -> None:
    cells = np.array([[0, 49, 50, 100, -1]], dtype=np.int8)
    write_map(OccupancyGrid(cells, 0.1, 0.0, 0.0), tmp_path / "map.yaml")
    assert read_map(tmp_path / "map.yaml").cells.tolist() == [[0, 0, 100, 100, -1]]


def test_unknown_is_not_free_at_the_usual_thresholds(tmp_path: Path) -> None:
    image = pgm(3, 1, bytes([0, 205, 254]))
    assert read_map(map_file(tmp_path, image)).cells.tolist() == [[OCCUPIED, UNKNOWN, FREE]]
    loose = read_map(map_file(tmp_path, image, free_thresh=0.25))
    assert loose.cells.tolist() == [[OCCUPIED, FREE, FREE]]


def test_negate_turns_the_shades_round(tmp_path: Path) -> None:
    grid = read_map(map_file(tmp_path, pgm(2, 1, bytes([0, 255])), negate=1))
    assert grid.cells.tolist() == [[FREE, OCCUPIED]]


def test_a_comment_in_the_header_is_skipped(tmp_path: Path) -> None:
    image = b"P5\n# CREATOR: a camera\n2 1\n# and more\n255\n\xfe\x00"
    assert read_map(map_file(tmp_path, image)).cells.tolist() == [[FREE, OCCUPIED]]


def test_a_pixel_that_looks_like_white_space_is_a_pixel(tmp_path: Path) -> None:
    image = pgm(2, 1, b"\x0a\x20")
    assert read_map(map_file(tmp_path, image)).cells.tolist() == [[OCCUPIED, OCCUPIED]]


def test_a_png_is_read_like_a_pgm(tmp_path: Path) -> None:
    _, encoded = cv2.imencode(".png", np.array([[0, 205], [254, 254]], dtype=np.uint8))
    path = map_file(tmp_path, encoded.tobytes())
    assert read_map(path).cells.tolist() == [[FREE, FREE], [OCCUPIED, UNKNOWN]]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"resolution": "absent", "negate": "absent"}, "lacks resolution, negate"),
        ({"resolution": 0.0}, "resolution"),
        ({"resolution": -0.05}, "resolution"),
        ({"resolution": "fine"}, "resolution must be a number"),
        ({"resolution": float("nan")}, "resolution must be a number"),
        ({"origin": [0.0, 0.0, 0.5]}, "rotated"),
        ({"origin": [0.0]}, "origin must be"),
        ({"origin": "here"}, "origin must be"),
        ({"origin": [0.0, "y", 0.0]}, "origin must be a number"),
        ({"occupied_thresh": 0.1}, "free_thresh < occupied_thresh"),
        ({"free_thresh": -0.1}, "free_thresh < occupied_thresh"),
        ({"occupied_thresh": 1.5}, "free_thresh < occupied_thresh"),
        ({"mode": "scale"}, "mode must be trinary"),
        ({"image": ["map.pgm"]}, "image must name"),
        ({"image": "other.pgm"}, "cannot read the image"),
        ({"text": "image: [unclosed"}, "not a YAML file"),
        ({"text": "just words"}, "expected the keys"),
        ({"text": ""}, "expected the keys"),
        ({"text": "!!python/object/apply:os.getcwd []"}, "not a YAML file"),
        ({"pixels": b""}, "empty"),
        ({"pixels": b"GIF89a nonsense"}, "expected a PGM"),
        ({"pixels": b"P5\n2\n"}, "expected a PGM header"),
        ({"pixels": pgm(2, 2, b"\x00")}, "cut off"),
        ({"pixels": pgm(0, 2, b"")}, "no pixels"),
        ({"pixels": pgm(100_000, 100_000)}, "million"),
        ({"pixels": b"P5 2 2 65535\n" + bytes(8)}, "8-bit"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    path = map_file(tmp_path, **changes)  # type: ignore[arg-type]  # of mixed values
    with pytest.raises(MapFileError, match=message) as caught:
        read_map(path)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(MapFileError, match=r"nowhere\.yaml: cannot read the map"):
        read_map(tmp_path / "nowhere.yaml")


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_bytes(b"\xff\xfe\x00image")
    with pytest.raises(MapFileError, match="not a YAML file"):
        read_map(tmp_path / "map.yaml")


def test_writing_refuses_what_it_cannot_do(tmp_path: Path) -> None:
    grid = OccupancyGrid(np.zeros((1, 1), dtype=np.int8), 0.1, 0.0, 0.0)
    with pytest.raises(MapFileError, match=r"NAME\.yaml"):
        write_map(grid, tmp_path / "map.pgm")
    with pytest.raises(MapFileError, match="cannot be written"):
        write_map(grid, tmp_path / "nowhere" / "map.yaml")
    empty = OccupancyGrid(np.zeros((0, 3), dtype=np.int8), 0.1, 0.0, 0.0)
    with pytest.raises(MapFileError, match="without cells"):
        write_map(empty, tmp_path / "map.yaml")
    assert list(tmp_path.iterdir()) == []


def test_cells_and_points_are_inverse() -> None:
    grid = OccupancyGrid(np.zeros((4, 6), dtype=np.int8), 0.05, -3.0, 7.0)
    rows, columns = np.mgrid[-2:6, -2:8].reshape(2, -1)
    back_rows, back_columns = grid.to_cells(grid.to_points(rows, columns))
    assert np.array_equal(back_rows, rows)
    assert np.array_equal(back_columns, columns)
    assert grid.inside(rows, columns).sum() == 24
