"""The interface of every exploration policy.

A policy is asked now and then, as a job, where to go: `plan` is a pure function of a snapshot.
A new policy is one file with a class that has `plan`; `robot.explore.policies` finds it by name,
or by `path/to/file.py:ClassName`.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from maps.grid import OccupancyGrid
from protocol.config import BodyConfig
from protocol.pose import FloatArray, Pose2


@dataclass(frozen=True, slots=True)
class Teammate:
    """A teammate as last heard or seen, in this robot's map frame."""

    name: str
    pose: Pose2
    goal: Pose2 | None
    age_ticks: int
    in_range: bool


@dataclass(frozen=True, slots=True)
class View:
    """What a policy may look at: a snapshot, all in the robot's map frame.

    `grid` is the joint map. `refused` (n×2) are goals that could not be reached lately, or that
    were reached and showed nothing new. `goal` is where the robot is heading now, if anywhere.
    `blocked` (n×2) are spots that look open on the map and that the robot did not get through.
    `home` is where the robot started. `lookouts` (n×2) are where the scans on the map were taken,
    by whomever.
    `meeting_place`, if any, is where a teammate out of earshot looks for this robot, or is to be
    found, that has something to tell or to be told.
    `visits` (n×3) are places (x, y in m) and the tick when one of the team was last seen there.
    """

    name: str
    tick: int
    grid: OccupancyGrid
    pose: Pose2
    body: BodyConfig
    teammates: tuple[Teammate, ...]
    refused: FloatArray
    goal: Pose2 | None = None
    lookouts: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    visits: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    tick_s: float = 0.1
    blocked: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    home: Pose2 | None = None
    meeting_place: Pose2 | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """Where to go and how: `path` (n×2, m) from the robot to the goal, clear for its body.

    `goal` is None and `path` empty when there is nowhere to go; `exhausted` then says whether
    that is because nothing reachable is left to explore (and not because the way is blocked
    for the moment). `frontier_m` is the length of frontier that is left and can be reached.
    A goal that `explores` is a place to see something new from: once reached, or turned to and
    left again too often, it is not gone to any more. One that does not may be visited for ever.
    """

    goal: Pose2 | None
    path: FloatArray
    reason: str
    exhausted: bool
    frontier_m: float
    explores: bool = True


class Policy(Protocol):
    def plan(self, view: View) -> Plan:
        """Choose a goal and a path to it. Pure: no state, no clock, no random numbers."""
