"""Photographs and plans as maps: a grey image to a grid, by threshold."""

from pathlib import Path

import numpy as np

from maps.grid import FREE, OCCUPIED, UNKNOWN, MapFileError, OccupancyGrid
from maps.pixels import read_pixels


def grid_from_image(
    path: Path, resolution_m: float, dark_below: int = 100, light_above: int = 200
) -> OccupancyGrid:
    """A grid from a drawing with dark walls on light ground; greys between are unknown.

    `resolution_m` is metres per pixel; the lower left corner becomes the origin. Raises
    MapFileError when the image cannot be read or the thresholds are out of order.
    """
    if not 0 <= dark_below <= light_above <= 255:
        raise MapFileError(
            f"expected 0 <= dark_below <= light_above <= 255, got {dark_below} and {light_above}"
        )
    if not 1e-4 <= resolution_m <= 100.0:
        raise MapFileError(f"resolution must be in metres per pixel, got {resolution_m}")
    pixels = read_pixels(path)[::-1]
    cells = np.full(pixels.shape, UNKNOWN, dtype=np.int8)
    cells[pixels < dark_below] = OCCUPIED
    cells[pixels > light_above] = FREE
    return OccupancyGrid(cells, resolution_m, 0.0, 0.0)
