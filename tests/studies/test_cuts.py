"""The study of cuts, on a few schedules; and that it would notice."""

from protocol.pose import IDENTITY
from studies import cuts


def test_whatever_was_cut_everybody_ends_with_the_same() -> None:
    for seed in range(3):
        row = cuts.run_schedule(seed)
        assert row["missing_before"] > 0
        assert cuts.passed(row), row


def test_what_is_missing_is_counted() -> None:
    schedule = cuts.Schedule(0)
    schedule.play_cuts()
    assert schedule.settle() <= cuts.MOST_EXCHANGES
    assert schedule.missing() == 0
    name = schedule.names[0]
    entry = cuts.Keyframe(0, 0, 0, IDENTITY, cuts.INFORMATION, cuts.np.ones(cuts.BEAMS))
    schedule.teams[name].write([entry])
    assert schedule.difference() == 0.0
    assert not cuts.passed({**cuts.run_schedule(0), "missing": 1})
