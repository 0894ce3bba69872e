"""A robot that starts again finds out where it stands to its last life, and tells nothing twice."""

from typing import NamedTuple

import numpy as np
import pytest

from protocol.pose import Pose2
from robot.brain import Brain
from robot.team.journal import LogName, decode_record
from robot.team.pair_judge import State
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

DIES, ENDS = 150, 380
OLD, NEW = LogName("r1", 0), LogName("r1", 7)


class Lives(NamedTuple):
    """One robot's two lives, and what each wrote down."""

    simulation: Simulation
    old: Brain
    first: list[bytes]
    new: Brain
    second: list[bytes]


def drive(simulation: Simulation, brain: Brain, until: int) -> list[bytes]:
    """Records of a brain that drives alone up to a tick."""
    records: list[bytes] = []
    senses = simulation.step({})
    while simulation.tick < until:
        action = brain.step(senses["r1"])
        records += brain.take_records()
        senses = simulation.step({"r1": action})
    return records


@pytest.fixture(scope="module")
def lives() -> Lives:
    robots = (RobotSpec(name="r1"),)
    simulation = Simulation(Scenario(map="office", seed=3, robots=robots, starts="known"))
    config = simulation.robot_config("r1")
    old = Brain(config)
    first = drive(simulation, old, DIES)
    for _ in range(10):  # nobody answers: the wheels stop
        simulation.step({})
    brain = Brain(config.model_copy(update={"start": None, "returned": True}), NEW.incarnation)
    brain.remember(first)
    return Lives(simulation, old, first, brain, drive(simulation, brain, ENDS))


def test_the_new_life_is_placed_by_the_end_of_the_old_one(lives: Lives) -> None:
    simulation, brain = lives.simulation, lives.new
    report = brain.report()
    (own,) = (view for view in report.team if view.robot == "r1")
    assert own.alignment == State.ALIGNED.value
    reply = brain.trajectory_reply()
    # With a life whose start was known the trajectory is in the frame of the team.
    true = simulation.history.poses[reply.ticks, 0]
    apart = np.hypot(*(reply.final[:, :2] - true[:, :2]).T)
    assert apart.max() < 0.06
    turn = (Pose2.from_array(true[0]).inverse() @ Pose2.from_array(reply.final[0])).theta
    assert abs(turn) < 0.02


def test_its_own_map_holds_what_both_lives_saw(lives: Lives) -> None:
    old, both = (
        np.count_nonzero(brain.map_reply(exact=True).own.cells >= 0)
        for brain in (lives.old, lives.new)
    )
    assert both > 1.1 * old


def test_what_was_remembered_is_not_written_again(lives: Lives) -> None:
    names = [decode_record(record)[0] for record in lives.second]
    assert {name.log for name in names} == {NEW}
    assert [name.sequence for name in names] == list(range(len(names)))
    assert {decode_record(record)[0].log for record in lives.first} == {OLD}
