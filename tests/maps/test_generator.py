"""The generator: the maps that ship are what it makes, and robots can get about in them."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import ndimage

from maps.building import BuildingConfig, BuildingError
from maps.generator import FOLDER, LAYOUTS, SHIPPED, main, make_building
from maps.grid import MapFileError, OccupancyGrid
from maps.library import find_map, load_map, shipped_maps

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


def areas(grid: OccupancyGrid) -> int:
    """Between how many parts of a building there is no way."""
    return int(ndimage.label(room_for(grid, COMFORTABLE_M))[1])


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_every_place_can_be_reached_with_comfort(name: str) -> None:
    assert areas(load_map(name)) == (2 if name == "apart" else 1)


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_buildings_of_other_seeds_can_be_reached_too(name: str) -> None:
    for seed in range(6):
        grid = make_building(SHIPPED[name].model_copy(update={"seed": seed}))
        assert areas(grid) == (2 if name == "apart" else 1), seed


def test_every_layout_ships() -> None:
    assert {config.layout for config in SHIPPED.values()} == set(LAYOUTS)


def test_a_large_office_has_corridors_between_blocks_of_rooms() -> None:
    grid = load_map("office:width_m=100,height_m=60")
    assert areas(grid) == 1
    height, width = np.array(grid.cells.shape) * grid.resolution
    assert (round(width), round(height)) == (101, 61)
    rooms, _ = ndimage.label(room_for(grid, 0.65))
    sizes = np.bincount(rooms.ravel())[1:] * grid.resolution**2
    assert (sizes > 4.0).sum() >= 100
    assert np.sort(sizes)[-2] < 60.0  # the largest is the net of corridors, no other is a hall


def test_a_symmetric_building_is_the_same_upside_down() -> None:
    for seed in range(3):
        config = SHIPPED["symmetric"].model_copy(update={"seed": seed})
        cells = make_building(config).cells
        assert np.array_equal(cells, cells[::-1, ::-1])
        assert not np.array_equal(cells, cells[::-1])


def test_rooms_in_rows_are_look_alikes_and_their_hall_is_not() -> None:
    config = SHIPPED["rows"]
    cells = load_map("rows").cells
    pitch = round((config.room_width_m + config.wall_m) / config.resolution_m)
    first = round((config.margin_m + config.wall_m) / config.resolution_m)
    above = cells.shape[0] * 6 // 10
    rooms = [cells[above:, first + pitch * k : first + pitch * (k + 1)] for k in range(1, 7)]
    assert all(np.array_equal(room[:, :-3], rooms[0][:, :-3]) for room in rooms)
    assert not np.array_equal(cells[above:, first : first + pitch - 3], rooms[0][:, :-3])


def test_a_tilt_turns_the_building_counter_clockwise_and_loses_nothing() -> None:
    config = BuildingConfig(layout="rooms", width_m=10.0, height_m=6.0, margin_m=0.0)
    straight = make_building(config).cells
    upright = make_building(config.model_copy(update={"tilt_rad": np.pi / 2})).cells
    # Row 0 is at the bottom: counter-clockwise is np.rot90's other way round.
    assert np.array_equal(upright, np.rot90(straight, -1))
    tilted = make_building(config.model_copy(update={"tilt_rad": 0.3})).cells
    assert (tilted == 0).sum() == pytest.approx((straight == 0).sum(), rel=0.01)


def test_a_map_can_be_varied_by_name() -> None:
    made = make_building(SHIPPED["office"].model_copy(update={"seed": 9, "width_m": 40.0}))
    assert np.array_equal(load_map("office:seed=9,width_m=40").cells, made.cells)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("office:storeys=2", "no key=value of .*width_m"),
        ("office:seed", "no key=value"),
        ("office:", "no key=value"),
        ("office:width_m=1", "width_m: .*greater than or equal to 6"),
        ("office:width_m=wide", "width_m: .*number"),
        ("office:width_m=[", "width_m"),
        ("villa:seed=2", "no map 'villa:seed=2'"),
    ],
)
def test_a_variation_that_cannot_be_is_refused(name: str, says: str) -> None:
    with pytest.raises(MapFileError, match=says):
        load_map(name)


@pytest.mark.parametrize("name", ["office", "corridor", "institute", "wings"])
def test_too_little_ground_for_a_layout_is_refused(name: str) -> None:
    with pytest.raises(BuildingError, match=r"6 × 6 m are too little for the layout"):
        load_map(f"{name}:width_m=6,height_m=6,corridor_m=4")


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
    with pytest.raises(MapFileError, match="loop, office, rooms-small, rows"):
        find_map("ofice")


def test_a_path_is_a_map_too(tmp_path: Path) -> None:
    main(tmp_path)
    assert find_map(str(tmp_path / "loop.yaml")) == tmp_path / "loop.yaml"
    assert np.array_equal(load_map(str(tmp_path / "loop.yaml")).cells, load_map("loop").cells)
