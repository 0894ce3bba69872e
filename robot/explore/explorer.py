"""Deciding where to go and driving there: the stateful core that the brain steps each tick.

About once a second a plan is made as a job on a snapshot of the joint map; between plans the
follower drives along the last path, and recovery takes over when that gets nowhere. A robot is
finished when two plans in a row found nothing left, goals that had been given up included. It
stays finished unless, later, at least `NOTABLE_M` of reachable frontier has appeared (a teammate
brought a part of the map that it had not finished itself).
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from maps.grid import OccupancyGrid
from protocol.config import RobotConfig
from protocol.messages import STOP, DriveCommand
from protocol.pose import FloatArray, Pose2, wrap_angle
from robot.explore.follower import NEAR_M, Follower
from robot.explore.follower_kernels import steady_points
from robot.explore.planner import NO_PATH
from robot.explore.policies import make_policy
from robot.explore.policy import Plan, Policy, Teammate, View
from robot.explore.recovery import BACK_UP_MPS, TURN_RPS, Kind, Manoeuvre, Recovery
from robot.explore.trail import Trail
from robot.jobs import Jobs
from robot.perception.odometry import Motion
from robot.perception.scan import LaserScan

PLAN_DELAY_TICKS = 3
PLAN_EVERY_S, LOOK_AGAIN_S = 1.0, 5.0
VISITED_M = 0.30
WAY_IS_FREE_M = 1.6
NOTABLE_M = 1.0
CROWDED_M, CROWDED_S = 0.9, 3.0
MATE_FRESH_TICKS = 10
# Encoders are noisy; the drive does what it was told unless it is blocked.
TRUSTED_MPS, TRUSTED_RPS = 0.15, 0.5
# Half the width over which near ranges are smoothed: what is narrower may be lost to the
# follower until it is closer, so no wider than the noise makes it worth.
NOISY_SIGMA_M, NOISY_SPREAD_M, SPREAD_M = 0.03, 0.06, 0.015


class GridProvider(Protocol):
    """Who can give the joint map; asked only when a plan starts."""

    def snapshot(self) -> OccupancyGrid:
        """The joint map with the latest scan, not written to any more."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What the robot does next, and what of it others may want to know."""

    drive: DriveCommand
    goal: Pose2 | None
    path: FloatArray
    activity: str
    finished: bool
    frontier_m: float


class Explorer:
    """Exploration of one robot."""

    TRANSIENT = ("_policy",)

    def __init__(self, config: RobotConfig, jobs: Jobs) -> None:
        self._config = config
        self._jobs = jobs
        self._policy: Policy | None = make_policy(config.policy)
        self._follower = Follower(config.body)
        self._recovery = Recovery(config.name, config.tick_s)
        self._trail = Trail()
        noisy = config.lidar.sigma_range_m(0.5) > NOISY_SIGMA_M
        self._spread_m = NOISY_SPREAD_M if noisy else SPREAD_M
        self._tick: int | None = None
        self._speed = (0.0, 0.0)
        self._points: FloatArray = NO_PATH
        self._goal: Pose2 | None = None
        self._reason = "waiting for a first map"
        self._planned_from: Pose2 | None = None
        self._plan_due = 0
        self._frontier_m = 0.0
        self._visited: list[Pose2] = []
        self._given_up: list[Pose2] = []
        self._retried = False
        self._exhausted = 0
        self._crowded_since: int | None = None
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
        dt = self._perceive(tick, pose, motion, scan)
        for plan in self._jobs.landed("plan", tick):
            self._take(tick, pose, plan)
        self._start_plan(tick, pose, grids, teammates)
        command, activity = self._drive(tick, pose, teammates, dt)
        self._speed = (command.forward_mps, command.turn_rps)
        return Decision(
            command, self._goal, self._follower.path, activity, self.finished, self._frontier_m
        )

    def _perceive(self, tick: int, pose: Pose2, motion: Motion, scan: LaserScan | None) -> float:
        """Bring speed, scan points and trail up to date; returns the seconds since last time."""
        dt = self._config.tick_s * (max(1, tick - self._tick) if self._tick is not None else 1)
        self._tick = tick
        moved = motion.T_before_now
        forward, turn = moved.x / dt, moved.theta / dt
        if abs(forward - self._speed[0]) > TRUSTED_MPS or abs(turn - self._speed[1]) > TRUSTED_RPS:
            self._speed = (forward, turn)
        if scan is not None:
            self._points = steady_points(scan.ranges, scan.angles, NEAR_M, self._spread_m)
        else:
            self._points = moved.inverse().apply(self._points)
        gaps = np.hypot(self._points[:, 0], self._points[:, 1])
        self._trail.step(pose, float(gaps.min()) if len(gaps) else math.inf)
        return self._config.tick_s

    def _start_plan(
        self, tick: int, pose: Pose2, grids: GridProvider, teammates: tuple[Teammate, ...]
    ) -> None:
        arrived = self._goal is not None and self._follower.arrived
        if self._jobs.pending("plan") or (tick < self._plan_due and not arrived):
            return
        if self._policy is None:
            self._policy = make_policy(self._config.policy)
        refused = [(p.x, p.y) for p in (*self._visited, *self._given_up)]
        view = View(
            self._config.name, tick, grids.snapshot(), pose, self._config.body, teammates,
            np.array(refused, dtype=np.float64).reshape(-1, 2), self._goal,
        )  # fmt: skip
        self._jobs.start("plan", tick, PLAN_DELAY_TICKS, self._policy.plan, view)
        self._planned_from = pose
        every = LOOK_AGAIN_S if self.finished else PLAN_EVERY_S
        self._plan_due = tick + round(every / self._config.tick_s)

    def _take(self, tick: int, pose: Pose2, plan: Plan) -> None:
        self._frontier_m, self._reason = plan.frontier_m, plan.reason
        if self.finished and (plan.goal is None or plan.frontier_m < NOTABLE_M):
            return
        self.finished = False
        if plan.goal is None:
            self._goal = None
            self._follower.follow(NO_PATH)
            if plan.exhausted:
                self._note_exhausted(tick, pose)
            return
        self._exhausted = 0
        if self._planned_from is not None and (
            plan.goal.distance_to(self._planned_from) <= VISITED_M
        ):
            # Seen from here, and still unknown: no ray gets there.
            self._visited.append(plan.goal)
            self._plan_due = tick
            return
        self._goal = plan.goal
        self._follower.follow(plan.path)

    def _note_exhausted(self, tick: int, pose: Pose2) -> None:
        self._exhausted += 1
        self._plan_due = tick
        if self._given_up and not self._retried:
            self._given_up, self._retried, self._exhausted = [], True, 0
        elif self._exhausted >= 2:
            self.finished = True
            # Out of doors and bottlenecks, where it would be in the way of those still at work.
            self._follower.follow(self._trail.to_room(pose, pose, 0.0))

    def _drive(
        self, tick: int, pose: Pose2, teammates: tuple[Teammate, ...], dt: float
    ) -> tuple[DriveCommand, str]:
        mates = _seen_from(pose, teammates)
        self._make_room_when_crowded(tick, pose, teammates)
        manoeuvre = self._recovery.manoeuvre
        if manoeuvre is None:
            going = len(self._follower.path) > 0 and not self._follower.arrived
            if self._recovery.is_stuck(tick, pose, going):
                ahead = self._follower.path[-1] if self._goal is None else self._follower.ahead()
                manoeuvre = self._recovery.begin(
                    tick, pose, ahead, self._points, self._trail, teammates
                )
                self._begin(tick, manoeuvre)
        if manoeuvre is not None and self._is_over(tick, pose, manoeuvre, teammates):
            self._recovery.end()
            self._follower.follow(NO_PATH)
            self._plan_due = tick
            manoeuvre = None
        if manoeuvre is not None:
            return self._recover(pose, manoeuvre, mates, dt)
        command = self._follower.step(pose, self._points, mates, self._speed, dt)
        return command, self._activity()

    def _activity(self) -> str:
        if self.finished:
            return "done: nothing reachable is left"
        if self._goal is None:
            return f"standing: {self._reason}"
        return f"exploring: {self._reason}"

    def _make_room_when_crowded(
        self, tick: int, pose: Pose2, teammates: tuple[Teammate, ...]
    ) -> None:
        """A robot that stands finished in a teammate's way moves out of it."""
        near = [
            mate
            for mate in teammates
            if mate.goal is not None
            and mate.age_ticks <= MATE_FRESH_TICKS
            and pose.distance_to(mate.pose) <= CROWDED_M
        ]
        if not self.finished or not near or self._recovery.manoeuvre is not None:
            self._crowded_since = None
            return
        if self._crowded_since is None:
            self._crowded_since = tick
        if (tick - self._crowded_since) * self._config.tick_s >= CROWDED_S:
            mate = min(near, key=lambda mate: (pose.distance_to(mate.pose), mate.name))
            self._begin(tick, self._recovery.make_room(tick, pose, self._trail, mate))

    def _begin(self, tick: int, manoeuvre: Manoeuvre) -> None:
        if manoeuvre.kind is Kind.GIVE_UP and self._goal is not None:
            self._given_up.append(self._goal)
            self._goal = None
        self._follower.follow(NO_PATH if manoeuvre.path is None else manoeuvre.path)
        self._plan_due = tick + 10_000_000 if manoeuvre.kind is not Kind.GIVE_UP else tick

    def _is_over(
        self, tick: int, pose: Pose2, manoeuvre: Manoeuvre, teammates: tuple[Teammate, ...]
    ) -> bool:
        if tick >= manoeuvre.until:
            return True
        if manoeuvre.kind is Kind.TURN:
            return abs(wrap_angle(manoeuvre.heading - pose.theta)) < 0.2
        mate = next((m for m in teammates if m.name == manoeuvre.mate), None)
        if manoeuvre.kind is Kind.WAIT:
            return mate is None or pose.distance_to(mate.pose) > WAY_IS_FREE_M
        return False

    def _recover(
        self, pose: Pose2, manoeuvre: Manoeuvre, mates: FloatArray, dt: float
    ) -> tuple[DriveCommand, str]:
        points, speed = self._points, self._speed
        words = f"{manoeuvre.kind.value} {manoeuvre.mate}".strip()
        if manoeuvre.kind is Kind.GIVE_WAY:
            return self._follower.step(pose, points, mates, speed, dt), words
        wanted = (0.0, 0.0)
        if manoeuvre.kind is Kind.BACK_UP:
            wanted = (BACK_UP_MPS, 0.0)
        elif manoeuvre.kind is Kind.TURN:
            turn = wrap_angle(manoeuvre.heading - pose.theta)
            wanted = (0.0, math.copysign(min(TURN_RPS, 2.0 * abs(turn)), turn))
        if wanted == (0.0, 0.0):
            return STOP, words
        return self._follower.drive(wanted, points, mates, speed, dt), f"{words}: blocked"


def _seen_from(pose: Pose2, teammates: tuple[Teammate, ...]) -> FloatArray:
    """Centres (k×2) of teammates heard or seen lately, in the robot's frame."""
    fresh = [(m.pose.x, m.pose.y) for m in teammates if m.age_ticks <= MATE_FRESH_TICKS]
    return pose.inverse().apply(np.array(fresh, dtype=np.float64).reshape(-1, 2))
