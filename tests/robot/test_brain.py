"""A brain is a pure object: the same senses give the same actions, also after a checkpoint."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from protocol.messages import Action, HeardFrame, Sense
from robot.brain import Brain
from robot.jobs import Jobs
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

UNKNOWN = Scenario(map="rooms-small", seed=3, robots=(RobotSpec(name="r1"), RobotSpec(name="r2")))
SCENARIO = UNKNOWN.model_copy(update={"starts": "known"})

either_start = pytest.mark.parametrize("scenario", [SCENARIO, UNKNOWN], ids=["known", "unknown"])


def make_brains(simulation: Simulation, threaded: ThreadPoolExecutor | None) -> dict[str, Brain]:
    return {
        name: Brain(simulation.robot_config(name), jobs=Jobs(threaded)) for name in simulation.names
    }


def run(
    simulation: Simulation, brains: dict[str, Brain], senses: dict[str, Sense], ticks: int
) -> tuple[dict[str, Sense], list[Action]]:
    said = []
    for _ in range(ticks):
        actions = {name: brain.step(senses[name]) for name, brain in brains.items()}
        said += [actions[name] for name in sorted(actions)]
        senses = simulation.step(actions)
    return senses, said


@either_start
def test_jobs_in_a_thread_change_nothing(scenario: Scenario) -> None:
    outcomes = []
    with ThreadPoolExecutor(1) as executor:
        for jobs in (None, executor):
            simulation = Simulation(scenario)
            brains = make_brains(simulation, jobs)
            _, said = run(simulation, brains, simulation.step({}), 80)
            maps = [brain.map_reply(exact=True).joint.cells.tobytes() for brain in brains.values()]
            journals = [brain.trajectory_reply().journal_digest for brain in brains.values()]
            outcomes.append((said, maps, journals, simulation.poses.tobytes()))
    assert outcomes[0] == outcomes[1]


@either_start
def test_a_checkpoint_carries_on_as_if_nothing_had_happened(scenario: Scenario) -> None:
    simulation = Simulation(scenario)
    brains = make_brains(simulation, None)
    senses, _ = run(simulation, brains, simulation.step({}), 60)
    world = simulation.state()
    minds = {name: brain.state() for name, brain in brains.items()}
    _, straight = run(simulation, brains, senses, 40)
    path = simulation.poses.copy()

    later = Simulation(scenario)
    later.restore(world)
    others = make_brains(later, None)
    for name, brain in others.items():
        brain.restore(minds[name])
    _, resumed = run(later, others, senses, 40)
    assert resumed == straight
    assert np.array_equal(later.poses, path)


@either_start
def test_robots_in_range_end_with_the_same_joint_map(scenario: Scenario) -> None:
    simulation = Simulation(scenario)
    brains = make_brains(simulation, None)
    senses, _ = run(simulation, brains, simulation.step({}), 100)
    # Standing still, they only talk: what was under way arrives.
    for _ in range(40):
        actions = {
            name: brain.step(senses[name]).model_copy(update={"drive": Action(tick=0).drive})
            for name, brain in brains.items()
        }
        senses = simulation.step(actions)
    one, two = (brain.trajectory_reply() for brain in brains.values())
    if one.journal_digest == two.journal_digest:
        left, right = (brain.map_reply(exact=True).joint for brain in brains.values())
        assert np.array_equal(left.cells, right.cells)
    mate = brains["r1"].report().team[1]
    assert mate.entries > 0
    assert mate.alignment == "aligned", mate.alignment_reason


def test_records_are_handed_out_once_and_before_they_are_sent() -> None:
    simulation = Simulation(SCENARIO)
    brains = make_brains(simulation, None)
    senses = simulation.step({})
    written = 0
    for _ in range(30):
        actions = {name: brain.step(senses[name]) for name, brain in brains.items()}
        records = brains["r1"].take_records()
        written += len(records)
        assert brains["r1"].take_records() == []
        senses = simulation.step(actions)
    assert written == brains["r1"].report().journal_entries


def test_nonsense_from_the_radio_is_counted_and_dropped() -> None:
    simulation = Simulation(SCENARIO)
    brains = make_brains(simulation, None)
    senses, _ = run(simulation, brains, simulation.step({}), 5)
    junk = tuple(
        HeardFrame(sender="r2", sent_tick=4, to="*", kind=kind, payload=b"\x93\x00\xff")
        for kind in ("beacon", "entries", "part", "unheard-of")
    )
    brain = brains["r1"]
    brain.step(senses["r1"].model_copy(update={"frames": junk, "frame_count": len(junk)}))
    assert brain.report().malformed == 4
