"""Links between robots say where things truly are, and only what both logs can bear."""

import numpy as np
import pytest

from protocol.pose import FloatArray, Pose2
from robot.brain import Brain
from robot.slam.engine import Anchor
from robot.team.entries import Hello, Link, decode_entry, encode_entry
from robot.team.evidence import Kind
from robot.team.joint import JointGraph, solve
from robot.team.journal import LogName
from robot.team.links import fuse
from robot.team.log_graph import LogGraph
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

ONE, TWO = LogName("r1", 0), LogName("r2", 0)


def hello(x: float) -> Hello:
    return Hello(Pose2(x, 0.0, 0.0), 5, -1.0, 0.5, 12.0, 0.2)


def two_logs() -> JointGraph:
    """Two robots that start 10 m apart and drive towards each other, each with a bent odometry."""
    graph = JointGraph()
    for name, start, step in ((ONE, 0.0, 1.02), (TWO, 10.0, -0.98)):
        graph.add(name, hello(start))
        graph.add(name, Anchor(0, Pose2(start, 0.0, 0.0), np.eye(3)))
        for index in range(1, 6):
            graph.add(name, Anchor(index, Pose2(step, 0.02, 0.0), np.eye(3) * 100.0))
    return graph


def test_a_link_survives_its_encoding() -> None:
    link = Link(3, TWO, 7, Pose2(0.5, -0.25, 1.0), np.eye(3) * 64.0)
    back = decode_entry(encode_entry(link), 0)
    assert isinstance(back, Link)
    assert (back.of, back.log, back.to) == (3, TWO, 7)
    assert np.abs((back.T_of_to.inverse() @ link.T_of_to).log()).max() < 3e-4
    np.testing.assert_allclose(back.information, link.information, rtol=0.075)


def test_measurements_of_the_same_anchors_become_one_link() -> None:
    """As the least-squares solution of both has it, with the information of both."""
    one = Link(3, TWO, 7, Pose2(1.0, 0.0, 0.5), np.diag([100.0, 300.0, 1000.0]))
    two = Link(3, TWO, 7, one.T_of_to @ Pose2(0.04, 0.04, 0.02), np.diag([300.0, 100.0, 1000.0]))
    both = fuse([one, two])
    step = (one.T_of_to.inverse() @ both.T_of_to).log()
    np.testing.assert_allclose(step, [0.03, 0.01, 0.01], atol=5e-4)
    np.testing.assert_array_equal(both.information, one.information + two.information)
    assert fuse([one]) is one


def test_a_link_pulls_two_logs_together() -> None:
    graph = two_logs()
    apart = solve(graph.problem())
    assert graph.add(ONE, Link(5, TWO, 5, Pose2(0.0, 0.0, 0.0), np.eye(3) * 1e6))
    tied = solve(graph.problem())
    gap = np.abs(apart[ONE][5] - apart[TWO][5])
    assert gap[0] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(tied[ONE][5] - tied[TWO][5]).max() < 1e-3
    # The sides are equally sure of themselves, so they meet half way.
    assert tied[ONE][5][0] == pytest.approx(5.0, abs=0.11)


def test_a_link_to_what_is_not_here_yet_waits() -> None:
    graph = two_logs()
    before = solve(graph.problem())
    assert graph.add(ONE, Link(5, TWO, 99, Pose2(3.0, 0.0, 0.0), np.eye(3) * 1e6))
    assert graph.add(ONE, Link(5, LogName("r9", 0), 0, Pose2(3.0, 0.0, 0.0), np.eye(3)))
    after = solve(graph.problem())
    for name in (ONE, TWO):
        np.testing.assert_array_equal(before[name], after[name])


def test_a_link_that_makes_no_sense_is_refused() -> None:
    graph = two_logs()
    pose, information = Pose2(0.0, 0.0, 0.0), np.eye(3)
    assert not graph.add(ONE, Link(99, TWO, 0, pose, information))
    assert not graph.add(ONE, Link(0, ONE, 1, pose, information))


def true_anchors(log: LogGraph, truth: FloatArray) -> dict[int, Pose2]:
    """Where anchors truly were, by the first keyframe of each."""
    found: dict[int, Pose2] = {}
    for keyframe in log.keyframes:
        pose = Pose2.from_array(truth[keyframe.tick]) @ keyframe.T_anchor_keyframe.inverse()
        found.setdefault(keyframe.anchor, pose)
    return found


def test_robots_in_one_building_find_true_links() -> None:
    names = ("r1", "r2")
    simulation = Simulation(
        Scenario(
            map="loop",
            seed=5,
            robots=tuple(RobotSpec(name=name) for name in names),
            starts="known",
        )
    )
    brains = {name: Brain(simulation.robot_config(name)) for name in names}
    senses = simulation.step({})
    for _ in range(600):
        senses = simulation.step({name: brains[name].step(senses[name]) for name in senses})
        if not senses:
            break
    graph = brains["r1"]._team.graph
    logs = {name: graph.log(LogName(name, 0)) for name in names}
    truth = {
        name: true_anchors(log, simulation.history.poses[:, i])
        for i, (name, log) in enumerate(logs.items())
        if log is not None
    }
    # Two that see each other before they heard where the other started note that too.
    links = [
        (name, link)
        for name, log in logs.items()
        if log is not None
        for link in log.links
        if link.evidence.kind is not Kind.SIGHTING
    ]
    assert links
    for name, link in links:
        if link.of in truth[name] and link.to in truth[link.log.robot]:
            there = truth[name][link.of].inverse() @ truth[link.log.robot][link.to]
            error = there.inverse() @ link.T_of_to
            assert np.hypot(error.x, error.y) < 0.08
            assert abs(error.theta) < 0.02
