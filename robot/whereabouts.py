"""Where a robot and its teammates are, in the frame of the joint map."""

import numpy as np

from protocol.config import RobotConfig
from protocol.messages import Sense, Sighting
from protocol.pose import IDENTITY, Pose2
from robot.explore.policy import Teammate
from robot.slam.engine import Engine, Estimate
from robot.team.joint import Solution, anchor_pose, anchor_poses
from robot.team.standing import STRANGE_M
from robot.team.team import Team

FRESH_TICKS = 60  # a beacon older than this says nothing of where a teammate is
# So long a robot gets to a meeting place and waits there, once for each time it lost a teammate.
SEEK_TICKS = 1200
HERE_M = 1.0


class Whereabouts:
    """Of one robot: what its engine, its eyes and the team's beacons say, put together."""

    def __init__(self, config: RobotConfig, start: Pose2, engine: Engine, team: Team) -> None:
        self._engine = engine
        self._team = team
        self._stride_m = config.body.max_speed_mps * config.tick_s
        self.estimate = Estimate(start, np.zeros((3, 3)))
        """What the engine said last, in its own frame."""
        self._seen: dict[str, tuple[int, Pose2]] = {}  # when, and where from the robot
        self._contacts: dict[str, Pose2] = {}  # where this robot was when it heard each one last
        self._sought: dict[str, tuple[int, int]] = {}  # since when, after which beacon

    def note(self, sense: Sense) -> None:
        """Remember who is seen and who was heard, once the team has taken the frames in."""
        heard = {frame.sender for frame in sense.frames} & self._team.heard.keys()
        if heard:
            self._contacts.update(dict.fromkeys(heard, self.pose()))
        for sighting in sense.sightings:
            self._seen[sighting.robot] = (sense.tick, sighting.place)

    def own_anchors(self, solution: Solution) -> Solution:
        """The anchors of all lives of this robot that are placed: by the joint solution, or else by
        the engine alone, which knows of the present one."""
        own, graph = self._team.own_log, self._team.graph
        if own not in solution:
            return {own: self._engine.anchors}
        return {
            name: anchor_poses(log, solution[name])
            for name in solution
            if name.robot == own.robot and (log := graph.log(name)) is not None
        }

    def anchored(self) -> tuple[int, Pose2]:
        """The newest anchor in the journal, and the robot's pose relative to it."""
        nodes = self._engine.anchors
        log = self._team.graph.log(self._team.own_log)
        index = min(len(log.anchors) if log else 0, len(nodes)) - 1
        return index, Pose2.from_array(nodes[index]).inverse() @ self.estimate.pose

    def pose(self) -> Pose2:
        """The robot's pose."""
        index, T_anchor_base = self.anchored()
        own = self._team.own_log
        anchor = anchor_pose(self._team.graph.log(own), self._team.solution.get(own), index)
        return self.estimate.pose if anchor is None else anchor @ T_anchor_base

    def teammates(self, tick: int, pose: Pose2, names: tuple[str, ...]) -> tuple[Teammate, ...]:
        """Teammates as last seen from `pose`, or else as they last said of themselves."""
        in_range = self._team.gossip.in_range(tick)
        found = []
        for name in names:
            known = self._team.teammate_pose(name)
            heard = self._team.heard.get(name)
            seen_tick, T_base_mate = self._seen.get(name, (-1, IDENTITY))
            if tick == seen_tick:
                where, age = pose @ T_base_mate, 0
            elif known and heard and tick - heard.tick <= FRESH_TICKS:
                where, age = known[0], tick - heard.tick
            else:
                continue
            goal = known[1] if known else None
            found.append(Teammate(name, where, goal, age, name in in_range))
        return tuple(found)

    def sees_stranger(self, sense: Sense, pose: Pose2) -> bool:
        """Whether a robot is in sight from `pose` that is not where its last beacon and this map
        put it."""
        return any(self._is_astray(sense.tick, pose, seen) for seen in sense.sightings)

    def _is_astray(self, tick: int, pose: Pose2, seen: Sighting) -> bool:
        known = self._team.teammate_pose(seen.robot)
        if known is None:
            return True
        driven_m = (tick - self._team.heard[seen.robot].tick) * self._stride_m
        return known[0].distance_to(pose @ seen.place) > STRANGE_M + driven_m

    def meeting_place(self, tick: int, seeking: bool) -> Pose2 | None:
        """Where to go to meet a teammate out of earshot, while this robot does (`seeking`) or if it
        began to. None when it is there, and when there is nobody to be met or not at once."""
        for name in self._team.untold(tick):
            place, heard = self._place_for(name), self._team.heard[name].tick
            since, after = self._sought.get(name, (tick, -1))
            if after != heard or not seeking:
                since = tick
            self._sought[name] = since, heard
            if place is not None and tick - since <= SEEK_TICKS:
                return None if self.pose().distance_to(place) <= HERE_M else place
        return None

    def _place_for(self, name: str) -> Pose2 | None:
        """Where both look for each other: where the first of the two by name was when they heard
        each other last, as far as this robot knows that."""
        if self._team.own_log.robot < name:
            return self._contacts[name]
        known = self._team.teammate_pose(name)
        return known[0] if known else None
