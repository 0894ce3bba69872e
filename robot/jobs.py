"""Long work beside the control step, with a landing tick that does not depend on speed.

A job is a pure function of the arguments it was started with. It starts at tick k and its result
is seen at tick k + delay, never earlier: also when it was ready at once, and when it is late in
lockstep the step waits for it. So a run is the same on a slow machine, inline, or in processes.
"""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any


@dataclass(slots=True)
class Job:
    """`outcome` is the result itself, or the future of it while an executor works on it."""

    name: str
    started: int
    lands: int
    outcome: Any


class Jobs:
    """The jobs of one brain. Without an executor each runs at once, in the calling thread."""

    TRANSIENT = ("executor",)

    def __init__(self, executor: Executor | None = None) -> None:
        self.executor = executor
        self._jobs: list[Job] = []

    def start(
        self, name: str, tick: int, delay: int, work: Callable[..., Any], *arguments: Any
    ) -> None:
        """Start `work(*arguments)` at `tick`; `landed` returns its result from tick + delay on.

        The arguments must be snapshots that nobody goes on writing to.
        """
        if delay < 1:
            raise ValueError("a job lands at least one tick after it starts")
        outcome: Any = self.executor.submit(work, *arguments) if self.executor else work(*arguments)
        self._jobs.append(Job(name, tick, tick + delay, outcome))

    def landed(self, name: str, tick: int) -> list[Any]:
        """Results of the jobs of that name which land by `tick`, in the order they started."""
        if not self._jobs:
            return []
        due = [job for job in self._jobs if job.name == name and job.lands <= tick]
        self._jobs = [job for job in self._jobs if not (job.name == name and job.lands <= tick)]
        return [_result(job.outcome) for job in due]

    def pending(self, name: str) -> int:
        """How many jobs of that name have not landed."""
        return sum(job.name == name for job in self._jobs)

    def settle(self) -> None:
        """Wait for every running job and keep its result in place of the future."""
        for job in self._jobs:
            job.outcome = _result(job.outcome)


def _result(outcome: Any) -> Any:
    return outcome.result() if isinstance(outcome, Future) else outcome
