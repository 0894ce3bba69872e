"""GraphSlam: scan-to-submap matching, loop closures and a pose graph over submap anchors.

The front end knows where the robot is in its current submap. Scans are looked for in finished
submaps (a job); what is found and verified ties anchors together, and the graph over anchors is
optimised in the same job. Nothing but anchors is moved by that: all else is relative to them.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.config import BodyConfig, LidarConfig
from protocol.pose import FloatArray, Pose2, wrap_angle
from robot.jobs import Jobs
from robot.perception.odometry import Motion
from robot.perception.returns import Returns
from robot.perception.scan import LaserScan
from robot.slam.anchor_graph import AnchorGraph, Optimised, optimise_anchors
from robot.slam.candidates import CandidateFinder
from robot.slam.config import GraphSlamConfig, RevisitConfig
from robot.slam.engine import Anchor, Closure, Entry, Estimate, GraphSnapshot, Keyframe
from robot.slam.front_end import FrontEnd, Progress
from robot.slam.gaussian import advance
from robot.slam.kept_places import KeptPlaces
from robot.slam.loop_closure import Candidate, Query, Verdict, examine
from robot.slam.packed_submap import PackedSubmap
from robot.slam.trajectory import RelativeTrajectory

START_INFORMATION = np.eye(3) * 1e6
# Of an anchor that is held by a closure instead.
UNTIED = np.eye(3) * 1e-2
JOB = "loop-closure"
# From here on a turn on the spot shows nothing that was not seen before it.
ALL_ROUND_RAD = 2.0 * math.pi - 0.1


@dataclass(frozen=True, slots=True)
class Findings:
    """What a loop closure job brings back: all verdicts, and the graph if any was accepted."""

    verdicts: tuple[Verdict, ...]
    closures: tuple[Closure, ...]
    optimised: Optimised | None


class GraphSlam:
    """The default engine. The map frame is the one in which `start` is given."""

    def __init__(
        self,
        lidar: LidarConfig,
        body: BodyConfig,
        start: Pose2,
        jobs: Jobs,
        config: GraphSlamConfig | None = None,
    ) -> None:
        del body
        self._config = config or GraphSlamConfig()
        self._jobs = jobs
        self._sees_all_round = lidar.field_of_view_rad >= ALL_ROUND_RAD
        self._front_end = FrontEnd(lidar, self._config.front_end)
        self._graph = AnchorGraph(start)
        self._candidates = CandidateFinder(self._config.closures)
        self._trajectory = RelativeTrajectory()
        self._entries: list[Entry] = [Anchor(0, start, START_INFORMATION)]
        self._keyframes = 0
        self._last_keyframe: Pose2 | None = None
        self._kept = KeptPlaces(self._sees_all_round)
        self._explored = False
        self.loop_closures = 0
        self.refusals: dict[str, int] = {}
        """How often candidates were refused, by reason."""

    @property
    def anchors(self) -> FloatArray:
        return self._graph.nodes

    def step(
        self, tick: int, motion: Motion, scan: LaserScan | None, explored: bool = False
    ) -> Estimate:
        """Land what was searched, predict by odometry, correct by the scan, look for loops."""
        self._explored = explored
        for findings in self._jobs.landed(JOB, tick):
            self._land(findings)
        self._front_end.predict(motion)
        if scan is not None:
            progress = self._front_end.correct(scan)
            self._extend(progress)
            if progress.moved and self._front_end.current.finished:
                self._stay_on_known_ground(progress)
            elif progress.moved:
                self._look_for_loops(tick, progress.returns)
                self._settle_where_known(progress.returns)
        here = self._here()
        if scan is not None:
            self._keep(tick, scan, here)
        self._trajectory.append(self._front_end.current.index, self._front_end.pose)
        return Estimate(here, self._covariance())

    def take_entries(self) -> list[Entry]:
        entries, self._entries = self._entries, []
        return entries

    @property
    def submaps(self) -> tuple[PackedSubmap, ...]:
        return self._candidates.submaps

    def mapped(self) -> tuple[PackedSubmap, ...]:
        current = self._front_end.current
        if current.finished:
            return self.submaps
        filling = dataclasses.replace(current, field=current.field.cropped())
        return (*self.submaps, PackedSubmap.of(filling))

    def trajectory(self, anchors: FloatArray | None = None) -> FloatArray:
        return self._trajectory.poses(self.anchors if anchors is None else anchors)

    def graph(self) -> GraphSnapshot:
        return self._graph.snapshot()[0]

    def _land(self, findings: Findings) -> None:
        self._add_closures(findings.closures)
        for verdict in findings.verdicts:
            if verdict.closure is None:
                self.refusals[verdict.reason] = self.refusals.get(verdict.reason, 0) + 1
        if findings.optimised is not None:
            self._graph.apply(findings.optimised)

    def _add_closures(self, closures: tuple[Closure, ...]) -> None:
        for closure in closures:
            self._graph.add_closure(closure)
            self._entries.append(closure)
            self.loop_closures += 1
        self._candidates.note(closures)

    def _extend(self, progress: Progress) -> None:
        if progress.finished is not None:
            self._candidates.add(progress.finished)
        if progress.anchor is not None:
            anchor = progress.anchor
            self._graph.add_anchor(anchor.of, anchor.T_of_anchor, anchor.information)
            self._entries.append(Anchor(anchor.index, anchor.T_of_anchor, anchor.information))

    def _look_for_loops(self, tick: int, returns: Returns) -> None:
        front_end, config = self._front_end, self._config.closures
        anchor, pose = front_end.current.index, front_end.pose
        due = self._candidates.advance(anchor, pose)
        if not due or self._jobs.pending(JOB):
            return
        candidates = self._candidates.find(anchor, pose, self._graph.nodes)
        if not candidates:
            return
        query = Query(anchor, pose, front_end.match_covariance, returns)
        graph, robust = self._graph.snapshot()
        self._jobs.start(
            JOB,
            tick,
            config.landing_ticks,
            close_loops,
            query,
            candidates,
            graph,
            robust,
            self._config,
        )

    # known ground

    @property
    def _revisits(self) -> RevisitConfig:
        return self._config.explored if self._explored else self._config.revisits

    def _settle_where_known(self, returns: Returns) -> None:
        """Stop mapping where enough submaps have seen the place."""
        config = self._revisits
        if len(self._front_end.current.keyframes) < config.min_keyframes:
            return
        if len(self._candidates.submaps) < config.enough_submaps:
            return
        near = self._candidates.how_many_near(self._here(), self._graph.nodes, config.near_m)
        if near >= config.enough_submaps:
            self._settle(returns)

    def _stay_on_known_ground(self, progress: Progress) -> None:
        """Go on in another submap when this one shows too little, or map again if none does."""
        seen = progress.match.score >= self._revisits.leave_score
        if seen or self._settle(progress.returns):
            return
        if self._explored:
            self._kept.forget(self._here(), self._revisits)
        anchor = self._front_end.depart(progress.returns)
        self._graph.add_anchor(anchor.of, anchor.T_of_anchor, anchor.information)
        # In the journal an anchor follows the one before it; what holds this one is a closure.
        T_previous_anchor = self._graph.pose(anchor.index - 1).inverse() @ self._graph.pose(
            anchor.index
        )
        self._entries.append(Anchor(anchor.index, T_previous_anchor, UNTIED))
        self._entries.append(
            Closure(anchor.of, anchor.index, anchor.T_of_anchor, anchor.information)
        )

    def _settle(self, returns: Returns) -> bool:
        """Go on in the finished submap nearby that explains the scan best, if one does well."""
        front_end, config, revisits = self._front_end, self._config, self._revisits
        anchor, pose = front_end.current.index, front_end.pose
        query = Query(anchor, pose, front_end.match_covariance, returns)
        candidates = self._candidates.others(
            anchor,
            self._here(),
            self._graph.nodes,
            config.closures.radius_m,
            revisits.max_tries,
        )
        verdicts = examine(query, candidates, config.closures)
        best = max(verdicts, key=lambda v: v.score if v.closure else 0.0, default=None)
        if best is None or best.closure is None or best.score < revisits.settle_score:
            return False
        submap = next(c.submap for c in candidates if c.submap.index == best.closure.of)
        enough_tied = self._explored and front_end.current.finished
        if not enough_tied and self._candidates.may_tie_again(best.closure.of, anchor):
            self._add_closures((best.closure,))
        for left in front_end.settle(submap, best.closure.T_of_to @ pose):
            self._candidates.add(left)
        self._candidates.forget_drift()
        return True

    def _here(self) -> Pose2:
        return self._graph.pose(self._front_end.current.index) @ self._front_end.pose

    # what is handed on

    def _keep(self, tick: int, scan: LaserScan, pose: Pose2) -> None:
        """Hand a keyframe to the journal when the robot has moved on since the last one."""
        front_end, config = self._front_end, self._config.front_end
        if self._last_keyframe is not None:
            near = self._last_keyframe.distance_to(pose) < config.journal_m
            turned = abs(wrap_angle(pose.theta - self._last_keyframe.theta))
            if near and (self._sees_all_round or turned < config.journal_rad):
                return
        if not self._is_wanted(pose):
            return
        self._last_keyframe = pose
        anchor, covariance = front_end.current.index, front_end.covariance.copy()
        self._entries.append(
            Keyframe(self._keyframes, tick, anchor, front_end.pose, covariance, scan.ranges)
        )
        self._keyframes += 1

    def _is_wanted(self, pose: Pose2) -> bool:
        """Whether few keyframes show this place from this side; counts one more if so."""
        if self._explored and self._front_end.current.finished:
            return False
        return self._kept.take(pose, self._revisits)

    def _covariance(self) -> FloatArray:
        """Of where the robot is (3×3)."""
        front_end = self._front_end
        anchor = front_end.current.index
        return advance(self._graph.covariance(anchor), front_end.pose, front_end.covariance)


def close_loops(
    query: Query,
    candidates: tuple[Candidate, ...],
    graph: GraphSnapshot,
    robust: npt.NDArray[np.bool_],
    config: GraphSlamConfig,
) -> Findings:
    """Examine the candidates and optimise the graph with what was found. Pure: a job."""
    verdicts = examine(query, candidates, config.closures)
    closures = tuple(verdict.closure for verdict in verdicts if verdict.closure)
    if not closures:
        return Findings(verdicts, (), None)
    optimised = optimise_anchors(graph, robust, closures, config.optimiser_iterations)
    return Findings(verdicts, closures, optimised)
