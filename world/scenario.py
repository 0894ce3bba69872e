"""A scenario: everything that decides a run. The same scenario gives the same run."""

from typing import Literal

from pydantic import Field, model_validator

from protocol.config import (
    BodyConfig,
    LidarConfig,
    PoseModel,
    RadioConfig,
    RobotName,
    SightingConfig,
)
from protocol.model import Model


class RobotSpec(Model):
    """One robot of the team; without a start, the seed draws one."""

    name: RobotName
    start: PoseModel | None = None
    engine: str = "graph"
    policy: str = "frontier"


class GateConfig(RadioConfig):
    """The radio as the world plays it."""

    model: Literal["disc", "line-of-sight", "shadowing"] = Field(
        "disc", description="what weakens a link within range_m: nothing, walls, or shadowing"
    )
    path_loss_exponent: float = Field(
        3.0, ge=1.0, le=8.0, description="2 in free space; not of the disc"
    )
    wall_loss_db_per_m: float = Field(
        25.0, ge=0.0, le=1000.0, description="of line-of-sight: 0.15 m of wall take 3.75 dB"
    )
    shadowing_sigma_db: float = Field(
        4.0, ge=0.0, le=30.0, description="of shadowing: standard deviation of the loss"
    )
    shadowing_length_m: float = Field(
        3.0, ge=0.1, le=1000.0, description="of shadowing: distance over which it changes"
    )
    loss: float = Field(0.0, ge=0.0, le=1.0, description="probability that a frame is lost")
    latency_ticks: int = Field(1, ge=1, le=10_000, description="ticks from sending to hearing")


class PaceConfig(Model):
    """Lockstep: the world waits for every action. Real time: nobody waits."""

    mode: Literal["lockstep", "realtime"] = "lockstep"
    factor: float = Field(1.0, gt=0.0, le=1000.0, description="simulated per wall second")
    deadline_s: float = Field(5.0, gt=0.0, description="wall time until a robot counts as stalled")
    dead_man_s: float = Field(
        0.5, gt=0.0, description="age at which a drive command stops counting"
    )
    roster_s: float = Field(
        60.0,
        gt=0.0,
        description="wall time that tick 0 waits for all robots; then real time begins",
    )


class Scenario(Model):
    """A run in full. `map` is the name of a shipped map or the path of a map_server YAML file."""

    map: str = "office"
    seed: int = Field(0, ge=0, le=2**63 - 1)
    robots: tuple[RobotSpec, ...] = (
        RobotSpec(name="r1"),
        RobotSpec(name="r2"),
        RobotSpec(name="r3"),
    )
    starts: Literal["known", "same", "unknown"] = Field(
        "unknown",
        description="whether robots are told where they start in the team's frame, all start "
        "beside the first one and are told where in its frame, or are told nothing and find out",
    )
    tick_s: float = Field(0.1, gt=0.0, le=10.0)
    max_sim_s: float = Field(1800.0, gt=0.0, description="simulated time after which a run ends")
    body: BodyConfig = BodyConfig()
    lidar: LidarConfig = LidarConfig()
    sightings: SightingConfig = SightingConfig()
    radio: GateConfig = GateConfig()
    pace: PaceConfig = PaceConfig()

    @model_validator(mode="after")
    def _names_differ(self) -> "Scenario":
        names = [robot.name for robot in self.robots]
        if not names:
            raise ValueError("a scenario needs at least one robot")
        if len(set(names)) != len(names):
            raise ValueError(f"two robots have the same name: {', '.join(names)}")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(robot.name for robot in self.robots)
