"""What is seen while a run goes on: numbers, table, lines and picture."""

import io
import itertools
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from station.live import LiveTable, Observers, PlainLines, one_line, render
from station.live_picture import LivePicture
from station.live_status import RunTracker, expected_end
from station.observer import Observer, RunOutcome
from station.wording import readable_bytes

Play = Callable[[Observer], RunOutcome]


def steady_clock(step_s: float) -> Callable[[], float]:
    """A clock that goes on by one step at each look."""
    ticks = itertools.count()
    return lambda: next(ticks) * step_s


def test_the_tracker_follows_the_run(play_under: Play) -> None:
    lines = PlainLines(io.StringIO(), RunTracker(steady_clock(0.05)))
    outcome = play_under(lines)
    status = lines.tracker.ended(outcome)
    first, dead = status.robots[0], status.robots[2]
    assert first.error_m == pytest.approx(0.02)
    assert first.activity == "exploring: as told"
    poses = outcome.simulation.history.poses[:, 0, :2]
    driven = float(np.hypot(*np.diff(poses, axis=0).T).sum())
    assert first.driven_m == pytest.approx(driven, rel=1e-3)
    assert dead.activity == "gone: answers no more"
    assert dead.hears == ()
    assert status.pace is not None
    assert [share for _, share in lines.tracker.coverage] == sorted(
        share for _, share in lines.tracker.coverage
    )
    assert status.coverage == 1.0


def test_plain_lines_come_at_even_times_and_end_with_the_reason(play_under: Play) -> None:
    stream = io.StringIO()
    play_under(PlainLines(stream, every_s=5.0))
    lines = stream.getvalue().splitlines()
    assert lines[0] == "room · 3 robots · radio 4 m · seed 0"
    assert [line.split(" · ")[0] for line in lines[1:-1]] == [
        "t 0:00",
        "t 0:05",
        "t 0:10",
        "t 0:12",
    ]
    assert lines[-1] == "ended: time limit"


def test_the_table_shows_every_robot_and_gives_the_cursor_back(play_under: Play) -> None:
    console = Console(record=True, force_terminal=True, width=100, file=io.StringIO())
    table = LiveTable(console, clock=steady_clock(0.1))
    with Observers([table]) as observers:
        play_under(observers)
    text = console.export_text()
    assert "room · 3 robots · radio 4 m · seed 0" in text
    assert "exploring: as told" in text
    assert "gone: answers no more" in text
    assert "100.0 %" in text
    assert not console._live_stack
    assert console.file.getvalue().endswith("\x1b[?25h")  # type: ignore[attr-defined]


def test_the_table_lets_go_of_the_screen_when_a_run_fails(play_under: Play) -> None:
    class Failing(PlainLines):
        def mapped(self, *_: object) -> None:
            raise RuntimeError("the run fails")

    console = Console(force_terminal=True, width=100, file=io.StringIO())
    with (
        pytest.raises(RuntimeError, match="the run fails"),
        Observers([LiveTable(console), Failing(io.StringIO())]) as observers,
    ):
        play_under(observers)
    assert not console._live_stack


def test_the_table_is_drawn_as_often_as_the_clock_allows(play_under: Play) -> None:
    drawn = 0

    class Counting(LiveTable):
        def _draw(self, *_: object) -> None:
            nonlocal drawn
            drawn += 1

    play_under(Counting(Console(file=io.StringIO()), RunTracker(), steady_clock(0.01)))
    assert 4 <= drawn <= 8  # 121 looks, 0.01 s apart, every 0.25 s, and once at the end


def test_a_status_without_reports_renders(nothing: RunOutcome) -> None:
    tracker = RunTracker()
    tracker.started(nothing.simulation)
    status = tracker.status(nothing.simulation, {})
    console = Console(record=True, width=80, file=io.StringIO())
    console.print(render("title", status))
    assert "not heard of yet" in console.export_text()
    assert "coverage – · expected end –" in one_line(status)


def test_the_end_is_expected_on_the_line_of_the_last_part() -> None:
    steady = [(10.0 * k, 0.05 * k) for k in range(11)]
    assert expected_end(steady) == pytest.approx(199.0)
    assert expected_end(steady[:2]) is None
    assert expected_end([(t, 0.5) for t, _ in steady]) is None
    assert expected_end([*steady, (110.0, 0.999)]) == 110.0


def test_the_picture_is_replaced_as_a_whole(play_under: Play, tmp_path: Path) -> None:
    path = tmp_path / "live.png"

    class Checking(LivePicture):
        seen = 0

        def _draw(self, *arguments: object) -> None:
            if path.exists():
                assert cv2.imread(str(path)) is not None
            super()._draw(*arguments)  # type: ignore[arg-type]
            Checking.seen += 1

    play_under(Checking(path, steady_clock(0.1)))
    assert Checking.seen > 10
    assert [file.name for file in tmp_path.iterdir()] == ["live.png"]
    image = cv2.imread(str(path))
    assert image is not None
    assert image.shape[1] == 1200
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 20


@pytest.mark.parametrize(
    ("amount", "text"), [(0, "0 B"), (999, "999 B"), (1500, "1.5 kB"), (2_340_000, "2.34 MB")]
)
def test_bytes_are_readable(amount: int, text: str) -> None:
    assert readable_bytes(amount) == text
