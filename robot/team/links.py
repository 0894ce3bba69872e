"""Links between robots: a teammate's scans found again in this robot's own submaps.

Where both logs lie in the team's frame, the joint solution says where a teammate's keyframe must
be in a submap of ours, to within what both have drifted. The scan is matched there and judged
like a loop closure of our own; what passes ties the two logs together in the joint solution.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from protocol.config import LidarConfig
from protocol.pose import FloatArray, Pose2, compose
from robot.jobs import Jobs
from robot.perception.returns import describe_returns, noise_model
from robot.perception.scan import LaserScan
from robot.slam.config import GraphSlamConfig
from robot.slam.gaussian import invert_spd
from robot.slam.loop_closure import Candidate, Query, examine
from robot.slam.packed_submap import PackedSubmap
from robot.team.entries import Link
from robot.team.joint import JointGraph, Solution, anchor_pose
from robot.team.journal import LogName
from robot.team.keyframes import StoredKeyframe
from robot.team.log_graph import LogGraph

JOB = "links"
EVERY_TICKS = 2
LANDING_TICKS = 3
NEAR_M = 4.0  # between a teammate's keyframe and the way that a submap was driven
TRIES = 2  # keyframes of one anchor that are tried in one submap
# Links of a submap to one log: what more of them would add is not worth their bytes; once the
# building is explored still less is.
ENOUGH, ENOUGH_EXPLORED = 3, 1
# A match farther than this from where both maps put it is of another place.
MAX_SHIFT_M, MAX_TURN_RAD = 0.5, 0.1


@dataclass(frozen=True, slots=True)
class Trial:
    """A teammate's keyframe to be found in a submap, and where it should be there."""

    log: LogName
    keyframe: StoredKeyframe
    angles: FloatArray
    max_range_m: float
    submap: PackedSubmap
    T_submap_base: Pose2


class LinkFinder:
    """Goes through all pairs of own submaps and teammates' anchors, each once."""

    def __init__(self, own: LogName, lidar: LidarConfig, config: GraphSlamConfig) -> None:
        self._own = own
        self._noise = noise_model(lidar)
        self._config = config
        self._reached: dict[tuple[LogName, int], int] = {}
        """Up to which anchor of a log it was looked for in the submap of that index."""
        self._found: dict[tuple[LogName, int], int] = {}
        """Links to a log that the submap of that index has."""

    def step(
        self,
        tick: int,
        jobs: Jobs,
        graph: JointGraph,
        solution: Solution,
        submaps: tuple[PackedSubmap, ...],
        explored: bool = False,
    ) -> list[Link]:
        """The links that landed at this tick; starts the next trial when none is under way.

        Submaps that have enough links are left alone, sooner in a building that is `explored`."""
        found = [link for links in jobs.landed(JOB, tick) for link in links]
        for link in found:
            self._found[link.log, link.of] = self._found.get((link.log, link.of), 0) + 1
        if tick % EVERY_TICKS == 0 and self._own in solution and not jobs.pending(JOB):
            enough = ENOUGH_EXPLORED if explored else ENOUGH
            trials = self._next_trials(graph, solution, submaps, enough)
            if trials:
                jobs.start(JOB, tick, LANDING_TICKS, find_links, trials, self._noise, self._config)
        return found

    def _next_trials(
        self,
        graph: JointGraph,
        solution: Solution,
        submaps: tuple[PackedSubmap, ...],
        enough: int,
    ) -> tuple[Trial, ...]:
        """The first pair that is near and not examined yet, as up to `TRIES` trials."""
        ours = graph.log(self._own)
        for name in sorted(solution):
            log = graph.log(name)
            if name == self._own or log is None or log.hello is None:
                continue
            for submap in submaps:
                if self._found.get((name, submap.index), 0) >= enough:
                    continue
                if not self._is_waiting(name, log, submap):
                    continue
                placed = anchor_pose(ours, solution[self._own], submap.index)
                if placed is None:
                    continue
                for anchor in self._waiting(name, log, submap):
                    there = anchor_pose(log, solution[name], anchor)
                    if there is None:
                        continue
                    T_submap_anchor = placed.inverse() @ there
                    near = _near(submap, T_submap_anchor, _keyframes_of(log, anchor))
                    if near:
                        return tuple(
                            Trial(
                                name,
                                keyframe,
                                log.hello.angles,
                                log.hello.max_range_m,
                                submap,
                                T_submap_anchor @ keyframe.T_anchor_keyframe,
                            )
                            for keyframe in near
                        )
        return ()

    def _is_waiting(self, name: LogName, log: LogGraph, submap: PackedSubmap) -> bool:
        return self._reached.get((name, submap.index), 0) < len(log.anchors) - 2

    def _waiting(self, name: LogName, log: LogGraph, submap: PackedSubmap) -> Iterator[int]:
        """Anchors that have all their keyframes (a later one exists) and were not examined; those
        that were asked for are."""
        pair = (name, submap.index)
        for anchor in range(self._reached.get(pair, 0), len(log.anchors) - 2):
            self._reached[pair] = anchor + 1
            yield anchor


def _keyframes_of(log: LogGraph, anchor: int) -> list[StoredKeyframe]:
    return [log.keyframes[n] for n in np.flatnonzero(log.views.values[:, 0] == anchor)]


def _near(
    submap: PackedSubmap, T_submap_anchor: Pose2, keyframes: list[StoredKeyframe]
) -> list[StoredKeyframe]:
    """Up to `TRIES` of the keyframes near the way of the submap, spread over them."""
    if not keyframes:
        return []
    relative = np.array([keyframe.T_anchor_keyframe.to_array() for keyframe in keyframes])
    there = compose(T_submap_anchor.to_array(), relative)
    way = submap.way
    apart = np.hypot(there[:, None, 0] - way[None, :, 0], there[:, None, 1] - way[None, :, 1]).min(
        axis=1
    )
    near = [keyframe for keyframe, away in zip(keyframes, apart, strict=True) if away <= NEAR_M]
    if len(near) <= TRIES:
        return near
    return [near[(2 * i + 1) * len(near) // (2 * TRIES)] for i in range(TRIES)]


def find_links(
    trials: tuple[Trial, ...], noise: FloatArray, config: GraphSlamConfig
) -> tuple[Link, ...]:
    """Match and judge; what was accepted of the keyframes of one anchor, as one link. Pure: runs as
    a job."""
    links = []
    for trial in trials:
        keyframe = trial.keyframe
        scan = LaserScan(keyframe.ranges, trial.angles, trial.max_range_m)
        returns = describe_returns(scan, noise, config.front_end.usable_range_m)
        query = Query(keyframe.anchor, keyframe.T_anchor_keyframe, keyframe.covariance, returns)
        candidate = Candidate(trial.submap.unpack(), trial.T_submap_base)
        (verdict,) = examine(query, (candidate,), config.closures)
        found = verdict.closure
        if found is not None and _is_where_expected(trial, found.T_of_to):
            links.append(Link(found.of, trial.log, found.to, found.T_of_to, found.information))
    return (fuse(links),) if links else ()


def fuse(links: Sequence[Link]) -> Link:
    """What several measurements of the same two anchors say together, to first order."""
    fused = links[0]
    for link in links[1:]:
        information = fused.information + link.information
        shift = (fused.T_of_to.inverse() @ link.T_of_to).log()
        step = invert_spd(information) @ (link.information @ shift)
        T_of_to = fused.T_of_to @ Pose2.exp(step)
        fused = replace(fused, T_of_to=T_of_to, information=information)
    return fused


def _is_where_expected(trial: Trial, T_of_to: Pose2) -> bool:
    found = T_of_to @ trial.keyframe.T_anchor_keyframe
    shift = trial.T_submap_base.inverse() @ found
    return bool(np.hypot(shift.x, shift.y) <= MAX_SHIFT_M and abs(shift.theta) <= MAX_TURN_RAD)
