"""Driving: along the path, and out of trouble where the path cannot be driven."""

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
from robot.explore.policy import Teammate
from robot.explore.recovery import Kind, Manoeuvre, Recovery, blocking_teammate
from robot.explore.retreat import Retreat, find_retreat
from robot.jobs import Jobs
from robot.perception.odometry import Motion
from robot.perception.scan import LaserScan

RETREAT_DELAY_TICKS = 3
MATE_FRESH_TICKS = 25
CROWDED_M, CROWDED_S = 0.9, 2.0
BACK_UP_MPS, TURN_RPS = -0.15, 0.8
# Encoders are noisy; the drive does what it was told unless it is blocked.
TRUSTED_MPS, TRUSTED_RPS = 0.15, 0.5
# Half the width over which near ranges are smoothed: what is narrower may be lost to the
# follower until it is closer, so no wider than the noise makes it worth.
NOISY_SIGMA_M, NOISY_SPREAD_M, SPREAD_M = 0.03, 0.06, 0.015
# Neighbouring ranges that differ by more than this and so many standard deviations are of
# different surfaces.
SAME_M, SAME_SIGMAS = 0.01, 4.0


class GridProvider(Protocol):
    """Who can give the joint map; asked only when a plan starts."""

    def snapshot(self) -> OccupancyGrid:
        """The joint map with the latest scan, not written to any more."""

    def lookouts(self) -> FloatArray:
        """Where (n×2, m) the scans on the map were taken."""

    def meeting_place(self) -> Pose2 | None:
        """Where to go to meet a teammate (see `View`)."""


@dataclass(frozen=True, slots=True)
class Steering:
    """A command; `words` say what recovery is doing, empty while the path is followed.

    `wants_plan`: the path is used up. `gave_up`: the goal cannot be reached; `blocked_at` (m): the
    spot on the way that is too tight, if that is why."""

    command: DriveCommand
    words: str = ""
    wants_plan: bool = False
    gave_up: bool = False
    blocked_at: tuple[float, float] | None = None


class Pilot:
    """Follower and recovery of one robot."""

    def __init__(self, config: RobotConfig, jobs: Jobs) -> None:
        self._config = config
        self._jobs = jobs
        self._follower = Follower(config.body)
        self._recovery = Recovery(config.name, config.tick_s)
        sigma = config.lidar.sigma_range_m(0.5)
        self._spread_m = NOISY_SPREAD_M if sigma > NOISY_SIGMA_M else SPREAD_M
        self._same_m = SAME_SIGMAS * sigma + SAME_M
        self._tick: int | None = None
        self._speed = (0.0, 0.0)
        self._points: FloatArray = NO_PATH
        self._crowded_since: int | None = None
        self._tightest: tuple[float, float] | None = None

    @property
    def path(self) -> FloatArray:
        return self._follower.path

    @property
    def remaining_m(self) -> float:
        return self._follower.remaining_m

    @property
    def arrived(self) -> bool:
        return self._follower.arrived

    @property
    def recovering(self) -> bool:
        """Whether recovery has the wheel; a new path has to wait."""
        return self._recovery.manoeuvre is not None

    def follow(self, path: FloatArray) -> None:
        """Take a new path (n×2, m), unless recovery is under way."""
        if not self.recovering:
            self._follower.follow(path)

    def step(
        self,
        tick: int,
        pose: Pose2,
        motion: Motion,
        scan: LaserScan | None,
        goal: Pose2 | None,
        grids: GridProvider,
        teammates: tuple[Teammate, ...],
    ) -> Steering:
        """The command for the next tick. Without a `goal` the robot has nothing to do here and
        makes room for whoever comes close."""
        self._perceive(tick, motion, scan)
        for retreat in self._jobs.landed("retreat", tick):
            self._consider(tick, retreat, obliging=goal is None)
        steering = self._steer(tick, pose, goal, grids, teammates)
        self._speed = self._reached(steering.command)
        return steering

    def _reached(self, command: DriveCommand) -> tuple[float, float]:
        """The speed that the drive reaches by the next tick, within its accelerations."""
        body, dt = self._config.body, self._config.tick_s
        forward, turn = self._speed
        gain, spin = body.max_acceleration_mps2 * dt, body.max_turn_acceleration_rps2 * dt
        return (
            forward + min(max(command.forward_mps - forward, -gain), gain),
            turn + min(max(command.turn_rps - turn, -spin), spin),
        )

    def _perceive(self, tick: int, motion: Motion, scan: LaserScan | None) -> None:
        """Bring the present speed and the scan's points up to date."""
        dt = self._config.tick_s * (1 if self._tick is None else max(1, tick - self._tick))
        self._tick = tick
        moved = motion.T_before_now
        forward, turn = moved.x / dt, moved.theta / dt
        if abs(forward - self._speed[0]) > TRUSTED_MPS or abs(turn - self._speed[1]) > TRUSTED_RPS:
            self._speed = (forward, turn)
        if scan is None:
            self._points = moved.inverse().apply(self._points)
        else:
            self._points = steady_points(
                scan.ranges, scan.angles, NEAR_M, self._spread_m, self._same_m
            )

    def _steer(
        self,
        tick: int,
        pose: Pose2,
        goal: Pose2 | None,
        grids: GridProvider,
        teammates: tuple[Teammate, ...],
    ) -> Steering:
        mates = _seen_from(pose, teammates)
        if self._recovery.manoeuvre is None:
            self._notice_trouble(tick, pose, goal, grids, teammates)
        manoeuvre = self._recovery.manoeuvre
        if manoeuvre is None:
            return Steering(self._follow(pose, mates))
        if self._recovery.is_over(tick, pose, self._follower.arrived, teammates):
            self._recovery.end()
            self._follower.follow(NO_PATH)
            command = self._follow(pose, mates)
            if manoeuvre.kind is not Kind.GIVE_UP:
                return Steering(command, wants_plan=True)
            return Steering(command, wants_plan=True, gave_up=True, blocked_at=self._tightest)
        return Steering(self._manoeuvre(pose, manoeuvre, mates), _words(manoeuvre))

    def _notice_trouble(
        self,
        tick: int,
        pose: Pose2,
        goal: Pose2 | None,
        grids: GridProvider,
        teammates: tuple[Teammate, ...],
    ) -> None:
        if goal is None:
            mate = self._crowding(tick, pose, teammates)
        else:
            going = len(self._follower.path) > 0 and not self._follower.arrived
            if not self._recovery.is_stuck(tick, pose, going):
                return
            mate = blocking_teammate(pose, self._follower.ahead(), teammates)
            self._tightest = self._follower.tightest(pose, self._points) if mate is None else None
            self._recovery.begin(tick, pose, self._points, mate)
            self._follower.follow(NO_PATH)
        if mate is not None and not self._jobs.pending("retreat"):
            self._jobs.start(
                "retreat", tick, RETREAT_DELAY_TICKS, find_retreat, grids.snapshot(),
                self._config.body, pose, goal, mate.name, mate.pose, mate.goal,
            )  # fmt: skip

    def _crowding(self, tick: int, pose: Pose2, teammates: tuple[Teammate, ...]) -> Teammate | None:
        """The teammate with somewhere to go that has been close by for a while, if any."""
        near = [
            mate
            for mate in teammates
            if mate.goal is not None
            and mate.age_ticks <= MATE_FRESH_TICKS
            and pose.distance_to(mate.pose) <= CROWDED_M
        ]
        if not near:
            self._crowded_since = None
            return None
        if self._crowded_since is None:
            self._crowded_since = tick
        if (tick - self._crowded_since) * self._config.tick_s < CROWDED_S:
            return None
        self._crowded_since = None
        return min(near, key=lambda mate: (pose.distance_to(mate.pose), mate.name))

    def _consider(self, tick: int, retreat: Retreat, obliging: bool) -> None:
        if self._recovery.make_room(tick, retreat, obliging):
            self._follower.follow(retreat.way)

    def _follow(self, pose: Pose2, mates: FloatArray) -> DriveCommand:
        dt = self._config.tick_s
        return self._follower.step(pose, self._points, mates, self._speed, dt)

    def _manoeuvre(self, pose: Pose2, manoeuvre: Manoeuvre, mates: FloatArray) -> DriveCommand:
        if manoeuvre.kind is Kind.GIVE_WAY:
            return self._follow(pose, mates)
        if manoeuvre.kind is Kind.BACK_UP:
            wanted = (BACK_UP_MPS, 0.0)
        elif manoeuvre.kind is Kind.TURN:
            turn = wrap_angle(manoeuvre.heading - pose.theta)
            wanted = (0.0, math.copysign(min(TURN_RPS, 2.0 * abs(turn)), turn))
        else:
            return STOP
        dt = self._config.tick_s
        return self._follower.drive(wanted, self._points, mates, self._speed, dt)


def _words(manoeuvre: Manoeuvre) -> str:
    if manoeuvre.mate:
        return f"{manoeuvre.kind.value} {manoeuvre.mate}"
    return f"{manoeuvre.kind.value}: the way is blocked"


def _seen_from(pose: Pose2, teammates: tuple[Teammate, ...]) -> FloatArray:
    """Centres (k×2) of teammates heard or seen lately, in the robot's frame."""
    fresh = [(m.pose.x, m.pose.y) for m in teammates if m.age_ticks <= MATE_FRESH_TICKS]
    return pose.inverse().apply(np.array(fresh, dtype=np.float64).reshape(-1, 2))
