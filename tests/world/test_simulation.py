"""The simulation: actions in, senses out, the same to the last bit under the same seed."""

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from maps.grid import MapFileError, OccupancyGrid
from protocol.codec import decode, encode
from protocol.config import LidarConfig, PoseModel
from protocol.messages import Action, DriveCommand, RadioFrame, Sense
from world.scenario import GateConfig, PaceConfig, RobotSpec, Scenario
from world.simulation import ALL_FINISHED, NOBODY_LEFT, TIME_LIMIT, Simulation

Steer = Callable[[str, Sense], Action | None]
DRIVE = DriveCommand(forward_mps=0.4, turn_rps=0.3)


def scenario(team: int = 2, **changes: object) -> Scenario:
    names = tuple(RobotSpec(name=f"r{i}") for i in range(1, team + 1))
    return Scenario.model_validate({"map": "rooms-small", "robots": names, "seed": 3} | changes)


def wander(name: str, sense: Sense) -> Action:
    """A way that depends on what was sensed, so that any difference grows."""
    ahead = 5.0 if sense.ranges is None else float(np.min(sense.ranges[118:139]))
    heard = sum(len(frame.payload) for frame in sense.frames)
    drive = DriveCommand(forward_mps=0.5 if ahead > 0.5 else 0.0, turn_rps=0.1 + heard % 3 * 0.2)
    frame = RadioFrame(kind="note", payload=name.encode() * (1 + sense.tick % 5))
    return Action(tick=sense.tick, drive=drive, frame_count=1, frames=(frame,))


def play(simulation: Simulation, ticks: int, steer: Steer = wander) -> list[dict[str, Sense]]:
    """All senses of so many ticks more."""
    senses = simulation.step({}) if simulation.tick < 0 else None
    seen = [senses] if senses else []
    while len(seen) < ticks:
        if senses is None:
            senses = simulation.step({})
        else:
            actions = {name: steer(name, sense) for name, sense in senses.items()}
            senses = simulation.step({n: action for n, action in actions.items() if action})
        seen.append(senses)
    return seen


def assert_same(first: Mapping[str, Sense], second: Mapping[str, Sense]) -> None:
    assert list(first) == list(second)
    for name, sense in first.items():
        other = second[name]
        assert encode(sense) == encode(other)
        assert sense.frames == other.frames


def test_one_seed_gives_one_run_and_another_seed_another() -> None:
    runs = [play(Simulation(scenario()), 60) for _ in range(2)]
    for first, second in zip(*runs, strict=True):
        assert_same(first, second)
    other = play(Simulation(scenario(seed=4)), 1)[0]
    assert encode(other["r1"]) != encode(runs[0][0]["r1"])


def test_senses_are_what_they_are_after_the_wire() -> None:
    for sense in play(Simulation(scenario()), 12)[-1].values():
        wired = decode(Sense, encode(sense)).model_copy(update={"frames": sense.frames})
        assert sense.ranges is not None
        assert wired.ranges is not None
        assert sense.ranges.dtype == wired.ranges.dtype == np.dtype("<f4")
        assert np.array_equal(sense.ranges, wired.ranges)
        assert not sense.ranges.flags.writeable
        assert sense.ranges.flags.c_contiguous
        assert (sense.encoders, sense.sightings) == (wired.encoders, wired.sightings)
        assert sense.frame_count == len(sense.frames) > 0
        assert all(type(count) is int for count in sense.encoders)


def test_tick_zero_has_everything_but_motion() -> None:
    simulation = Simulation(scenario())
    assert simulation.tick == -1
    senses = simulation.step({})
    assert (simulation.tick, simulation.stamp) == (0, 0.0)
    for name in simulation.names:
        assert (senses[name].tick, senses[name].stamp, senses[name].encoders) == (0, 0.0, (0, 0))
        assert senses[name].ranges is not None
    assert np.array_equal(simulation.poses, simulation.starts)
    assert len(simulation.history) == 1


def test_scans_come_every_so_many_ticks() -> None:
    simulation = Simulation(scenario(lidar=LidarConfig(every_ticks=4)))
    due = [senses["r1"].ranges is not None for senses in play(simulation, 9)]
    assert due == [True, False, False, False, True, False, False, False, True]


def test_a_checkpoint_goes_on_as_if_nothing_had_happened() -> None:
    settings = scenario(radio=GateConfig(loss=0.2, latency_ticks=3))
    simulation = Simulation(settings)
    senses = play(simulation, 25)[-1]
    checkpoint = simulation.state()
    restored = Simulation(settings)
    restored.restore(checkpoint)
    mirror = senses
    for _ in range(20):
        senses = simulation.step({name: wander(name, s) for name, s in senses.items()})
        mirror = restored.step({name: wander(name, s) for name, s in mirror.items()})
        assert_same(senses, mirror)
    assert simulation.ledger.to_dict() == restored.ledger.to_dict()
    assert np.array_equal(simulation.history.poses, restored.history.poses)


def test_the_death_of_a_robot_far_away_changes_nothing_for_another() -> None:
    apart = (
        RobotSpec(name="r1", start=PoseModel(x_m=1.5, y_m=1.5, theta_rad=0.0)),
        RobotSpec(name="r2", start=PoseModel(x_m=18.5, y_m=12.5, theta_rad=1.0)),
    )
    spread = scenario(map="loop", robots=apart, radio=GateConfig(range_m=0.0))
    whole, half = Simulation(spread), Simulation(spread)
    first, second = play(whole, 10), play(half, 10)
    half.mark_dead("r2")
    for _ in range(30):
        first.append(whole.step({n: wander(n, s) for n, s in first[-1].items()}))
        second.append(half.step({"r1": wander("r1", second[-1]["r1"])}))
        assert encode(first[-1]["r1"]) == encode(second[-1]["r1"])


def test_the_dead_stand_hear_nothing_and_are_not_awaited() -> None:
    simulation = Simulation(scenario())
    play(simulation, 10)
    simulation.mark_dead("r2")
    senses = simulation.step({})
    for _ in range(10):
        senses = simulation.step({"r1": wander("r1", senses["r1"])})
    where = simulation.poses[1].copy()
    senses = simulation.step({"r1": wander("r1", senses["r1"])})
    assert np.array_equal(simulation.poses[1], where)
    assert senses["r2"].frames == ()
    assert simulation.alive == ("r1",)
    assert simulation.links.sum() == 0
    pair = next(row for row in simulation.ledger.table() if row["receiver"] == "r2")
    assert pair["dropped"]["absent"]["frames"] > 0
    last = Action(tick=simulation.tick, finished=True)
    assert simulation.step({"r1": last}) == {}
    assert simulation.exit_reason == ALL_FINISHED


def test_a_robot_whose_radio_is_off_hears_nothing_until_it_is_on_again() -> None:
    simulation = Simulation(scenario())
    senses = play(simulation, 10)[-1]
    assert senses["r2"].frames
    heard = []
    for listens in (False, False, True, True):
        simulation.set_listening("r2", listens)
        senses = simulation.step({name: wander(name, sense) for name, sense in senses.items()})
        heard.append(bool(senses["r2"].frames))
    assert heard[:2] == [False, False]
    assert heard[3]
    pair = next(row for row in simulation.ledger.table() if row["receiver"] == "r2")
    assert pair["dropped"]["absent"]["frames"] > 0
    simulation.ledger.check()


def test_a_run_ends_when_all_are_finished_and_all_that_was_sent_is_booked() -> None:
    simulation = Simulation(scenario())
    sent = heard = 0
    senses = simulation.step({})
    while not simulation.done:
        actions = {}
        for name, sense in senses.items():
            heard += len(sense.frames)
            frames = (RadioFrame(kind="x", payload=b"1"),) * 2
            sent += len(frames)
            done = sense.tick >= 5 or name == "r1"
            actions[name] = Action(tick=sense.tick, finished=done, frame_count=2, frames=frames)
        senses = simulation.step(actions)
    assert (simulation.tick, simulation.exit_reason) == (5, ALL_FINISHED)
    assert simulation.finished == ("r1", "r2")
    assert senses == {}
    assert simulation.ledger.sent[:, 0].sum() == sent
    assert simulation.ledger.heard[:, 0].sum() == heard
    assert simulation.step(actions) == {}
    assert simulation.ledger.sent[:, 0].sum() == sent


def test_a_robot_may_change_its_mind_about_being_finished() -> None:
    simulation = Simulation(scenario())
    simulation.step({})
    simulation.step({"r1": Action(tick=0, finished=True)})
    assert simulation.finished == ("r1",)
    simulation.step({"r1": Action(tick=1), "r2": Action(tick=1, finished=True)})
    assert simulation.finished == ("r2",)
    assert not simulation.done


def test_a_run_ends_at_the_time_limit_and_when_nobody_is_left() -> None:
    simulation = Simulation(scenario(max_sim_s=2.0))
    play(simulation, 22)
    assert (simulation.exit_reason, simulation.tick) == (TIME_LIMIT, 20)
    simulation = Simulation(scenario(1))
    play(simulation, 5)
    simulation.mark_dead("r1")
    assert simulation.step({}) == {}
    assert simulation.exit_reason == NOBODY_LEFT


def test_a_shell_may_end_a_run_and_the_last_actions_are_booked() -> None:
    simulation = Simulation(scenario())
    senses = simulation.step({})
    simulation.end("interrupted")
    simulation.end("again")
    assert simulation.step({n: wander(n, s) for n, s in senses.items()}) == {}
    assert (simulation.exit_reason, simulation.tick) == ("interrupted", 0)
    assert simulation.ledger.sent[:, 0].tolist() == [1, 1]
    unborn = Simulation(scenario())
    unborn.end("interrupted")
    assert unborn.step({}) == {}


def test_an_old_command_stops_counting() -> None:
    simulation = Simulation(scenario(1, pace=PaceConfig(dead_man_s=0.5)))
    simulation.step({})
    simulation.step({"r1": Action(tick=0, drive=DriveCommand(turn_rps=1.0))})
    turns = []
    for _ in range(12):
        simulation.step({})
        turns.append(simulation.history.velocities[-1, 0, 1])
    assert turns[:4] == pytest.approx([1.0] * 4)
    assert turns[-1] == 0.0
    assert np.flatnonzero(np.array(turns) < 1.0)[0] == 4


def test_a_late_command_counts_from_the_tick_that_it_answers() -> None:
    simulation = Simulation(scenario(1, pace=PaceConfig(dead_man_s=0.5)))
    for _ in range(9):
        simulation.step({})
    spin = DriveCommand(turn_rps=1.0)
    simulation.step({"r1": Action(tick=simulation.tick - 5, drive=spin)})
    assert simulation.history.velocities[-1, 0, 1] == 0.0
    simulation.step({"r1": Action(tick=simulation.tick - 4, drive=spin)})
    assert simulation.history.velocities[-1, 0, 1] > 0.0


def test_an_overtaken_command_is_not_obeyed() -> None:
    simulation = Simulation(scenario(1))
    for _ in range(4):
        simulation.step({})
    simulation.step({"r1": Action(tick=3, drive=DriveCommand(turn_rps=1.0))})
    simulation.step({"r1": Action(tick=2, drive=DriveCommand(turn_rps=-1.0))})
    assert simulation.history.velocities[-1, 0, 1] > 0.0
    simulation.halt("r1")
    for _ in range(4):
        simulation.step({})
    assert simulation.history.velocities[-1, 0, 1] == 0.0


def test_what_a_shell_must_not_do_is_refused() -> None:
    simulation = Simulation(scenario())
    with pytest.raises(ValueError, match="before tick 0"):
        simulation.step({"r1": Action(tick=0)})
    simulation.step({})
    with pytest.raises(ValueError, match="no such robots in this scenario: r9"):
        simulation.step({"r9": Action(tick=0)})
    with pytest.raises(MapFileError, match="no map 'atlantis'"):
        Simulation(scenario(map="atlantis"))


def test_a_robot_is_told_who_it_is() -> None:
    radio = GateConfig(range_m=7.0, loss=0.5)
    simulation = Simulation(scenario(3, radio=radio, starts="known"))
    config = simulation.robot_config("r2")
    assert (config.name, config.team) == ("r2", ("r1", "r2", "r3"))
    assert config.start is not None
    assert config.start.to_pose().to_array().tolist() == simulation.starts[1].tolist()
    assert config.radio.range_m == 7.0
    assert decode(type(config), encode(config)) == config


def test_history_keeps_every_tick() -> None:
    simulation = Simulation(scenario())
    play(simulation, 300)
    history = simulation.history
    assert history.poses.shape == (300, 2, 3)
    assert np.array_equal(history.poses[-1], simulation.poses)
    assert np.array_equal(history.poses[0], simulation.starts)
    assert (np.diff(history.collisions, axis=0) >= 0).all()
    assert simulation.collisions == dict(
        zip(("r1", "r2"), history.collisions[-1].tolist(), strict=True)
    )
    assert simulation.link_history.shape == (300, 2, 2)
    assert np.array_equal(simulation.link_history[-1], simulation.links)
    apart = np.hypot(*(history.poses[:, 0, :2] - history.poses[:, 1, :2]).T)
    near = apart <= simulation.scenario.radio.range_m
    assert np.array_equal(simulation.link_history[:, 0, 1], near)
    steps = np.diff(history.poses[:, 0, :2], axis=0)
    assert history.driven_m(0) == pytest.approx(np.hypot(*steps.T).sum())


def test_memory_grows_by_little_more_than_the_history() -> None:
    simulation = Simulation(scenario(team=4, radio={"loss": 0.3, "latency_ticks": 3}))
    play(simulation, 600)
    before = len(simulation.state())
    play(simulation, 1200)
    history = simulation.history
    rows = [history.poses, history.velocities, history.collisions, history.present]
    per_tick = sum(array[0].nbytes for array in rows)
    assert per_tick == 4 * 49
    assert len(simulation.state()) - before < 1.7 * 1200 * per_tick


def test_a_gap_in_the_answers_is_a_gap_and_no_more() -> None:
    """A robot that is silent for long stops by itself, and goes on when it speaks again."""
    simulation = Simulation(scenario())

    def silent(name: str, sense: Sense) -> Action | None:
        mute = name == "r1" and 20 <= sense.tick < 60
        return None if mute else wander(name, sense)

    senses = play(simulation, 100, silent)
    assert [sense["r1"].tick for sense in senses] == list(range(100))
    drove = simulation.history.velocities[:, 0, 0]
    # The command of tick 19 counts until it is half a second old; then the wheels run out.
    assert (drove[35:60] == 0.0).all()
    assert simulation.history.velocities[30:60, 0].any(axis=1).sum() <= 5
    turned = np.array([sense["r1"].encoders for sense in senses])
    assert np.array_equal(turned[36], turned[60])
    assert (turned[61:] != turned[60]).any()
    assert simulation.history.velocities[30:60, 1].any(axis=1).sum() > 20


def test_a_grid_may_take_the_place_of_the_map() -> None:
    grid = OccupancyGrid(np.zeros((60, 60), dtype=np.int8), 0.05, 0.0, 0.0)
    simulation = Simulation(scenario(1, map="none"), grid)
    ranges = simulation.step({})["r1"].ranges
    assert ranges is not None
    assert np.isfinite(ranges).all()


@settings(max_examples=10, deadline=None)
@given(
    forward=st.floats(-1e300, 1e300),
    turn=st.floats(-1e300, 1e300),
    tick=st.integers(0, 2**53),
    to=st.sampled_from(["*", "r1", "r2", "r9"]),
    size=st.integers(0, 1400),
)
def test_no_valid_action_upsets_the_world(
    forward: float, turn: float, tick: int, to: str, size: int
) -> None:
    simulation = Simulation(scenario())
    simulation.step({})
    frames = (RadioFrame(to=to, kind="x", payload=bytes(size)),) * 3
    drive = DriveCommand(forward_mps=forward, left_mps=turn, turn_rps=turn)
    for _ in range(5):
        simulation.step({"r1": Action(tick=tick, drive=drive, frame_count=3, frames=frames)})
    assert np.isfinite(simulation.poses).all()
    simulation.ledger.check()
