"""Each robot's way, as it was and as the robot believed it to be, in the frame of the world."""

from dataclasses import dataclass

import numpy as np

from protocol.pose import IDENTITY, FloatArray, Pose2, compose
from station.observer import RunOutcome
from world.accuracy import Track as Matched
from world.accuracy import align_frames, align_team, largest_frame, match


@dataclass(frozen=True, slots=True)
class Belief:
    """What a robot answered about its way: `stamps` (n, s); poses and truth each n×3, aligned."""

    stamps: FloatArray
    true: FloatArray
    final: FloatArray
    online: FloatArray
    dead_reckoned: FloatArray

    def error_m(self, poses: FloatArray) -> FloatArray:
        """Distance (n) of poses from the truth."""
        apart = poses[:, :2] - self.true[:, :2]
        return np.asarray(np.hypot(apart[:, 0], apart[:, 1]), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Track:
    """One robot's way: `true` T×3 at `stamps` (T, s), until it died. No belief without an answer.

    `note` says what became of the robot, where that is not the ordinary.
    """

    name: str
    stamps: FloatArray
    true: FloatArray
    belief: Belief | None
    note: str


@dataclass(frozen=True, slots=True)
class Tracks:
    """The ways of all robots, in the scenario's order. Robots whose maps share a frame are under
    one alignment; the frame that most share, the robots `shared`, lies at `T_world_team`."""

    T_world_team: Pose2
    shared: tuple[str, ...]
    robots: tuple[Track, ...]


def matched(outcome: RunOutcome) -> dict[str, Matched]:
    """What robots answered of their ways beside the truth, where there is something to compare."""
    simulation, found = outcome.simulation, {}
    for index, name in enumerate(simulation.names):
        robot = outcome.robots.get(name)
        if robot is not None and robot.trajectory is not None:
            way = match(robot.trajectory, simulation.history.poses[:, index])
            if way is not None:
                found[name] = way
    return found


def tracks_of(outcome: RunOutcome) -> Tracks:
    """The ways of all robots, as the referee aligns them."""
    simulation = outcome.simulation
    history = simulation.history
    known_ways = matched(outcome)
    T_world_maps, shared = align_frames(known_ways), largest_frame(known_ways)
    T_world_odometry = align_team((t.dead_reckoned, t.true) for t in known_ways.values())
    tracks = []
    for index, name in enumerate(simulation.names):
        robot, found, belief = outcome.robots.get(name), known_ways.get(name), None
        if robot is not None and robot.trajectory is not None and found is not None:
            ticks, T_world_map = robot.trajectory.ticks, T_world_maps[name].to_array()
            known = (ticks >= 0) & (ticks < len(history))
            belief = Belief(
                stamps=np.asarray(ticks[known] * simulation.scenario.tick_s, dtype=np.float64),
                true=found.true,
                final=compose(T_world_map, found.final),
                online=compose(T_world_map, found.online),
                dead_reckoned=compose(T_world_odometry.to_array(), found.dead_reckoned),
            )
        lived = np.flatnonzero(history.present[:, index])
        stamps = np.asarray(lived * simulation.scenario.tick_s, dtype=np.float64)
        true = np.array(history.poses[lived, index])
        tracks.append(Track(name, stamps, true, belief, robot.note if robot else "no answer"))
    T_world_team = T_world_maps[shared[0]] if shared else IDENTITY
    return Tracks(T_world_team, shared, tuple(tracks))
