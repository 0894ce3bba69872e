"""The study of first meetings: what it plays, keeps and tells."""

from pathlib import Path

import pytest

from studies.first_meetings import Meeting, kept, line, main, play, summary


def test_robots_that_see_each_other_are_aligned_within_ten_seconds() -> None:
    meeting = play("rooms-small", 2, 30.0)
    assert meeting.met_s == 0.0
    assert meeting.outcome == "right"
    assert meeting.took_s is not None
    assert meeting.took_s <= 8.0
    assert meeting.error_m is not None
    assert 0.0 < meeting.error_m < 0.1


def test_a_run_without_a_meeting_is_listed_and_kept(tmp_path: Path) -> None:
    meeting = kept("rooms-small", 0, 2.0, tmp_path)
    assert meeting.outcome == "never met"
    (file,) = tmp_path.iterdir()
    file.write_text(meeting.model_copy(update={"met_s": 1.0, "reasons": ("so",)}).model_dump_json())
    again = kept("rooms-small", 0, 2.0, tmp_path)
    assert again.outcome == "undecided"
    assert line(again) == "rooms-small, seed 0: undecided, met after 1.0 s: so"


def test_what_it_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = {"took_s": 4.0, "error_m": 0.1, "error_rad": 0.01}
    right = Meeting(world="office", seed=0, met_s=1.0, **told)
    wrong = right.model_copy(update={"error_m": 3.0, "took_s": 6.0})
    never = Meeting(world="office", seed=2, met_s=None)
    assert [m.outcome for m in (right, wrong, never)] == ["right", "false", "never met"]
    assert summary([right, wrong, never]) == (
        "3 runs: 1 right, 1 false, 1 never met; aligned after 5.0 s in the median, 6.0 s at most"
    )
    assert summary([never]) == "1 runs: 1 never met"
    assert main(["no-such-map", "--out", str(tmp_path)]) == 2
    assert "no-such-map" in capsys.readouterr().err
