"""Following a path smoothly without touching anything.

A point some way ahead on the path (the carrot) gives the wanted speed and turn rate (regulated
pure pursuit); a dynamic window over what the drive can reach by the next tick picks the best
pair that leaves room to brake. Moving teammates get half of every gap: each robot keeps to its
own half, so that two of them cannot meet in the middle.
"""

import math

import numpy as np

from protocol.config import BodyConfig
from protocol.messages import STOP, DriveCommand
from protocol.pose import FloatArray, Pose2, wrap_angle
from robot.explore.follower_kernels import best_velocity
from robot.explore.planner import NO_PATH

NEAR_M = 1.2  # what is farther away cannot be reached within the window's look-ahead
SLOW_MARGIN_M, FAST_MARGIN_M = 0.01, 0.07
TEAMMATE_MARGIN_M = 0.10
MIN_LOOKAHEAD_M, LOOKAHEAD_S = 0.30, 0.7
LOOKAHEAD_SHARES = (1.0, 0.7, 0.45, 0.25)
TURN_FIRST_RAD, TURN_DONE_RAD = 1.0, 0.3
ROLLOUT_S = 1.2
WANTED_CLEARANCE_M = 0.25
ARRIVED_M = 0.15
TIGHT_AHEAD_M = 0.25, 0.8  # where on the path, from where it stopped, is what stopped a robot


class Follower:
    """Drives one body along one path at a time."""

    def __init__(self, body: BodyConfig) -> None:
        self._body = body
        self._path: FloatArray = NO_PATH
        self._lengths: FloatArray = np.zeros(0)  # along the path, per point
        self._turning = False
        self.along_m = 0.0
        """How far along the path the robot is."""

    @property
    def path(self) -> FloatArray:
        return self._path

    @property
    def remaining_m(self) -> float:
        return float(self._lengths[-1]) - self.along_m if len(self._path) else 0.0

    @property
    def arrived(self) -> bool:
        return self.remaining_m <= ARRIVED_M

    def follow(self, path: FloatArray) -> None:
        """Take a new path (n×2, m); an empty one means to stand still."""
        self._path = np.array(path, dtype=np.float64)
        steps = np.hypot(*np.diff(self._path, axis=0).T) if len(path) > 1 else np.zeros(0)
        self._lengths = np.concatenate([[0.0], np.cumsum(steps)])
        self.along_m = 0.0

    def step(
        self,
        pose: Pose2,
        points: FloatArray,
        teammates: FloatArray,
        speed: tuple[float, float],
        dt: float,
    ) -> DriveCommand:
        """The command for the next `dt` seconds.

        `points` (n×2): the scan within `NEAR_M`; `teammates` (k×2): centres of robots like this
        one; both in the robot's frame. `speed`: forward (m/s) and turn (rad/s) as they are now.
        """
        obstacles = self._obstacles(points, teammates)
        if not len(self._path) or self.arrived:
            return self._select(obstacles, speed, (0.0, 0.0), (0.0, 0.0), dt)
        self._advance(pose)
        carrot = self._carrot(pose, obstacles, speed)
        wanted = self._pursue(carrot, obstacles)
        return self._select(obstacles, speed, wanted, (carrot[0], carrot[1]), dt)

    def drive(
        self,
        wanted: tuple[float, float],
        points: FloatArray,
        teammates: FloatArray,
        speed: tuple[float, float],
        dt: float,
    ) -> DriveCommand:
        """The safe command nearest to a wanted forward speed and turn rate, off any path."""
        x, y = wanted[0] * ROLLOUT_S, 0.0
        return self._select(self._obstacles(points, teammates), speed, wanted, (x, y), dt)

    def _obstacles(self, points: FloatArray, teammates: FloatArray) -> FloatArray:
        """Near obstacles (n×4) as the window takes them."""
        radius = self._body.radius_m
        obstacles = np.empty((len(points) + len(teammates), 4))
        obstacles[: len(points), :2] = points
        obstacles[: len(points), 2:] = radius
        mates = obstacles[len(points) :]
        mates[:, :2] = teammates
        mates[:, 2] = 2.0 * radius
        gaps = np.hypot(teammates[:, 0], teammates[:, 1]) - 2.0 * radius - TEAMMATE_MARGIN_M
        mates[:, 3] = 2.0 * radius + TEAMMATE_MARGIN_M + 0.5 * np.maximum(gaps, 0.0)
        return obstacles

    def _advance(self, pose: Pose2) -> None:
        """Move on along the path to its point nearest to the robot, not far from the last one."""
        window = np.abs(self._lengths - self.along_m) <= 1.0
        gaps = np.hypot(self._path[:, 0] - pose.x, self._path[:, 1] - pose.y)
        gaps[~window] = np.inf
        self.along_m = float(self._lengths[int(np.argmin(gaps))])

    def ahead(self) -> FloatArray:
        """Where (2, m) the path goes next."""
        point: FloatArray = self._points_at(np.array([self.along_m + MIN_LOOKAHEAD_M]))[0]
        return point

    def tightest(self, pose: Pose2, points: FloatArray) -> tuple[float, float]:
        """Where (x, y in m) the path ahead comes nearest to the scan (n×2, robot frame)."""
        way = self._points_at(self.along_m + np.arange(*TIGHT_AHEAD_M, 0.05))
        gaps = np.hypot(*(pose.inverse().apply(way)[:, None] - points[None]).transpose(2, 0, 1))
        x, y = way[int(np.argmin(gaps.min(axis=1, initial=NEAR_M)))].tolist()
        return x, y

    def _points_at(self, along: FloatArray) -> FloatArray:
        """Points (n×2, m) of the path at distances (n) along it."""
        return np.stack([np.interp(along, self._lengths, self._path[:, k]) for k in (0, 1)], -1)

    def _carrot(self, pose: Pose2, obstacles: FloatArray, speed: tuple[float, float]) -> FloatArray:
        """The point (2, robot frame) of the path to steer for: the farthest within look-ahead
        that the robot could go to straight. Round a corner it is nearer, or it would be cut."""
        lookahead = max(MIN_LOOKAHEAD_M, LOOKAHEAD_S * abs(speed[0]))
        carrots = pose.inverse().apply(
            self._points_at(self.along_m + lookahead * np.array(LOOKAHEAD_SHARES))
        )
        keep = np.minimum(obstacles[:, 2] + SLOW_MARGIN_M, np.hypot(*obstacles[:, :2].T) - 1e-6)
        for carrot in carrots:
            if np.all(_segment_gaps(carrot, obstacles[:, :2]) >= keep):
                return np.asarray(carrot, dtype=np.float64)
        return np.asarray(carrots[-1], dtype=np.float64)

    def _pursue(self, carrot: FloatArray, obstacles: FloatArray) -> tuple[float, float]:
        """Regulated pure pursuit: the arc through the carrot, slower in bends and near walls."""
        body = self._body
        bearing = math.atan2(carrot[1], carrot[0])
        self._turning = abs(bearing) > (TURN_DONE_RAD if self._turning else TURN_FIRST_RAD)
        if self._turning:
            rate = min(body.max_turn_rate_rps, 2.0 * abs(bearing))
            return 0.0, math.copysign(rate, bearing)
        distance = max(math.hypot(carrot[0], carrot[1]), 1e-3)
        curvature = 2.0 * math.sin(bearing) / distance
        gaps = np.hypot(obstacles[:, 0], obstacles[:, 1]) - obstacles[:, 2]
        gap = float(gaps.min()) if len(gaps) else NEAR_M
        limits = (
            body.max_speed_mps,
            0.15 + 1.5 * max(0.0, gap),
            body.max_turn_rate_rps * 0.7 / max(abs(curvature), 1e-6),
            math.sqrt(2.0 * 0.5 * body.max_acceleration_mps2 * max(self.remaining_m, 0.0)) + 0.05,
        )
        forward = min(limits)
        return forward, forward * curvature

    def _select(
        self,
        obstacles: FloatArray,
        speed: tuple[float, float],
        wanted: tuple[float, float],
        carrot: tuple[float, float],
        dt: float,
    ) -> DriveCommand:
        body = self._body
        forwards = _window(
            speed[0], wanted[0], body.max_acceleration_mps2 * dt, body.max_speed_mps, 7
        )
        turns = _window(
            speed[1], wanted[1], body.max_turn_acceleration_rps2 * dt, body.max_turn_rate_rps, 13
        )
        forward, turn, safe = best_velocity(
            obstacles, forwards, turns, wanted[0], wanted[1], carrot[0], carrot[1],
            body.max_speed_mps, body.max_turn_rate_rps, 0.9 * body.max_acceleration_mps2, dt,
            SLOW_MARGIN_M, FAST_MARGIN_M, ROLLOUT_S, WANTED_CLEARANCE_M,
        )  # fmt: skip
        if not safe:
            return self._brake(speed, dt)
        return DriveCommand(forward_mps=forward, turn_rps=turn)

    def _brake(self, speed: tuple[float, float], dt: float) -> DriveCommand:
        """Stop along the present arc, which was safe to stop on when it was chosen: a turn that
        ended before the drive does would leave it."""
        forward, turn = speed
        left = max(0.0, abs(forward) - self._body.max_acceleration_mps2 * dt)
        if left == 0.0:
            return STOP
        return DriveCommand(
            forward_mps=math.copysign(left, forward), turn_rps=turn * left / abs(forward)
        )


def _segment_gaps(end: FloatArray, points: FloatArray) -> FloatArray:
    """Distances (n, m) of points (n×2) from the segment between the origin and `end` (2)."""
    share = np.clip(points @ end / max(float(end @ end), 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(*(points - share[:, None] * end).T), dtype=np.float64)


def _window(now: float, wanted: float, change: float, most: float, count: int) -> FloatArray:
    """Velocities that the drive can reach by the next tick, the wanted one first if it is
    among them, else the nearest to it; zero too if it is within reach."""
    low, high = max(now - change, -most), min(now + change, most)
    if low > high:
        low = high = min(max(now, -most), most)
    first = [min(max(wanted, low), high)]
    if low <= 0.0 <= high:
        first.append(0.0)
    return np.concatenate([first, np.linspace(low, high, count)])


def bearing_to(pose: Pose2, x: float, y: float) -> float:
    """Direction (rad) of a point as seen from a pose."""
    return wrap_angle(math.atan2(y - pose.y, x - pose.x) - pose.theta)
