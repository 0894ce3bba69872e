"""Differential drives: limits, motion over a tick, contact, and what the encoders count."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from maps.grid import BoolArray
from protocol.config import BodyConfig
from protocol.pose import FloatArray
from world import disc_kernels, neighbour_kernels
from world.noise import Noise
from world.terrain import Terrain

# Beside a wall or a robot, motion is checked each so many metres; contacts are finer by 2^12.
STRIDE_M = 0.01
# A robot that was stopped is in the same contact until it is this far from where it was stopped.
CONTACT_ENDS_M = 0.02


class Drives:
    """The true motion of all robots. `poses` (n×3) in m and rad, in the world frame."""

    TRANSIENT = ("terrain",)

    def __init__(
        self, terrain: Terrain, body: BodyConfig, names: Sequence[str], starts: FloatArray
    ) -> None:
        self.terrain = terrain
        self._body = body
        self._names = tuple(names)
        self.poses = np.array(starts, dtype=np.float64)
        self.collisions = np.zeros(len(names), dtype=np.int64)
        """Contacts that a robot ran into so far; one that is run into counts none."""
        self.velocities = np.zeros((len(names), 2))
        """Forward (m/s) and turn (rad/s), n×2."""
        self._wheels = np.zeros((len(names), 2))  # m that the encoders saw: left, right
        self._contacts = np.full((len(names), 2), np.inf)  # where each was last stopped (m)

    @property
    def encoders(self) -> npt.NDArray[np.int64]:
        """Cumulative counts (n×2: left, right)."""
        return np.floor(self._wheels / self._body.metres_per_count).astype(np.int64)

    def step(self, commands: FloatArray, tick: int, tick_s: float, noise: Noise) -> None:
        """Move for one tick under commands (n×2: m/s forward, rad/s)."""
        self.velocities = self._accelerate(commands, tick_s)
        motions = self.velocities * tick_s
        blocked = self._move(motions)
        self._count_contacts(blocked)
        self._turn_wheels(motions, tick, tick_s, noise)

    def _accelerate(self, commands: FloatArray, tick_s: float) -> FloatArray:
        """The velocities that the body reaches within its limits of speed and acceleration."""
        body = self._body
        top = np.array([body.max_speed_mps, body.max_turn_rate_rps])
        change = tick_s * np.array([body.max_acceleration_mps2, body.max_turn_acceleration_rps2])
        wanted = np.clip(commands, -top, top)
        return self.velocities + np.clip(wanted - self.velocities, -change, change)

    def _move(self, motions: FloatArray) -> BoolArray:
        """Move the discs along their arcs; True (n) for those that something stopped."""
        terrain = self.terrain
        poses = terrain.to_cells(self.poses)
        motions = motions / np.array([terrain.cell, 1.0])
        blocked = np.zeros(len(poses), dtype=bool)
        radius = self._body.radius_m / terrain.cell
        touch = 2.0 * (radius + np.abs(motions[:, 0]).max())
        starts, others = neighbour_kernels.neighbours(poses, touch)
        disc_kernels.drive_all(
            terrain.solid,
            terrain.clearance,
            poses,
            motions,
            starts,
            others,
            radius,
            STRIDE_M / terrain.cell,
            blocked,
        )
        self.poses = terrain.to_metres(poses)
        return blocked

    def _count_contacts(self, blocked: BoolArray) -> None:
        away = np.hypot(*(self.poses[:, :2] - self._contacts).T) > CONTACT_ENDS_M
        self.collisions = self.collisions + (blocked & away)
        self._contacts[away] = np.inf
        begun = blocked & away
        self._contacts[begun] = self.poses[begun, :2]

    def _turn_wheels(self, motions: FloatArray, tick: int, tick_s: float, noise: Noise) -> None:
        """Wheels turn as driven, also where the robot is held: what they count is not motion."""
        body = self._body
        half_base = 0.5 * body.wheel_base_m
        travel = motions[:, :1] + motions[:, 1:] * np.array([-half_base, half_base])
        draws = noise.stream(self._names, "encoders").normals(tick, 4).reshape(-1, 2, 2)
        luck = noise.stream(self._names, "slips").uniforms(tick, 2)
        # k slips of standard deviation s together are one of s √k. Who stands does not slip.
        slips = poisson(luck, body.slip_rate_hz * tick_s) * (travel != 0.0)
        self._wheels += travel * (1.0 + body.encoder_noise * draws[:, 0])
        self._wheels += body.slip_m * np.sqrt(slips) * draws[:, 1]


def poisson(uniforms: FloatArray, mean: float) -> FloatArray:
    """Poisson numbers of a mean up to a few hundred, from uniform ones in [0, 1) by inversion."""
    counts = np.zeros_like(uniforms)
    term = total = math.exp(-mean)
    while term > 0.0 and (more := uniforms >= total).any():
        counts += more
        term *= mean / counts.max()
        total += term
    return counts
