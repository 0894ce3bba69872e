"""The study of cuts, on a few schedules; and that it would notice."""

import pytest

from studies import cuts


def test_whatever_was_cut_everybody_ends_with_the_same() -> None:
    for seed in range(3):
        row = cuts.run_schedule(seed)
        assert row["missing_before"] > 0
        assert cuts.passed(row), row


@pytest.mark.parametrize(
    "fault", [{"missing": 1}, {"malformed": 1}, {"exchanges": 4}, {"difference": 1e-8}]
)
def test_a_schedule_that_ends_otherwise_does_not_pass(fault: dict[str, float]) -> None:
    good = {"exchanges": 3, "missing": 0, "malformed": 0, "difference": 0.0}
    assert cuts.passed(good)
    assert not cuts.passed({**good, **fault})
