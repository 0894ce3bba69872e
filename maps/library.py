"""Maps by name: those that ship, their variations, and map files.

`office` is a map that ships. `office:width_m=100,height_m=60` is what the generator makes of its
configuration with other values (see `maps.building.BuildingConfig`). All else is the path of a
map_server YAML file.
"""

from pathlib import Path

from pydantic import ValidationError

from maps.building import BuildingConfig
from maps.generator import FOLDER, SHIPPED, make_building
from maps.grid import MapFileError, OccupancyGrid, read_map


def shipped_maps() -> tuple[str, ...]:
    """The names of the maps that ship."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.yaml")))


def find_map(name_or_path: str) -> Path:
    """The YAML file of a shipped map, or of a path.

    Raises MapFileError, listing the shipped maps, when there is neither.
    """
    if name_or_path in shipped_maps():
        return FOLDER / f"{name_or_path}.yaml"
    path = Path(name_or_path)
    if path.is_file():
        return path
    raise MapFileError(
        f"no map {name_or_path!r}: neither a file nor one of the shipped maps "
        f"({', '.join(shipped_maps())}), which may be varied: office:width_m=100,height_m=60"
    )


def varied(name: str) -> BuildingConfig | None:
    """The configuration behind `MAP:key=value,...`; None when the name is not of this form.

    Raises MapFileError when the generator has no such key or cannot take the value.
    """
    base, colon, changes = name.partition(":")
    if not colon or base not in SHIPPED:
        return None
    fields = SHIPPED[base].model_dump()
    for change in changes.split(","):
        key, equals, value = change.partition("=")
        if not equals or key not in fields:
            raise MapFileError(
                f"map {name!r}: {change!r} is no key=value of {', '.join(sorted(fields))}"
            )
        fields[key] = value
    try:
        return BuildingConfig.model_validate(fields)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise MapFileError(f"map {name!r}: {first['loc'][0]}: {first['msg']}") from None


def load_map(name_or_path: str) -> OccupancyGrid:
    """A shipped map, one varied by the generator, or a map_server YAML file.

    Raises MapFileError.
    """
    config = varied(name_or_path)
    return read_map(find_map(name_or_path)) if config is None else make_building(config)
