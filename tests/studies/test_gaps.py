"""The study of tight gaps: a robot touches nothing, and gets through where there is room."""

import json
from pathlib import Path

import pytest

from studies.gaps import drive, main, make_course


def test_a_wide_gap_is_driven_and_no_gap_is_touched() -> None:
    wide = next(s for s in range(100) if make_course(s).width_m == 0.7)
    tight = next(s for s in range(100) if make_course(s).width_m == 0.42)
    assert drive(make_course(wide), wide) == (True, 0)
    assert drive(make_course(tight), tight)[1] == 0


def test_the_table_counts_every_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "gaps.json"
    assert main(["--drives", "6", "--json", str(file)]) == 0
    table = json.loads(file.read_text())
    assert sum(row["drives"] for row in table["gaps"]) == 6
    assert table["contacts"] == 0
    assert "contacts in all: 0" in capsys.readouterr().out
