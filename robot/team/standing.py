"""How the logs that a robot holds stand to each other, and its own solution of those it is aligned
with, kept up to date by jobs.

Every robot thinks in its own frame, that of its first anchor; the joint solution is made in the
frame of its group and carried over, so that nothing jumps for a robot when its group grows.
"""

from typing import NamedTuple

from protocol.config import LidarConfig
from protocol.pose import IDENTITY, FloatArray, Pose2, compose
from robot.jobs import Jobs
from robot.perception.returns import noise_model
from robot.team.alignment import align, join, judge
from robot.team.entries import Link
from robot.team.evidence import Kind
from robot.team.joint import JointGraph, Solution, anchor_pose, solve
from robot.team.journal import LogName
from robot.team.pair_judge import KNOWN, PairView, State

SOLVE, SOLVE_EVERY_TICKS, SOLVE_DELAY_TICKS = "joint", 20, 5
JUDGE, JUDGE_EVERY_TICKS, JUDGE_DELAY_TICKS = "judge", 50, 10
# While a robot has been met that is not placed yet, or elsewhere: they may part again soon.
MET_EVERY_TICKS = 10
# Who is seen is nearer than this to where both maps put it, unless one of the two lies elsewhere.
STRANGE_M = 1.0
# Maps that have grown by this share are laid over each other again.
GROWTH = 0.2
# The frame in which robots were told where they start.
TEAM_FRAME = "team"


class Exact(NamedTuple):
    """A solution in the frame of a group, `T_group_own`, and the frame's name."""

    solution: Solution
    T_group_own: Pose2
    frame: str


class Standing:
    """The pairs as judged last, and the solution (`T_own_anchor`) that follows from them."""

    def __init__(self, own: LogName, start: Pose2 | None, lidar: LidarConfig) -> None:
        self._own = own
        self._start = start
        self._noise = noise_model(lidar)
        self.pairs: tuple[PairView, ...] = ()
        self.solution: Solution = {}
        self._unsolved = False
        self._judged = (0, 0)

    def note_entry(self) -> None:
        """There is something new to solve."""
        self._unsolved = True

    def step(self, tick: int, jobs: Jobs, graph: JointGraph) -> bool:
        """Land and start jobs; True when a new solution landed."""
        judged = jobs.landed(JUDGE, tick)
        if judged:
            self.pairs, self._unsolved = judged[-1], True
        landed = jobs.landed(SOLVE, tick)
        if landed:
            self.solution = landed[-1]
        if self._may_judge(tick, graph) and not jobs.pending(JUDGE) and self._is_due(graph):
            jobs.start(JUDGE, tick, JUDGE_DELAY_TICKS, judge, graph.snapshot(), self._noise)
        may_solve = bool(judged) or tick % SOLVE_EVERY_TICKS == 0
        if may_solve and self._unsolved and not jobs.pending(SOLVE):
            arguments = (graph.snapshot(), self.pairs, self._own, self._start)
            jobs.start(SOLVE, tick, SOLVE_DELAY_TICKS, solve_own, *arguments)
            self._unsolved = False
        return bool(landed)

    def state_of(self, robot: str) -> tuple[State, str]:
        """How this robot's map stands to that of another in its present life, and why."""
        views = [
            view
            for view in self.pairs
            if self._own in (view.a, view.b) and robot in (view.a.robot, view.b.robot)
        ]
        shared = any(name.robot == robot for name in self.solution)
        if views and (views[-1].state is State.ALIGNED or not shared):
            return views[-1].state, views[-1].reason
        if shared:
            through = "through others" if self._start is None else KNOWN
            return State.ALIGNED, "itself" if robot == self._own.robot else through
        return State.UNKNOWN, "no match between them"

    def exactly(self, graph: JointGraph) -> "Exact":
        """The solution by all entries, from nothing, in the frame of the group.

        Robots with equal journals that are aligned get equal ones.
        """
        group = align(graph, self._noise).group_of(self._own)
        if group is None:
            return Exact({}, IDENTITY, f"{self._own.robot}.{self._own.incarnation}")
        solution = solve(graph.problem(group))
        known = graph.known_starts().logs
        first = group.logs[0]
        frame = TEAM_FRAME if set(known) & set(group.logs) else f"{first.robot}.{first.incarnation}"
        if self._start is not None:
            return Exact(solution, IDENTITY, frame)
        return Exact(solution, Pose2.from_array(solution[self._own][0]), frame)

    def _may_judge(self, tick: int, graph: JointGraph) -> bool:
        if tick % JUDGE_EVERY_TICKS == 0:
            return True
        return tick % MET_EVERY_TICKS == 0 and self._has_met_a_stranger(graph)

    def _has_met_a_stranger(self, graph: JointGraph) -> bool:
        """Whether two have seen each other of whom one is not placed here, or elsewhere."""
        return any(
            link.evidence.kind is Kind.SIGHTING and self._is_strange(graph, name, link)
            for name in graph.logs()
            if (log := graph.log(name)) is not None
            for link in log.links
        )

    def _is_strange(self, graph: JointGraph, holder: LogName, link: Link) -> bool:
        one = anchor_pose(graph.log(holder), self.solution.get(holder), link.of)
        other = anchor_pose(graph.log(link.log), self.solution.get(link.log), link.to)
        if one is None or other is None:
            placed = {self._own, *self.solution}
            return (holder in placed) != (link.log in placed)
        return other.distance_to(one @ link.T_of_to) > STRANGE_M

    def _is_due(self, graph: JointGraph) -> bool:
        """Whether there is new evidence, or enough new map to test the old by."""
        logs = [log for name in graph.logs() if (log := graph.log(name)) is not None]
        # A match whose other anchor is yet to come says nothing before that.
        matches = sum(
            link.evidence.kind is not Kind.NEAR and graph.has_anchor(link.log, link.to)
            for log in logs
            for link in log.links
        )
        keyframes = sum(len(log.keyframes) for log in logs)
        seen_matches, seen_keyframes = self._judged
        if matches == 0 or (
            matches == seen_matches and keyframes < (1.0 + GROWTH) * seen_keyframes
        ):
            return False
        self._judged = (matches, keyframes)
        return True


def solve_own(
    graph: JointGraph, pairs: tuple[PairView, ...], own: LogName, start: Pose2 | None
) -> Solution:
    """Solve the group that a log belongs to, in the log's own frame. Pure: runs as a job.

    With a known `start` that is the team's frame, and what shares it follows without matches.
    """
    group = join(graph, pairs).group_of(own)
    if group is None:
        return {}
    solution = solve(graph.problem(group))
    if start is not None:
        return solution
    return _carried(Pose2.from_array(solution[own][0]).inverse(), solution)


def _carried(T_new_old: Pose2, solution: Solution) -> Solution:
    shift: FloatArray = T_new_old.to_array()
    return {name: compose(shift, anchors) for name, anchors in solution.items()}
