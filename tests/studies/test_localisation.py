"""The study of global localisation, in small."""

from maps.library import load_map
from studies.localisation import measure


def test_every_start_in_small_rooms_is_found() -> None:
    result = measure(load_map("rooms-small"), starts=3, drive_m=5.0, seed=1)
    assert result["false"] == 0
    assert result["right"] == 3
    assert result["driven_m_median"] < 5.0
