"""Jobs land at the tick that was said, however fast or slow they are."""

from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest

from robot.jobs import Jobs


def test_a_result_is_not_seen_before_it_lands() -> None:
    jobs = Jobs()
    jobs.start("sum", 10, 3, sum, [1, 2])
    assert jobs.pending("sum") == 1
    assert [jobs.landed("sum", tick) for tick in (10, 11, 12)] == [[], [], []]
    assert jobs.landed("sum", 13) == [3]
    assert jobs.landed("sum", 14) == []
    assert jobs.pending("sum") == 0


def test_names_are_kept_apart_and_order_is_that_of_starting() -> None:
    jobs = Jobs()
    jobs.start("a", 0, 2, sum, [1])
    jobs.start("b", 0, 1, sum, [2])
    jobs.start("a", 1, 1, sum, [3])
    assert jobs.landed("b", 5) == [2]
    assert jobs.landed("a", 5) == [1, 3]


def test_a_late_job_is_waited_for() -> None:
    release = Event()

    def work() -> str:
        release.wait(10.0)
        return "done"

    with ThreadPoolExecutor(2) as executor:
        jobs = Jobs(executor)
        jobs.start("slow", 0, 1, work)
        assert jobs.landed("slow", 0) == []
        executor.submit(release.set)
        assert jobs.landed("slow", 1) == ["done"]


def test_an_error_in_a_job_comes_out_where_it_lands() -> None:
    with ThreadPoolExecutor(1) as executor:
        jobs = Jobs(executor)
        jobs.start("bad", 0, 1, int, "x")
        with pytest.raises(ValueError, match="invalid literal"):
            jobs.landed("bad", 1)


def test_a_job_that_lands_at_once_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one tick"):
        Jobs().start("now", 0, 0, sum, [1])
