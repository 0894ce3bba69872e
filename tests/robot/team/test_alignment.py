"""Two robots that were not told where they start find out, and hold back while they cannot know."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import pytest

from protocol.config import LidarConfig
from protocol.pose import IDENTITY, FloatArray, Pose2
from robot.jobs import Jobs
from robot.perception.returns import Returns, noise_model
from robot.perception.scan import perceive
from robot.slam.engine import Anchor, Keyframe
from robot.team.alignment import Alignment, align
from robot.team.entries import Hello, Known, Link, decode_entry, encode_entry
from robot.team.evidence import Evidence, Kind, weight_of
from robot.team.hypothesis import MAX_HYPOTHESES, MIN_SIGHTINGS, solve_alone
from robot.team.joint import JointGraph, solve
from robot.team.journal import LogName
from robot.team.near_matches import near_matches
from robot.team.pair_judge import State
from robot.team.place import chained_poses, make_place, stretches
from robot.team.place_match import find_place, match_from
from robot.team.place_search import SearchGround, rotations
from robot.team.standing import Standing
from world.lidar import Lidars
from world.noise import Noise
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

ONE, TWO = LogName("r1", 0), LogName("r2", 0)
NOISE = noise_model(LidarConfig())
EVERY = 12  # keyframes of an anchor


@dataclass(frozen=True)
class Recorded:
    """What two robots found out by themselves, without their starts, and how these truly lie."""

    logs: dict[LogName, list[Known]]
    T_one_two: Pose2


def wander(simulation: Simulation, seed: int, start: Pose2, keyframes: int) -> list[Pose2]:
    """Poses 0.3 m apart on a way that turns aside before walls."""
    rng = np.random.default_rng(seed)
    poses = [start]
    while len(poses) < keyframes:
        turn = float(rng.normal(0.0, 0.08))
        ahead = poses[-1] @ Pose2(0.3, 0.0, turn)
        while simulation.terrain.disc_overlaps(ahead.x, ahead.y, 0.3):
            turn += 0.5
            ahead = poses[-1] @ Pose2(0.0, 0.0, turn) @ Pose2(0.3, 0.0, 0.0)
        poses.append(ahead)
    return poses


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    """What two robots see on their ways through the office, with little drift."""
    simulation = Simulation(Scenario(map="office", robots=(RobotSpec(name="r1"),)))
    start = Pose2.from_array(simulation.starts[0])
    ways = {
        ONE: wander(simulation, 1, start, 90),
        TWO: wander(simulation, 2, start @ Pose2(0.0, 0.0, 2.0), 90),
    }
    lidar, rng, tick = LidarConfig(), np.random.default_rng(4), 0
    lidars, noise = Lidars(lidar, ("r1",), 0.2), Noise(7)
    logs: dict[LogName, list[Known]] = {}
    for name, way in ways.items():
        hello = Hello(None, lidar.beams, lidar.angle_min_rad, lidar.increment_rad, 12.0, 0.2)
        logs[name] = [hello, Anchor(0, Pose2(0.0, 0.0, 0.0), np.eye(3) * 1e6)]
        for k, pose in enumerate(way):
            if k % EVERY == 0 and k:
                step = way[k - EVERY].inverse() @ pose
                step = step @ Pose2.from_array(rng.normal(0.0, [0.003, 0.003, 0.0005]))
                information = np.diag([1e5, 1e5, 4e6])
                logs[name].append(Anchor(k // EVERY, step, information))
            (seen,) = lidars.scan(simulation.terrain, pose.to_array()[None], tick, noise)
            ranges = perceive(seen, lidar).ranges
            tick += 1
            T_anchor = way[k - k % EVERY].inverse() @ pose
            keyframe = Keyframe(k, k, k // EVERY, T_anchor, np.eye(3) * 1e-5, ranges)
            logs[name].append(decode_entry(encode_entry(keyframe), k))
    return Recorded(logs, ways[ONE][0].inverse() @ ways[TWO][0])


def graph_of(recorded: Recorded) -> JointGraph:
    graph = JointGraph()
    for name, entries in recorded.logs.items():
        for entry in entries:
            assert graph.add(name, entry)
    return graph


@pytest.fixture(scope="module")
def found(recorded: Recorded) -> list[Link]:
    """Every match of a place of one robot in those of the other."""
    graph = graph_of(recorded)
    places = {}
    for name in (ONE, TWO):
        log = graph.log(name)
        assert log is not None
        places[name] = [make_place(log, s, NOISE) for s in stretches(log, whole=True)]
    links = []
    for ours in places[ONE]:
        ground = SearchGround.of(ours)
        for theirs in places[TWO]:
            for match in find_place(ground, theirs):
                information = match.information
                links.append(
                    Link(ours.anchor, TWO, theirs.anchor, match.T_a_b, information, match.evidence)
                )
    return links


def aligned_by(recorded: Recorded, links: list[Link]) -> tuple[JointGraph, Alignment]:
    graph = graph_of(recorded)
    for link in links:
        assert graph.add(ONE, link)
    return graph, align(graph, NOISE)


def error(found: Pose2 | None, true: Pose2) -> tuple[float, float]:
    assert found is not None
    missed = true.inverse() @ found
    return math.hypot(missed.x, missed.y), abs(missed.theta)


def test_robots_find_out_how_they_stand(recorded: Recorded, found: list[Link]) -> None:
    graph, alignment = aligned_by(recorded, found)
    view = alignment.pair(TWO, ONE)
    assert view is not None and view.state is State.ALIGNED, view
    metres, radians = error(view.T_a_b, recorded.T_one_two)
    assert metres < 0.05 and radians < math.radians(1.0)
    assert [group.logs for group in alignment.groups] == [(ONE, TWO)]
    solution = solve(graph.problem(alignment.groups[0]))
    np.testing.assert_array_equal(solution[ONE][0], np.zeros(3))


def test_nothing_found_is_nothing_known(recorded: Recorded, found: list[Link]) -> None:
    _, alignment = aligned_by(recorded, [])
    view = alignment.pair(ONE, TWO)
    assert view is not None and view.state is State.UNKNOWN
    assert [group.logs for group in alignment.groups] == [(ONE,), (TWO,)]
    _, alignment = aligned_by(recorded, _shifted(recorded, found[:1], Pose2(1.5, 1.0, 0.5)))
    view = alignment.pair(ONE, TWO)
    assert view is not None and view.state is State.TENTATIVE
    assert all(not group.links for group in alignment.groups)


def test_one_match_is_enough_if_the_maps_agree_to_the_last_bit(
    recorded: Recorded, found: list[Link]
) -> None:
    best = max(found, key=lambda link: weight_of(link.evidence))
    _, alignment = aligned_by(recorded, [best])
    view = alignment.pair(ONE, TWO)
    assert view is not None and view.state is State.ALIGNED and view.overlap is not None
    assert view.overlap.crossing < 0.01 and view.overlap.hits > 0.95
    alike = dataclasses.replace(best.evidence, ambiguity=0.95)
    _, alignment = aligned_by(recorded, [dataclasses.replace(best, evidence=alike)])
    view = alignment.pair(ONE, TWO)
    assert view is not None and view.state is State.TENTATIVE


def test_the_order_of_entries_does_not_matter(recorded: Recorded, found: list[Link]) -> None:
    graph, alignment = aligned_by(recorded, found)
    turned = JointGraph()
    for name in (TWO, ONE):
        for entry in recorded.logs[name]:
            turned.add(name, entry)
    for link in found:
        turned.add(ONE, link)
    again = align(turned, NOISE)
    assert again == alignment
    one, other = solve(graph.problem(alignment.groups[0])), solve(turned.problem(again.groups[0]))
    for name in (ONE, TWO):
        np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_false_matches_do_not_move_the_map(
    recorded: Recorded, found: list[Link], share: float
) -> None:
    rng = np.random.default_rng(3)
    count = round(len(found) * share / (1.0 - share))
    lies = [false_link(rng, found[int(rng.integers(len(found)))]) for _ in range(count)]
    _, alignment = aligned_by(recorded, [*found, *lies])
    view = alignment.pair(ONE, TWO)
    assert view is not None
    if view.state is State.ALIGNED:
        metres, radians = error(view.T_a_b, recorded.T_one_two)
        assert metres < 0.05 and radians < math.radians(1.0)


def false_link(rng: np.random.Generator, like: Link) -> Link:
    T: FloatArray = np.append(rng.uniform(-15.0, 15.0, 2), rng.uniform(-np.pi, np.pi))
    evidence = Evidence(Kind.PLACE, 0.6, 0.95, 0.01, 0.8)
    return Link(like.of, like.log, like.to, Pose2.from_array(T), like.information, evidence)


def _shifted(recorded: Recorded, links: list[Link], T_wrong: Pose2) -> list[Link]:
    """The links as they would be if the other log lay elsewhere, all alike."""
    one = solve_alone(graph_of(recorded), ONE).anchors
    out = []
    for link in links:
        T = Pose2.from_array(one[link.of])
        out.append(dataclasses.replace(link, T_of_to=T.inverse() @ T_wrong @ T @ link.T_of_to))
    return out


def test_agreed_lies_are_found_out_by_the_maps(recorded: Recorded, found: list[Link]) -> None:
    """Matches that agree with each other on a wrong alignment let rays run through walls."""
    lies = _shifted(recorded, found, Pose2(1.5, 1.0, 0.5))
    _, alignment = aligned_by(recorded, lies)
    view = alignment.pair(ONE, TWO)
    assert view is not None and view.state is State.CONTRADICTORY


def test_new_evidence_takes_an_alignment_back(recorded: Recorded, found: list[Link]) -> None:
    _, before = aligned_by(recorded, found)
    assert [group.logs for group in before.groups] == [(ONE, TWO)]
    sighting = Evidence(Kind.SIGHTING)
    lies = _shifted(recorded, found, Pose2(1.5, 1.0, 0.5))
    strong = [dataclasses.replace(lie, evidence=sighting) for lie in lies]
    _, after = aligned_by(recorded, [*found, *strong])
    view = after.pair(ONE, TWO)
    assert view is not None and view.state is State.CONTRADICTORY
    assert [group.logs for group in after.groups] == [(ONE,), (TWO,)]
    assert not any(group.links for group in after.groups)


def test_sightings_alone_align(recorded: Recorded) -> None:
    information = np.diag([1e3, 1e3, 1e3])
    # Both first anchors lie at the starts.
    link = Link(0, TWO, 0, recorded.T_one_two, information, Evidence(Kind.SIGHTING))
    wrong = dataclasses.replace(link, T_of_to=link.T_of_to @ Pose2(1.5, 1.0, 0.5))
    _, alignment = aligned_by(recorded, [wrong])
    view = alignment.pair(ONE, TWO)
    assert view is not None and view.state is State.TENTATIVE
    _, alignment = aligned_by(recorded, [link, link])
    view = alignment.pair(ONE, TWO)
    assert view is not None and view.state is State.ALIGNED


def test_places_do_not_outvote_sightings(recorded: Recorded, found: list[Link]) -> None:
    """In rows of rooms many alignments are worth more than two glimpses of a robot."""
    lies = [
        lie
        for k in range(MAX_HYPOTHESES + 1)
        for lie in _shifted(recorded, found, Pose2(1.5 + 1.5 * k, 1.0, 0.5))
    ]
    seen = Link(0, TWO, 0, recorded.T_one_two, np.eye(3) * 1e3, Evidence(Kind.SIGHTING))
    _, alignment = aligned_by(recorded, lies)
    view = alignment.pair(ONE, TWO)
    assert view is not None and view.state is not State.ALIGNED
    _, alignment = aligned_by(recorded, [*lies, seen, seen])
    view = alignment.pair(ONE, TWO)
    assert view is not None and view.state is State.ALIGNED
    assert view.sightings == 2
    assert view.rival > 1.0


def test_near_matches_make_it_precise(recorded: Recorded, found: list[Link]) -> None:
    graph, alignment = aligned_by(recorded, found)
    solution = solve(graph.problem(alignment.groups[0]))
    places = {}
    for name in (ONE, TWO):
        log = graph.log(name)
        assert log is not None
        places[name] = [make_place(log, s, NOISE) for s in stretches(log, whole=True)]
    near = near_matches(solution, places, ONE, TWO)
    assert near and all(link.evidence.kind is Kind.NEAR for link in near)
    graph, alignment = aligned_by(recorded, [*found, *near])
    assert {(ONE, len(found))} <= alignment.groups[0].links


def test_a_place_is_found_in_itself_without_bias(recorded: Recorded) -> None:
    """Half a cell forgotten somewhere would shift every match the same way."""
    log = graph_of(recorded).log(ONE)
    assert log is not None
    place = make_place(log, stretches(log, whole=True)[0], NOISE)
    for guess in (Pose2(0.06, -0.05, 0.01), Pose2(-0.06, 0.05, -0.01)):
        match = match_from(place, place, guess)
        assert np.abs(match.T_a_b.to_array()).max() < 2e-3
    found = find_place(SearchGround.of(place), place)[0]
    assert np.abs(found.T_a_b.to_array()).max() < 5e-3 and found.evidence.crossing < 0.02


def test_a_wall_is_not_known_from_its_other_side(recorded: Recorded) -> None:
    """Two sides of a thin wall match as well as one side matches itself."""
    log = graph_of(recorded).log(ONE)
    assert log is not None
    place = make_place(log, stretches(log, whole=True)[0], NOISE)
    surfaces = place.surfaces
    from_behind = Returns(surfaces.values * [1.0, 1.0, -1.0, -1.0, 1.0, 1.0], surfaces.links)
    assert place.walls.faced(IDENTITY, surfaces) > 0.9
    assert place.walls.faced(IDENTITY, from_behind) < 0.3


def test_places_do_not_change_when_the_log_grows(recorded: Recorded) -> None:
    entries = recorded.logs[ONE]
    whole = graph_of(recorded).log(ONE)
    assert whole is not None
    half = dataclasses.replace(whole, keyframes=whole.keyframes[: len(whole.keyframes) // 2])
    assert entries and stretches(half) == stretches(whole)[: len(stretches(half))]
    poses = chained_poses(whole, 0, len(whole.keyframes))
    assert len(poses) == len(whole.keyframes)


def test_rotations_hold_the_right_one_and_its_opposite() -> None:
    rng = np.random.default_rng(1)
    b = np.convolve(rng.uniform(0.0, 1.0, 180) ** 8, np.ones(5), "same")
    for turn in (0, 17, 90, 179):
        a = np.roll(b, turn)
        tried = rotations(a / np.linalg.norm(a), b / np.linalg.norm(b)).tolist()
        assert {turn % 360, (turn + 180) % 360} <= set(tried)
        assert len(set(tried)) == len(tried)


def test_a_match_counts_once_the_anchor_that_it_names_is_there(recorded: Recorded) -> None:
    whole = graph_of(recorded)
    there = Pose2.from_array(solve_alone(whole, TWO).anchors[-1])
    graph, late = JointGraph(), recorded.logs[TWO]
    last = max(k for k, entry in enumerate(late) if isinstance(entry, Anchor))
    for name, entries in ((ONE, recorded.logs[ONE]), (TWO, late[:last])):
        for entry in entries:
            assert graph.add(name, entry)
    anchor = late[last]
    assert isinstance(anchor, Anchor)
    evidence, information = Evidence(Kind.SIGHTING), np.diag([1e3, 1e3, 1e4])
    link = Link(0, TWO, anchor.index, recorded.T_one_two @ there, information, evidence)
    for _ in range(MIN_SIGHTINGS):
        assert graph.add(ONE, link)
    standing, jobs = Standing(ONE, None, LidarConfig()), Jobs()
    for tick in range(200):
        standing.note_entry()
        standing.step(tick, jobs, graph)
    assert not standing.pairs
    for entry in late[last:]:
        assert graph.add(TWO, entry)
    for tick in range(200, 300):
        standing.note_entry()
        standing.step(tick, jobs, graph)
    assert [view.state for view in standing.pairs] == [State.ALIGNED]
    assert TWO in standing.solution
