"""Where a robot looks for whom it cannot hear."""

import numpy as np

from protocol.config import PoseModel, RobotConfig
from protocol.messages import HeardFrame, Sense, Sighting
from protocol.pose import IDENTITY, Pose2
from robot.jobs import Jobs
from robot.slam.engine import Anchor, Engine, Estimate
from robot.slam.engines import make_engine
from robot.team.standing import STRANGE_M
from robot.team.team import LiveState, Team
from robot.whereabouts import SEEK_TICKS, Whereabouts

NAMES = ("r1", "r2", "r3")
STARTS = {"r1": Pose2(0.0, 0.0, 0.0), "r2": Pose2(4.0, 0.0, 0.0), "r3": Pose2(8.0, 0.0, 0.0)}
LAST_HEARD = 60


def _robot(name: str) -> tuple[Team, Whereabouts]:
    config = RobotConfig(name=name, team=NAMES, start=PoseModel.of(STARTS[name]))
    engine: Engine = make_engine("dead-reckoning", config.lidar, config.body, STARTS[name], Jobs())
    team = Team(config, 0, Jobs())
    team.write([Anchor(0, STARTS[name], np.eye(3) * 1e6)])
    return team, Whereabouts(config, STARTS[name], engine, team)


def _parted() -> dict[str, Whereabouts]:
    """Three robots that heard each other where they started, until a tick."""
    robots = {name: _robot(name) for name in NAMES}
    live = LiveState(0, IDENTITY, np.eye(3) * 1e-4, None, False)
    for tick in range(LAST_HEARD + 1):
        said = {name: team.speak(tick, live) for name, (team, _) in robots.items()}
        for name, (team, where) in robots.items():
            frames = tuple(
                HeardFrame(sender=other, sent_tick=tick, to=f.to, kind=f.kind, payload=f.payload)
                for other in NAMES
                if other != name
                for f in said[other]
                if f.to in ("*", name)
            )
            team.hear(tick, frames)
            team.solve(tick)
            where.note(Sense(tick=tick, stamp=0.1 * tick, encoders=(0, 0), frames=frames))
    return {name: where for name, (_, where) in robots.items()}


def test_both_of_a_pair_go_to_where_the_first_by_name_was() -> None:
    parted = _parted()
    for where in parted.values():
        assert where.meeting_place(LAST_HEARD + 10, seeking=False) is None
        where.estimate = Estimate(Pose2(30.0, 5.0, 1.0), np.eye(3))
    later = LAST_HEARD + 200
    places = {name: where.meeting_place(later, seeking=False) for name, where in parted.items()}
    for place in places.values():
        assert place is not None
        assert place.distance_to(STARTS["r1"]) < 1e-6


def test_one_after_the_other_is_looked_for_and_nobody_for_ever() -> None:
    where = _parted()["r2"]
    begun = LAST_HEARD + 200
    where.estimate = Estimate(Pose2(30.0, 5.0, 1.0), np.eye(3))
    # While it explores no time runs.
    for tick in (begun - 100, begun):
        assert where.meeting_place(tick, seeking=False) is not None
    assert where.meeting_place(begun + SEEK_TICKS, seeking=True) is not None
    where.estimate = Estimate(STARTS["r1"], np.eye(3))
    assert where.meeting_place(begun + SEEK_TICKS, seeking=True) is None  # it is there
    second = begun + SEEK_TICKS + 1
    place = where.meeting_place(second, seeking=True)
    assert place is not None
    assert place.distance_to(STARTS["r2"]) < 1e-6
    assert where.meeting_place(second + SEEK_TICKS + 1, seeking=True) is None


def test_a_stranger_is_who_is_not_where_the_map_puts_it() -> None:
    where = _parted()["r1"]  # at the origin; r2 said it stood 4 m ahead
    where.estimate = Estimate(STARTS["r1"], np.eye(3))

    def sees_stranger(robot: str, range_m: float, tick: int) -> bool:
        seen = Sighting(robot=robot, range_m=range_m, bearing_rad=0.0)
        sense = Sense(tick=tick, stamp=0.1 * tick, encoders=(0, 0), sightings=(seen,))
        return where.sees_stranger(sense, where.pose())

    assert not sees_stranger("r2", 4.0, LAST_HEARD)
    assert sees_stranger("r2", 4.1 + STRANGE_M, LAST_HEARD)
    assert not sees_stranger("r2", 4.1 + STRANGE_M, LAST_HEARD + 10)  # it may have driven there
    assert sees_stranger("r4", 4.0, LAST_HEARD)  # never heard
