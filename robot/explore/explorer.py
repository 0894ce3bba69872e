"""Deciding where to go and driving there: the stateful core that the brain steps each tick.

About once a second a plan is made as a job on a snapshot of the joint map; between plans the
pilot drives along the last path. A robot is finished when two plans in a row found nothing left,
and goals that had been given up were tried again. It stays finished unless, later, at least
`NOTABLE_M` of reachable frontier has appeared (a teammate brought a part of the map that it had
not finished itself), or there is a teammate to be met.
"""

from dataclasses import dataclass

from protocol.config import RobotConfig
from protocol.messages import DriveCommand
from protocol.pose import FloatArray, Pose2
from robot.explore.footprints import Footprints
from robot.explore.nearest import FRESH_TICKS
from robot.explore.pilot import GridProvider, Pilot, Steering
from robot.explore.planner import NO_PATH
from robot.explore.policies import make_policy
from robot.explore.policy import Plan, Policy, Teammate, View
from robot.explore.refusals import VISITED_M, Refusals
from robot.jobs import Jobs
from robot.perception.odometry import Motion
from robot.perception.scan import LaserScan

PLAN_DELAY_TICKS = 3
PLAN_EVERY_S, PLAN_FAR_EVERY_S, LOOK_AGAIN_S = 1.0, 2.0, 5.0
FAR_M = 4.0
NOTABLE_M = 1.0


@dataclass(frozen=True, slots=True)
class Decision:
    """What the robot does next, and what of it others may want to know.

    `explored`: it goes on although nothing is left to explore, so nothing new is to be seen."""

    drive: DriveCommand
    goal: Pose2 | None
    path: FloatArray
    activity: str
    finished: bool
    frontier_m: float
    explored: bool


class Explorer:
    """Exploration of one robot."""

    TRANSIENT = ("_policy",)

    def __init__(self, config: RobotConfig, jobs: Jobs) -> None:
        """Raises PolicyError when there is no policy of the configured name."""
        self._config = config
        self._jobs = jobs
        self._policy: Policy | None = make_policy(config.policy)
        self._pilot = Pilot(config, jobs)
        self._footprints = Footprints()
        self._goal: Pose2 | None = None
        self._explores = True
        self._reason = "waiting for a first map"
        self._planned_from: Pose2 | None = None
        self._home: Pose2 | None = None
        self._plan_due = 0
        self._frontier_m = 0.0
        self._refusals = Refusals(config.tick_s)
        self._exhausted = 0
        self.finished = False

    def step(
        self,
        tick: int,
        pose: Pose2,
        motion: Motion,
        scan: LaserScan | None,
        grids: GridProvider,
        teammates: tuple[Teammate, ...],
    ) -> Decision:
        """Take what is known at this tick, in the map frame, and decide."""
        self._home = self._home or pose
        self._leave_footprints(tick, pose, teammates)
        for plan in self._jobs.landed("plan", tick):
            self._take(tick, plan)
        if self._is_plan_due(tick):
            self._start_plan(tick, pose, grids, teammates)
        steering = self._pilot.step(tick, pose, motion, scan, self._goal, grids, teammates)
        self._note(tick, steering)
        return Decision(
            steering.command,
            self._goal,
            self._pilot.path,
            steering.words or self._activity(),
            self.finished,
            self._frontier_m,
            not self._explores,
        )

    def _leave_footprints(self, tick: int, pose: Pose2, teammates: tuple[Teammate, ...]) -> None:
        for place in (pose, *(mate.pose for mate in teammates)):
            self._footprints.mark(tick, place)
        if self._goal is not None and self._pilot.arrived:
            self._footprints.mark(tick, self._goal)  # it may lie beyond the border of a square

    def _is_plan_due(self, tick: int) -> bool:
        if self._jobs.pending("plan") or self._pilot.recovering:
            return False
        return tick >= self._plan_due or (self._goal is not None and self._pilot.arrived)

    def _start_plan(
        self, tick: int, pose: Pose2, grids: GridProvider, teammates: tuple[Teammate, ...]
    ) -> None:
        if self._policy is None:
            self._policy = make_policy(self._config.policy)
        self._note_lookouts(teammates)
        view = View(
            self._config.name, tick, grids.snapshot(), pose, self._config.body, teammates,
            self._refusals.places(), self._goal,
            grids.lookouts(), self._footprints.visits(), self._config.tick_s,
            self._refusals.blocked(), self._home, grids.meeting_place(),
        )  # fmt: skip
        self._jobs.start("plan", tick, PLAN_DELAY_TICKS, self._policy.plan, view)
        self._planned_from = pose
        far = self._pilot.remaining_m > FAR_M
        every = LOOK_AGAIN_S if self.finished else PLAN_FAR_EVERY_S if far else PLAN_EVERY_S
        self._plan_due = tick + round(every / self._config.tick_s)

    def _take(self, tick: int, plan: Plan) -> None:
        """Make a plan that has landed the present one."""
        self._frontier_m, self._reason = plan.frontier_m, plan.reason
        if self._pilot.recovering:
            return
        if self.finished and plan.explores and (plan.goal is None or plan.frontier_m < NOTABLE_M):
            return
        self.finished = False
        if plan.goal is None:
            self._stand()
            if plan.exhausted:
                self._note_exhausted(tick)
        elif not plan.explores:
            self._go(plan)
        elif self._planned_from and plan.goal.distance_to(self._planned_from) <= VISITED_M:
            # Seen from here, and still unknown: no ray gets there.
            self._refusals.note_seen(plan.goal)
            self._plan_due = tick
        elif self._refusals.returns_too_often(self._goal, plan.goal):
            self._refusals.give_up(plan.goal)
            self._plan_due = tick
        else:
            self._go(plan)

    def _go(self, plan: Plan) -> None:
        self._exhausted = 0
        self._goal, self._explores = plan.goal, plan.explores
        self._pilot.follow(plan.path)

    def _note_lookouts(self, teammates: tuple[Teammate, ...]) -> None:
        """Remember where a teammate stands with no goal: what is unknown from there stays so.

        Forgotten as soon as it is out of range, that frontier would call this robot back, only to
        be left again when the two can hear each other.
        """
        for mate in teammates:
            if mate.in_range and mate.goal is None and mate.age_ticks <= FRESH_TICKS:
                self._refusals.note_seen(mate.pose)

    def _stand(self) -> None:
        self._goal = None
        self._pilot.follow(NO_PATH)

    def _note_exhausted(self, tick: int) -> None:
        self._exhausted += 1
        self._plan_due = tick
        if self._refusals.retry():
            self._exhausted = 0
        self.finished = self._exhausted >= 2

    def _note(self, tick: int, steering: Steering) -> None:
        if self._goal is not None and (steering.gave_up or self._is_stalled(tick)):
            if self._explores:
                self._refusals.give_up(self._goal, steering.blocked_at)
            else:
                self._footprints.mark(tick, self._goal)
            self._stand()
            self._plan_due = tick
        if steering.wants_plan:
            self._plan_due = tick

    def _is_stalled(self, tick: int) -> bool:
        if self._goal is None or self._pilot.recovering or not len(self._pilot.path):
            return False
        return self._refusals.is_stalled(tick, self._goal, self._pilot.remaining_m)

    def _activity(self) -> str:
        if self.finished:
            if self._refusals.given_up:
                return f"done: gave up on {len(self._refusals.given_up)} places out of reach"
            return "done: nothing reachable is left"
        if self._goal is None:
            return f"standing: {self._reason}"
        return f"exploring: {self._reason}" if self._explores else self._reason
