"""What a robot is told about itself: its body, its sensors, its radio and its team.

The world answers `robot/<name>/config` with a `RobotConfig`; a brain is made from it and from
nothing else. Units stand in the names; angles are radians.
"""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field, StringConstraints

from protocol.model import Message, Model
from protocol.pose import Pose2

RobotName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_-]{0,31}$")]

BROADCAST = "*"
MAX_FRAME_BYTES = 1400


class PoseModel(Model):
    """A pose as configuration and messages carry it."""

    x_m: float
    y_m: float
    theta_rad: float

    def to_pose(self) -> Pose2:
        return Pose2(self.x_m, self.y_m, self.theta_rad)

    @staticmethod
    def of(pose: Pose2) -> "PoseModel":
        return PoseModel(x_m=pose.x, y_m=pose.y, theta_rad=pose.theta)


class BodyConfig(Model):
    """A disc with a drive: how it moves and what its encoders count."""

    drive: Literal["differential"] = "differential"
    radius_m: float = Field(0.20, gt=0.0, le=2.0)
    max_speed_mps: float = Field(0.6, gt=0.0, le=10.0)
    max_turn_rate_rps: float = Field(1.5, gt=0.0, le=20.0)
    max_acceleration_mps2: float = Field(1.2, gt=0.0, le=50.0)
    max_turn_acceleration_rps2: float = Field(5.0, gt=0.0, le=200.0)
    wheel_base_m: float = Field(0.30, gt=0.0, le=4.0)
    metres_per_count: float = Field(0.0005, gt=0.0, le=0.1)
    encoder_noise: float = Field(
        0.03,
        ge=0.0,
        le=1.0,
        description="standard deviation of a wheel increment, as a share of it",
    )
    slip_rate_hz: float = Field(
        0.02, ge=0.0, le=10.0, description="slip events per wheel and second of driving"
    )
    slip_m: float = Field(
        0.02,
        ge=0.0,
        le=1.0,
        description="standard deviation of what a slip adds to a wheel's count",
    )


class LidarConfig(Model):
    """A range finder at the robot's centre; eq. 14 of the paper is its error model.

    Beam i points to `angle_min_rad + i * increment_rad` in the robot's frame (x forward, y left).
    """

    beams: int = Field(257, ge=3, le=4096)
    field_of_view_rad: float = Field(2.0 * math.pi, gt=0.0, le=2.0 * math.pi)
    angle_min_rad: float = Field(-math.pi, ge=-2.0 * math.pi, le=2.0 * math.pi)
    min_range_m: float = Field(0.1, ge=0.0)
    max_range_m: float = Field(12.0, gt=0.0, le=1000.0)
    every_ticks: int = Field(1, ge=1)
    noise: Literal["modern", "paper", "none"] = "modern"

    @property
    def increment_rad(self) -> float:
        """A full turn has as many gaps as beams, any narrower field one fewer."""
        full = self.field_of_view_rad >= 2.0 * math.pi - 1e-9
        return self.field_of_view_rad / (self.beams if full else self.beams - 1)

    def sigma_range_m(self, range_m: float) -> float:
        """σ_r of eq. 14 at a true range: modern 0.01 m + 0.005 r, paper var_r = 0.01 m · r."""
        if self.noise == "modern":
            return 0.01 + 0.005 * range_m
        return math.sqrt(0.01 * max(range_m, 0.0)) if self.noise == "paper" else 0.0

    @property
    def sigma_angle_rad(self) -> float:
        """σ_θ of eq. 14: modern 0.1°, paper var_θ = 2 deg²."""
        degrees = {"modern": 0.1, "paper": math.sqrt(2.0), "none": 0.0}[self.noise]
        return math.radians(degrees)


class SightingConfig(Model):
    """A sensor that sees teammates in line of sight: range, bearing and who it is."""

    max_range_m: float = Field(12.0, gt=0.0)
    sigma_range_m: float = Field(0.03, ge=0.0)
    sigma_bearing_rad: float = Field(math.radians(0.5), ge=0.0)


class RadioConfig(Model):
    """What a robot may know of its radio; the gate itself is the world's."""

    range_m: float = Field(10.0, ge=0.0, description="d: nothing is delivered beyond it")
    bytes_per_tick: int = Field(
        12_000, ge=0, description="capacity of one directed pair of robots in one tick"
    )


class RobotConfig(Message):
    """Everything a brain is made from."""

    SCHEMA: ClassVar[str] = "robot-config"

    name: RobotName
    team: tuple[RobotName, ...] = Field(description="all robots of the run, this one among them")
    seed: int = Field(0, ge=0, le=2**63 - 1)
    tick_s: float = Field(0.1, gt=0.0, le=10.0)
    start: PoseModel | None = Field(None, description="in the team's frame; none if unknown")
    body: BodyConfig = BodyConfig()
    lidar: LidarConfig = LidarConfig()
    sightings: SightingConfig = SightingConfig()
    radio: RadioConfig = RadioConfig()
    engine: str = "graph"
    policy: str = "frontier"
    run: Annotated[str, StringConstraints(max_length=64)] = Field(
        "", description="tells journals of this run from those of others"
    )
    returned: bool = Field(
        False, description="it was in this run before, and is not where it started"
    )
