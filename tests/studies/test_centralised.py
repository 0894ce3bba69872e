"""A team that has told each other everything knows what one batch over all its data says."""

from pathlib import Path

import pytest

from studies.centralised import compare, kept, line, summary
from world.scenario import GateConfig, RobotSpec, Scenario

SCENARIO = Scenario(
    map="rooms-small",
    seed=3,
    robots=(RobotSpec(name="r1"), RobotSpec(name="r2")),
    radio=GateConfig(range_m=100.0),
    max_sim_s=15.0,
)


def test_a_team_in_contact_is_as_good_as_the_batch(tmp_path: Path) -> None:
    row = compare(SCENARIO)
    assert (row["robots"], row["aligned"], row["frames"]) == (2, 2, 1)
    assert row["keyframes"] > 10
    assert row["team_error_m"] == pytest.approx(row["centralised_error_m"], rel=0.1, abs=1e-3)
    path = tmp_path / "row.json"
    path.write_text('{"seed": 7}')
    assert kept(SCENARIO, path) == {"seed": 7}  # what is there is not played again
    assert "2 of 2 aligned" in line(row)


def test_the_summary_tells_the_mean_with_its_error() -> None:
    rows: list[dict[str, float | None]] = [
        {"team_error_m": 0.0102, "centralised_error_m": 0.01},
        {"team_error_m": 0.0098, "centralised_error_m": 0.01},
        {"team_error_m": None, "centralised_error_m": None},
    ]
    said = summary(rows)
    assert "2 runs: mean ratio 1.0000 ± 0.0200, greatest 1.0200" in said
    assert summary(rows[:1]) == "too few runs for a mean"
