"""The referee: how good the robots' maps and trajectories are, by the truth they cannot see."""

from collections import Counter
from collections.abc import Mapping

from pydantic import Field

from protocol.messages import GridPatch, MapReply, TrajectoryReply
from protocol.model import Model
from protocol.pose import IDENTITY, Pose2
from world.accuracy import Track, align_frames, align_team, distances, match, rmse
from world.simulation import Simulation
from world.truth import MapTruth

Reply = tuple[MapReply | None, TrajectoryReply | None]
NOWHERE_ELSE: Mapping[str, Pose2] = {}


class Accuracy(Model):
    """Root mean square of position errors (m): of the trajectory as optimised at the end, of the
    estimate at its own tick, and of wheel odometry alone. None where there is no trajectory."""

    ate_rmse_m: float | None
    ate_online_rmse_m: float | None
    dead_reckoning_rmse_m: float | None


class RobotScore(Accuracy):
    """What one robot achieved."""

    coverage_own: float | None = Field(description="of its own map alone; None without a map")
    coverage_joint: float | None = Field(description="of its joint map; None without a map")
    collisions: int
    driven_m: float
    ledger_equal: bool | None = Field(
        description="its counts are the world's, pair by pair; None if it died or came back"
    )
    heard_for: dict[str, dict[str, int]] = Field(
        description="bytes that it heard, by sender and by what they were for"
    )


class WallScore(Model):
    """Of the wall cells: how many are in the joint maps, and how many of those are true. None
    without a joint map."""

    recall: float | None
    precision: float | None


class LedgerScore(Model):
    """Whether what robots say they sent and heard is what the world counted; None if nobody said
    anything."""

    equal: bool | None


class PurposeScore(Model):
    """What was delivered for one purpose, by the receivers' word."""

    bytes_delivered: int
    bytes_per_metre: float | None = Field(description="as in RadioScore")


class RadioScore(Model):
    """Over all ordered pairs of robots."""

    frames_offered: int
    frames_delivered: int
    bytes_offered: int
    bytes_delivered: int
    bytes_per_metre: float | None = Field(
        description="delivered, by metre driven and robot that could receive it"
    )
    purposes: dict[str, PurposeScore] = Field(
        description="what the bytes were for, as far as robots answered"
    )


class Score(Model):
    """A run in numbers; shares are between 0 and 1, and None where no robot answered."""

    coverage: float | None
    coverage_worst_joint: float | None
    target_m2: float
    walls: WallScore
    team: Accuracy
    robots: dict[str, RobotScore]
    collisions: int
    ledger: LedgerScore
    radio: RadioScore
    sim_s: float


class Referee:
    """Judges one run. What the truth is follows from the map and the starts, once."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        radius = simulation.scenario.body.radius_m
        self.truth = MapTruth(simulation.terrain, simulation.starts, radius)

    def coverage(
        self, maps: Mapping[str, GridPatch], T_world_maps: Mapping[str, Pose2] = NOWHERE_ELSE
    ) -> float:
        """The share of the target that is known correctly in these maps together, each where its
        robot's frame lies; where that is not said, in the frame of the world."""
        return self.truth.known(
            self.truth.target,
            [(maps[name], T_world_maps.get(name, IDENTITY)) for name in sorted(maps)],
        )

    def score(self, replies: Mapping[str, Reply]) -> Score:
        """The score of what the robots answered at the end; dead ones answered nothing."""
        names = self._simulation.names
        tracks = self._tracks(replies)
        T_world_maps = align_frames(tracks)
        T_world_odom = align_team((track.dead_reckoned, track.true) for track in tracks.values())
        own, joint = {}, {}
        for name in names:
            patches, _ = replies.get(name, (None, None))
            if patches is not None:
                T_world_map = T_world_maps.setdefault(name, IDENTITY)
                own[name], joint[name] = patches.own, (patches.joint, T_world_map)
        robots = {
            name: self._score_robot(
                name, replies.get(name, (None, None)), tracks.get(name), T_world_maps, T_world_odom
            )
            for name in names
        }
        joint_shares = [r.coverage_joint for r in robots.values() if r.coverage_joint is not None]
        equal = [r.ledger_equal for r in robots.values() if r.ledger_equal is not None]
        offered = self._simulation.ledger.offered.sum(axis=(0, 1))
        delivered = self._simulation.ledger.delivered.sum(axis=(0, 1))
        self._simulation.ledger.check()
        heard_m = (len(names) - 1) * sum(robot.driven_m for robot in robots.values())
        return Score(
            coverage=self.coverage(own, T_world_maps) if own else None,
            coverage_worst_joint=min(joint_shares, default=None),
            target_m2=self.truth.target_m2,
            walls=WallScore(
                recall=self.truth.known(self.truth.walls, joint.values()) if joint else None,
                precision=self.truth.precision(list(joint.values())) if joint else None,
            ),
            team=_accuracy(tracks, T_world_maps, T_world_odom),
            robots=robots,
            collisions=sum(robot.collisions for robot in robots.values()),
            ledger=LedgerScore(equal=all(equal) if equal else None),
            radio=RadioScore(
                frames_offered=int(offered[0]),
                frames_delivered=int(delivered[0]),
                bytes_offered=int(offered[1]),
                bytes_delivered=int(delivered[1]),
                bytes_per_metre=int(delivered[1]) / heard_m if heard_m > 0.0 else None,
                purposes=_purposes(robots, heard_m),
            ),
            sim_s=self._simulation.stamp,
        )

    def _tracks(self, replies: Mapping[str, Reply]) -> dict[str, Track]:
        """What can be compared, by robot, in the order of the scenario."""
        tracks = {}
        for i, name in enumerate(self._simulation.names):
            _, trajectory = replies.get(name, (None, None))
            if trajectory is not None:
                track = match(trajectory, self._simulation.history.poses[:, i])
                if track is not None:
                    tracks[name] = track
        return tracks

    def _score_robot(
        self,
        name: str,
        reply: Reply,
        track: Track | None,
        T_world_maps: Mapping[str, Pose2],
        T_world_odom: Pose2,
    ) -> RobotScore:
        simulation, (patches, trajectory) = self._simulation, reply
        accuracy = _accuracy({name: track} if track else {}, T_world_maps, T_world_odom)
        own = self.coverage({name: patches.own}, T_world_maps) if patches else None
        joint = self.coverage({name: patches.joint}, T_world_maps) if patches else None
        return RobotScore(
            **accuracy.model_dump(),
            coverage_own=own,
            coverage_joint=joint,
            collisions=simulation.collisions[name],
            driven_m=simulation.history.driven_m(simulation.names.index(name)),
            ledger_equal=self._ledger_equal(name, trajectory) if trajectory else None,
            heard_for=trajectory.heard_for if trajectory else {},
        )

    def _ledger_equal(self, name: str, reply: TrajectoryReply) -> bool | None:
        i, ledger = self._simulation.names.index(name), self._simulation.ledger
        if not self._simulation.history.present[:, i].all():
            return None
        sent, heard = ledger.sent[i].tolist(), ledger.heard[i].tolist()
        from_each = dict(zip(ledger.names, ledger.delivered[:, i, 1].tolist(), strict=True))
        said_of_each = {name: sum(usage.values()) for name, usage in reply.heard_for.items()}
        said = [reply.frames_sent, reply.bytes_sent, reply.frames_heard, reply.bytes_heard]
        return (
            said == [*sent, *heard]
            and sum(reply.sent_for.values()) == reply.bytes_sent
            and {name: said_of_each.get(name, 0) for name in ledger.names} == from_each
        )


def _purposes(robots: Mapping[str, RobotScore], heard_m: float) -> dict[str, PurposeScore]:
    """What the bytes were for that robots say they heard, the most first."""
    total: Counter[str] = Counter()
    for robot in robots.values():
        for usage in robot.heard_for.values():
            total.update(usage)
    return {
        purpose: PurposeScore(
            bytes_delivered=size, bytes_per_metre=size / heard_m if heard_m > 0.0 else None
        )
        for purpose, size in sorted(total.items(), key=lambda item: (-item[1], item[0]))
    }


def _accuracy(
    tracks: Mapping[str, Track], T_world_maps: Mapping[str, Pose2], T_world_odom: Pose2
) -> Accuracy:
    placed = [(T_world_maps[name], track) for name, track in tracks.items()]
    return Accuracy(
        ate_rmse_m=rmse(distances(T, t.final, t.true) for T, t in placed),
        ate_online_rmse_m=rmse(distances(T, t.online, t.true) for T, t in placed),
        dead_reckoning_rmse_m=rmse(
            distances(T_world_odom, t.dead_reckoned, t.true) for _, t in placed
        ),
    )
