"""Maps of real buildings, where the folder of the measurements is at hand."""

import os
from pathlib import Path

import pytest

from maps.grid import OccupancyGrid, read_map

REAL_MAPS = ("freiburg-079", "intel", "willow", "aces", "belgioioso")


@pytest.fixture(params=REAL_MAPS)
def real_grid(request: pytest.FixtureRequest) -> OccupancyGrid:
    """One real map after the other; skips where there are none."""
    beside = Path(__file__).resolve().parents[3] / "shared"
    path = Path(os.environ.get("EARSHOT_DATA", beside)) / "maps" / f"{request.param}.yaml"
    if not path.is_file():
        pytest.skip(f"no {path.name}: name the folder that has maps/{path.name} in EARSHOT_DATA")
    return read_map(path)
