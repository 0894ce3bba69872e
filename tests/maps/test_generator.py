"""The generator: the maps that ship are what it makes, and robots can get about in them."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import ndimage

from maps.building import BuildingConfig
from maps.generator import SHIPPED, main, make_building
from maps.grid import MapFileError, OccupancyGrid
from maps.library import FOLDER, find_map, load_map, shipped_maps

# A robot has a radius of 0.20 m; this much leaves it comfort.
COMFORTABLE_M = 0.30


def room_for(
    grid: OccupancyGrid, radius_m: float
) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Cell centres at least a radius away from the centre of any solid cell."""
    padded = np.pad(grid.free, 1)
    distance = ndimage.distance_transform_edt(padded)[1:-1, 1:-1] * grid.resolution
    return np.asarray(distance > radius_m + 0.5 * grid.resolution)


def test_the_shipped_files_are_what_the_generator_makes(tmp_path: Path) -> None:
    main(tmp_path)
    made = sorted(tmp_path.iterdir())
    assert [path.stem for path in made[::2]] == list(shipped_maps()) == sorted(SHIPPED)
    for path in made:
        assert path.read_bytes() == (FOLDER / path.name).read_bytes(), path.name


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_every_place_can_be_reached_with_comfort(name: str) -> None:
    _, areas = ndimage.label(room_for(load_map(name), COMFORTABLE_M))
    assert areas == 1


@pytest.mark.parametrize("seed", range(12))
def test_buildings_of_other_seeds_can_be_reached_too(seed: int) -> None:
    grid = make_building(BuildingConfig(seed=seed))
    _, areas = ndimage.label(room_for(grid, COMFORTABLE_M))
    assert areas == 1


def test_office_is_an_office() -> None:
    grid = load_map("office")
    height, width = np.array(grid.cells.shape) * grid.resolution
    assert width >= 30.0
    assert height >= 20.0
    assert grid.resolution == 0.05
    # Without its doors (at most 1.2 m wide) the corridor (1.8 m) and every room are areas apart.
    rooms, count = ndimage.label(room_for(grid, 0.65))
    sizes = np.bincount(rooms.ravel())[1:] * grid.resolution**2
    assert (sizes > 4.0).sum() >= 9
    assert count < 60


def test_loops_are_there_to_be_closed() -> None:
    for name in ("office", "loop", "rooms-small"):
        grid = load_map(name)
        holes, count = ndimage.label(~room_for(grid, 0.2), np.ones((3, 3)))
        border = set(holes[0]) | set(holes[-1]) | set(holes[:, 0]) | set(holes[:, -1])
        largest = max(int((holes == i).sum()) for i in range(1, count + 1) if i not in border)
        assert largest * grid.resolution**2 > 1.0, name


def test_a_seed_decides_everything() -> None:
    first, again = (make_building(BuildingConfig(seed=5)) for _ in range(2))
    other = make_building(BuildingConfig(seed=6))
    assert np.array_equal(first.cells, again.cells)
    assert not np.array_equal(first.cells, other.cells)


def test_walls_are_as_thick_as_asked() -> None:
    grid = make_building(BuildingConfig(layout="rooms", width_m=10.0, height_m=8.0, wall_m=0.1))
    free = grid.free
    thin = (~free[:, 1:-1]) & free[:, :-2] & free[:, 2:]
    assert not thin.any()


def test_hostile_configuration_is_refused() -> None:
    with pytest.raises(ValidationError):
        BuildingConfig(wall_m=0.0)
    with pytest.raises(ValidationError):
        BuildingConfig(storeys=2)  # type: ignore[call-arg]  # on purpose


def test_an_unknown_map_is_refused_with_the_names_of_those_there_are() -> None:
    with pytest.raises(MapFileError, match="loop, office, rooms-small"):
        find_map("ofice")


def test_a_path_is_a_map_too(tmp_path: Path) -> None:
    main(tmp_path)
    assert find_map(str(tmp_path / "loop.yaml")) == tmp_path / "loop.yaml"
    assert np.array_equal(load_map(str(tmp_path / "loop.yaml")).cells, load_map("loop").cells)
