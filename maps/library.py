"""The maps that ship, by name."""

from pathlib import Path

from maps.grid import MapFileError, OccupancyGrid, read_map

FOLDER = Path(__file__).resolve().parent


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
        f"({', '.join(shipped_maps())})"
    )


def load_map(name_or_path: str) -> OccupancyGrid:
    """Read a shipped map or a map_server YAML file. Raises MapFileError."""
    return read_map(find_map(name_or_path))
