"""Photographs and plans as maps."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from maps.grid import FREE, OCCUPIED, UNKNOWN, MapFileError
from maps.image import grid_from_image


def test_dark_is_wall_light_is_free_and_grey_is_unknown(tmp_path: Path) -> None:
    plan = tmp_path / "plan.png"
    cv2.imwrite(str(plan), np.array([[0, 128, 255], [255, 255, 255]], dtype=np.uint8))
    grid = grid_from_image(plan, 0.02)
    assert grid.cells.tolist() == [[FREE] * 3, [OCCUPIED, UNKNOWN, FREE]]
    assert grid.resolution == 0.02


def test_a_photograph_in_colour_is_read_by_its_brightness(tmp_path: Path) -> None:
    plan = tmp_path / "plan.png"
    cv2.imwrite(str(plan), np.array([[[255, 255, 255], [60, 0, 60]]], dtype=np.uint8))
    assert grid_from_image(plan, 0.02).cells.tolist() == [[FREE, OCCUPIED]]


def test_thresholds_out_of_order_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapFileError, match="dark_below <= light_above"):
        grid_from_image(tmp_path / "plan.png", 0.02, dark_below=200, light_above=100)
    with pytest.raises(MapFileError, match="metres per pixel"):
        grid_from_image(tmp_path / "plan.png", 0.0)
    with pytest.raises(MapFileError, match="cannot read the image"):
        grid_from_image(tmp_path / "plan.png", 0.02)
