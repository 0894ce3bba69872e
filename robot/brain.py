"""One robot's mind: from what it senses at a tick to what it does, and nothing outside of that.

A brain has no clock, no socket and no file, and draws no random numbers: the same senses give
the same actions to the last bit, wherever it runs.
"""

import functools
from collections.abc import Callable, Sequence

import numpy as np

from maps.grid import OccupancyGrid
from protocol.config import PoseModel, RobotConfig
from protocol.messages import (
    Action,
    GridPatch,
    MapReply,
    RadioFrame,
    Report,
    Sense,
    TeammateView,
    TrajectoryReply,
)
from protocol.pose import IDENTITY, FloatArray, Pose2
from protocol.state import adopt_state, dump_state
from robot.explore.explorer import Decision, Explorer
from robot.jobs import Jobs
from robot.mapping.keyframe_map import KeyframeMap, draw_exactly
from robot.perception.odometry import Motion, WheelOdometry
from robot.perception.scan import LaserScan, perceive
from robot.rows import Rows
from robot.slam.config import GraphSlamConfig
from robot.slam.engines import make_engine
from robot.slam.saved_map import SavedMap
from robot.slam.trajectory import RelativeTrajectory
from robot.team.homecoming import Homecoming
from robot.team.journal import LogName
from robot.team.links import LinkFinder
from robot.team.place_finder import PlaceFinder
from robot.team.purposes import Usage, book
from robot.team.team import LiveState, Team
from robot.whereabouts import Whereabouts

FOLLOW_EVERY_TICKS = 10
DRAWN_PER_TICK = 8
# With nothing left to explore, those in range get so long to hold what a robot held then.
TOLD_TICKS = 100


class Brain:
    """Perceive, localise and map, hear the team, decide where to go, drive."""

    def __init__(self, config: RobotConfig, incarnation: int = 0, jobs: Jobs | None = None) -> None:
        self.config = config
        self._jobs = jobs or Jobs()
        self._odometry = WheelOdometry(config.body)
        self._start = config.start.to_pose() if config.start else IDENTITY
        self._engine = make_engine(
            config.engine, config.lidar, config.body, self._start, self._jobs
        )
        self._team = Team(config, incarnation, self._jobs)
        self._where = Whereabouts(config, self._start, self._engine, self._team)
        self._places = PlaceFinder(self._team.own_log, config.lidar)
        self._homecoming = Homecoming(self._team.own_log, config.lidar)
        self._links = LinkFinder(self._team.own_log, config.lidar, GraphSlamConfig())
        self._own_map = KeyframeMap(config.lidar)
        self._joint_map = KeyframeMap(config.lidar)
        self._explorer = Explorer(config, self._jobs)
        self._ticks = Rows(1, np.int64)
        self._stamps = Rows(1)
        self._online = RelativeTrajectory()
        self._dead_reckoned = RelativeTrajectory()
        self._decision: Decision | None = None
        self._finished: tuple[int, dict[LogName, int]] | None = None
        self._counts = {"frames_sent": 0, "bytes_sent": 0, "frames_heard": 0, "bytes_heard": 0}
        self._sent_for: Usage = {}
        self._heard_for: dict[str, Usage] = {}

    def remember(self, records: Sequence[bytes]) -> None:
        """Take in the journal entries of earlier lives, before the first step."""
        self._team.recall(records)

    # -- the step

    def step(self, sense: Sense) -> Action:
        """The action that answers a sense."""
        motion, scan = self._perceive(sense)
        self._localise(sense, motion, scan)
        self._hear(sense)
        self._link(sense.tick)
        self._update_maps(sense.tick)
        decision = self._decide(sense, motion, scan)
        frames = self._speak(sense, decision)
        return Action(
            tick=sense.tick,
            drive=decision.drive,
            finished=self._is_done(sense.tick, decision),
            frame_count=len(frames),
            frames=frames,
        )

    def _perceive(self, sense: Sense) -> tuple[Motion, LaserScan | None]:
        motion = self._odometry.step(sense.encoders)
        if sense.ranges is None:
            return motion, None
        body, lidar = self.config.body, self.config.lidar
        return motion, perceive(sense.ranges, lidar, sense.sightings, body.radius_m)

    def _localise(self, sense: Sense, motion: Motion, scan: LaserScan | None) -> None:
        explored = self._is_explored()
        self._where.estimate = self._engine.step(sense.tick, motion, scan, explored)
        self._team.write(self._engine.take_entries())
        self._ticks.append(sense.tick)
        self._stamps.append(sense.stamp)
        self._online.append(0, self._where.pose())
        self._dead_reckoned.append(0, self._odometry.pose)

    def _hear(self, sense: Sense) -> None:
        for frame in sense.frames:
            self._counts["frames_heard"] += 1
            self._counts["bytes_heard"] += frame.size_bytes
            book(self._heard_for.setdefault(frame.sender, {}), frame)
        self._team.hear(sense.tick, sense.frames)
        self._where.note(sense)

    def _link(self, tick: int) -> None:
        """Find out how teammates' maps lie, and tie this robot's submaps to what they saw of the
        same places."""
        team = self._team
        team.write(self._homecoming.step(tick, self._jobs, team.graph))
        team.write(self._places.step(tick, self._jobs, team.graph, team.solution))
        submaps, explored = self._engine.submaps, self._is_explored()
        team.write(self._links.step(tick, self._jobs, team.graph, team.solution, submaps, explored))

    def _update_maps(self, tick: int) -> None:
        solved = self._team.solve(tick)
        if solved or tick % FOLLOW_EVERY_TICKS == 0:
            self._own_map.follow(self._team.graph, self._where.own_anchors(self._team.solution))
            self._joint_map.follow(self._team.graph, self._team.solution)
        self._own_map.draw(self._team.graph, DRAWN_PER_TICK)
        self._joint_map.draw(self._team.graph, DRAWN_PER_TICK)

    def _decide(self, sense: Sense, motion: Motion, scan: LaserScan | None) -> Decision:
        pose = self._where.pose()
        place = functools.partial(self._where.meeting_place, sense.tick, self._is_explored())
        snapshot = _MapSnapshot(self._joint_map, pose, scan, place)
        self._decision = self._explorer.step(
            sense.tick,
            pose,
            motion,
            scan,
            snapshot,
            self._where.teammates(sense.tick, pose, self.config.team),
        )
        return self._decision

    def _is_explored(self) -> bool:
        """Whether at the last decision nothing was left to explore."""
        return self._decision is not None and self._decision.explored

    def _is_done(self, tick: int, decision: Decision) -> bool:
        """Whether nothing is left to explore, and those in range hold what this robot held when it
        found that out: the world ends the run when all say so."""
        if not decision.finished:
            self._finished = None
            return False
        if self._finished is None:
            self._finished = tick, self._team.journal.vector()
        since, vector = self._finished
        return tick - since >= TOLD_TICKS or self._team.gossip.is_held(vector, tick)

    def _speak(self, sense: Sense, decision: Decision) -> tuple[RadioFrame, ...]:
        anchor, T_anchor_base = self._where.anchored()
        T_team_base = self._where.pose()
        goal = decision.goal
        T_base_goal = None if goal is None else T_team_base.inverse() @ goal
        live = LiveState(
            anchor,
            T_anchor_base,
            self._where.estimate.covariance,
            None if T_base_goal is None else T_anchor_base @ T_base_goal,
            decision.finished,
            sense.sightings,
            self._where.sees_stranger(sense, T_team_base),
        )
        frames = tuple(self._team.speak(sense.tick, live))
        self._counts["frames_sent"] += len(frames)
        self._counts["bytes_sent"] += sum(frame.size_bytes for frame in frames)
        for frame in frames:
            book(self._sent_for, frame)
        return frames

    # -- what it tells

    def take_records(self) -> list[bytes]:
        """Journal entries to make durable before any frame that carries them leaves."""
        return self._team.take_records()

    def report(self) -> Report:
        """What the operator may see."""
        tick = int(self._ticks.values[-1, 0]) if len(self._ticks) else 0
        decision, team = self._decision, self._team
        goal = decision.goal if decision else None
        return Report(
            tick=tick,
            pose=PoseModel.of(self._where.pose()),
            covariance=self._where.estimate.covariance,
            activity=decision.activity if decision else "waiting for the first sense",
            goal=None if goal is None else PoseModel.of(goal),
            path=decision.path if decision else np.zeros((0, 2)),
            known_m2=self._joint_map.map.known_area(),
            frontier_m=decision.frontier_m if decision else 0.0,
            finished=decision.finished if decision else False,
            team=tuple(self._view_of(name, tick) for name in self.config.team),
            loop_closures=self._engine.loop_closures,
            journal_entries=len(team.journal),
            malformed=sum(team.malformed.values()),
        )

    def _view_of(self, name: str, tick: int) -> TeammateView:
        known = self._team.teammate_pose(name)
        heard = self._team.heard.get(name)
        state, reason = self._team.standing.state_of(name)
        return TeammateView(
            robot=name,
            in_range=name in self._team.gossip.in_range(tick),
            last_heard_tick=heard.tick if heard else -1,
            entries=self._team.journal.count_of(name),
            pose=PoseModel.of(known[0]) if known else None,
            alignment=state.value,
            alignment_reason=reason,
        )

    def map_reply(self, exact: bool = False) -> MapReply:
        """The present maps in this robot's frame. Exact ones are drawn anew, from the journal alone
        and in the frame of the robots it is aligned with: those with equal journals then answer
        with equal joint maps; the others follow a second behind."""
        if not exact:
            own, joint = self._own_map.map, self._joint_map.map
            return MapReply(own=_patch(own.grid()), joint=_patch(joint.grid()))
        graph, lidar = self._team.graph, self.config.lidar
        solution = self._team.standing.exactly(graph).solution
        anchors = self._where.own_anchors(solution)
        own = draw_exactly(graph, anchors, lidar)
        joint = draw_exactly(graph, solution, lidar)
        saved = SavedMap.of(self._engine, anchors[self._team.own_log])
        return MapReply(
            own=_patch(own.grid()),
            joint=_patch(joint.grid()),
            saved=saved.encode() if saved.submaps else b"",
        )

    def trajectory_reply(self) -> TrajectoryReply:
        """The trajectory so far in the frame of the robots that this one is aligned with, the pose
        graph, and the counts to hold against the ledger."""
        graph = self._engine.graph()
        solution, T_group_own, frame = self._team.standing.exactly(self._team.graph)
        anchors = self._where.own_anchors(solution)[self._team.own_log]
        start = (T_group_own @ self._start).to_array()[None, :]
        upper = graph.information[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        return TrajectoryReply(
            ticks=self._ticks.values[:, 0].copy(),
            stamps=self._stamps.values[:, 0].copy(),
            online=self._online.poses(T_group_own.to_array()[None, :]),
            final=self._engine.trajectory(anchors),
            dead_reckoned=self._dead_reckoned.poses(start),
            nodes=graph.nodes,
            edge_nodes=graph.edge_nodes,
            edge_values=np.concatenate([graph.measurements, upper], axis=1),
            journal_digest=self._team.journal.digest(),
            frame=frame,
            sent_for=self._sent_for.copy(),
            heard_for={name: usage.copy() for name, usage in self._heard_for.items()},
            **self._counts,
        )

    # -- checkpoints

    def state(self) -> bytes:
        """A checkpoint from which `restore` carries on as if nothing had happened."""
        self._jobs.settle()
        return dump_state(self)

    def restore(self, checkpoint: bytes) -> None:
        """Take over the state of a brain of the same configuration."""
        executor = self._jobs.executor
        adopt_state(self, checkpoint)
        self._jobs.executor = executor


class _MapSnapshot:
    """The joint map with the present scan on it, and where to meet teammates: worked out only when
    a planner asks for it."""

    def __init__(
        self,
        drawn: KeyframeMap,
        pose: Pose2,
        scan: LaserScan | None,
        meeting_place: Callable[[], Pose2 | None],
    ) -> None:
        self._drawn, self._pose, self._scan = drawn, pose, scan
        self.meeting_place = meeting_place

    def snapshot(self) -> OccupancyGrid:
        if self._scan is None:
            return self._drawn.map.grid()
        return self._drawn.map.live(self._pose, self._scan)

    def lookouts(self) -> FloatArray:
        return self._drawn.lookouts()


def _patch(grid: OccupancyGrid) -> GridPatch:
    return GridPatch(
        resolution_m=grid.resolution,
        origin_x_m=grid.origin_x,
        origin_y_m=grid.origin_y,
        cells=grid.cells,
    )
