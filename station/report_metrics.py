"""A run in numbers: what `metrics.json` holds. What cannot be computed is null, never invented."""

import platform
from importlib.metadata import PackageNotFoundError, version

from pydantic import Field

from protocol.model import Model
from station.hashes import run_hashes
from station.observer import RunOutcome
from world.last_words import WireCount
from world.referee import Accuracy, LedgerScore, RadioScore, Referee, RobotScore, WallScore
from world.report_log import ReportLog

PACKAGES = ("earshot-slam", "numpy", "numba", "scipy", "eclipse-zenoh", "pydantic", "qdldl")
WORLD = "world"


class Standing(Model):
    """How a robot's map stands to a teammate's: unknown, tentative, aligned or contradictory."""

    state: str
    reason: str


class RobotMetrics(RobotScore):
    """One robot's score, whether it said that it was done, what became of it where that is not
    the ordinary, and what it last said that it was doing."""

    finished: bool
    note: str
    activity: str
    wire: dict[str, WireCount] | None
    missed_ticks: int
    frame: str | None = Field(description="of its map and trajectory; equal for who is aligned")
    alignment: dict[str, Standing] = Field(description="how it stands to teammates, by its word")


class Metrics(Model):
    """Shares are between 0 and 1, errors in metres, times in seconds.

    `coverage` is of the union of the robots' own maps, `coverage_worst_joint` of the poorest
    joint map among the robots that answered. `realtime_factor` is simulated over wall time.
    `peak_rss_mb` is by process; in one process with the world, a robot has none of its own.
    `messages_lost` are those between the world and robots that were sent and not received.
    """

    map: str
    seed: int
    mode: str
    exit_reason: str
    sim_s: float
    wall_s: float
    realtime_factor: float | None
    coverage: float | None
    coverage_worst_joint: float | None
    target_m2: float = Field(description="area that coverage is a share of")
    walls: WallScore
    team: Accuracy
    robots: dict[str, RobotMetrics]
    collisions: int
    ledger: LedgerScore
    radio: RadioScore
    messages_lost: int | None
    peak_rss_mb: dict[str, float | None]
    hashes: dict[str, str]
    versions: dict[str, str | None]


def measure(outcome: RunOutcome) -> Metrics:
    """Have the referee judge a run, and add what only its host knows."""
    simulation, robots = outcome.simulation, outcome.robots
    score = Referee(simulation).score(
        {name: (robot.map, robot.trajectory) for name, robot in robots.items()}
    )
    sim_s = max(simulation.stamp, 0.0)  # interrupted before tick 0, no time has passed
    return Metrics(
        map=simulation.scenario.map,
        seed=simulation.scenario.seed,
        mode=outcome.mode,
        exit_reason=outcome.exit_reason,
        sim_s=sim_s,
        wall_s=outcome.wall_s,
        realtime_factor=sim_s / outcome.wall_s if outcome.wall_s > 0.0 else None,
        coverage=score.coverage,
        coverage_worst_joint=score.coverage_worst_joint,
        target_m2=score.target_m2,
        walls=score.walls,
        team=score.team,
        robots={
            name: RobotMetrics(
                **robot.model_dump(),
                finished=name in simulation.finished,
                note=robots[name].note if name in robots else "no answer",
                activity=_activity(outcome.reports.get(name)),
                wire=robots[name].wire if name in robots else None,
                missed_ticks=robots[name].missed_ticks if name in robots else 0,
                frame=_frame(outcome, name),
                alignment=_alignment(outcome, name),
            )
            for name, robot in score.robots.items()
        },
        collisions=score.collisions,
        ledger=score.ledger,
        radio=score.radio,
        messages_lost=messages_lost(outcome),
        peak_rss_mb={
            WORLD: outcome.world_peak_rss_mb,
            **{name: robot.peak_rss_mb for name, robot in sorted(robots.items())},
        },
        hashes=run_hashes(outcome),
        versions={
            "python": platform.python_version(),
            **{name: _version(name) for name in PACKAGES},
        },
    )


def _activity(log: ReportLog | None) -> str:
    return log.latest.activity if log is not None and log.latest is not None else ""


def _frame(outcome: RunOutcome, name: str) -> str | None:
    robot = outcome.robots.get(name)
    return None if robot is None or robot.trajectory is None else robot.trajectory.frame


def _alignment(outcome: RunOutcome, name: str) -> dict[str, Standing]:
    """What the robot's last report says of its teammates."""
    reports = outcome.reports.get(name)
    if reports is None or reports.latest is None:
        return {}
    return {
        mate.robot: Standing(state=mate.alignment, reason=mate.alignment_reason)
        for mate in reports.latest.team
        if mate.robot != name
    }


def messages_lost(outcome: RunOutcome) -> int | None:
    """Sent and not received, by either side, of all robots that said; None if none did."""
    told = [robot.wire for robot in outcome.robots.values() if robot.wire is not None]
    if not told:
        return None
    return sum(count.sent - count.received for wire in told for count in wire.values())


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:  # as in a checkout that was not installed
        return None
