"""Journals that meet become equal, whatever the link does to the frames."""

from dataclasses import replace

import numpy as np
import pytest

from protocol.config import PoseModel, RadioConfig, RobotConfig
from protocol.messages import HeardFrame, RadioFrame
from protocol.pose import IDENTITY, Pose2
from robot.jobs import Jobs
from robot.slam.engine import Anchor, Closure, Entry, Keyframe
from robot.team.beacon import BEACON
from robot.team.journal import EntryName, Journal, LogName
from robot.team.parcels import ENTRIES, unpack_entries
from robot.team.team import GLIMPSE_BEACONS, MEETING_TICKS, LiveState, Team

TEAM = ("r1", "r2", "r3", "r4")
LIVE = LiveState(0, IDENTITY, np.eye(3) * 1e-4, None, False)


def make_team(name: str, beams: int = 60, bytes_per_tick: int = 12_000) -> Team:
    config = RobotConfig(
        name=name,
        team=TEAM,
        start=PoseModel(x_m=float(TEAM.index(name)), y_m=0.0, theta_rad=0.0),
        radio=RadioConfig(bytes_per_tick=bytes_per_tick),
    )
    config = config.model_copy(update={"lidar": config.lidar.model_copy(update={"beams": beams})})
    return Team(config, 0, Jobs())


def knowledge(name: str, count: int, beams: int = 60) -> list[Entry]:
    rng = np.random.default_rng(TEAM.index(name))
    start = Pose2(float(TEAM.index(name)), 0.0, 0.0)
    entries: list[Entry] = [Anchor(0, start, np.eye(3))]
    for index in range(count):
        if index % 10 == 9:
            entries.append(Anchor(index // 10 + 1, Pose2(1.0, 0.1, 0.1), np.eye(3) * 1e4))
        pose = Pose2(0.1 * (index % 10), 0.0, 0.0)
        scan = rng.uniform(1.0, 5.0, beams)
        entries.append(Keyframe(index, index, index // 10, pose, np.eye(3), scan))
    return entries


def exchange(
    teams: dict[str, Team],
    ticks: range,
    links: set[frozenset[str]],
    rng: np.random.Generator | None = None,
    loss: float = 0.0,
) -> None:
    """Let robots speak each tick; with `rng`, frames are lost, repeated and put out of order."""
    air: list[tuple[str, int, RadioFrame]] = []
    for tick in ticks:
        arriving: dict[str, list[HeardFrame]] = {name: [] for name in teams}
        for sender, sent, frame in air:
            for name in teams:
                if name == sender or frame.to not in ("*", name):
                    continue
                if frozenset((sender, name)) not in links:
                    continue
                copies = 1 if rng is None else int(rng.uniform() >= loss) * int(rng.integers(1, 3))
                heard = HeardFrame(
                    sender=sender,
                    sent_tick=sent,
                    to=frame.to,
                    kind=frame.kind,
                    payload=frame.payload,
                )
                arriving[name] += [heard] * copies
        air = []
        for name, team in teams.items():
            frames = arriving[name]
            if rng is not None:
                frames = [frames[i] for i in rng.permutation(len(frames))]
            team.hear(tick, tuple(frames))
            air += [(name, tick, frame) for frame in team.speak(tick, LIVE)]


def test_two_robots_that_meet_know_the_same() -> None:
    teams = {name: make_team(name) for name in ("r1", "r2")}
    for name, team in teams.items():
        team.write(knowledge(name, 40))
    exchange(teams, range(22), {frozenset(("r1", "r2"))})
    one, two = teams["r1"], teams["r2"]
    assert len(one.journal) == len(two.journal) == 2 * (40 + 5 + 1)
    assert one.journal.digest() == two.journal.digest()


def test_a_robot_knows_when_those_in_range_hold_what_it_held() -> None:
    teams = {name: make_team(name) for name in ("r1", "r2", "r3")}
    for name, team in teams.items():
        team.write(knowledge(name, 12))
    gossip, pair = teams["r1"].gossip, {frozenset(("r1", "r2"))}
    then = teams["r1"].journal.vector()
    assert gossip.is_held(then, 0)  # nobody is there
    exchange(teams, range(3), pair)
    assert not gossip.is_held(then, 2)
    exchange(teams, range(3, 42), pair)
    assert gossip.is_held(then, 41)  # r3 is out of range, and so not asked
    teams["r1"].write(knowledge("r1", 1)[1:])
    assert gossip.is_held(then, 41)
    assert not gossip.is_held(teams["r1"].journal.vector(), 41)


def test_entries_travel_through_a_third_robot() -> None:
    teams = {name: make_team(name) for name in ("r1", "r2", "r3")}
    for name, team in teams.items():
        team.write(knowledge(name, 12))
    exchange(teams, range(22), {frozenset(("r1", "r2"))})
    # Robots that meet listen first to whom the other hears.
    exchange(teams, range(22, 84), {frozenset(("r2", "r3"))})
    assert teams["r3"].journal.count_of("r1") == 12 + 3
    assert teams["r2"].journal.digest() == teams["r3"].journal.digest()


@pytest.mark.parametrize("seed", range(4))
def test_loss_repetition_and_order_only_delay(seed: int) -> None:
    rng = np.random.default_rng(seed)
    teams = {name: make_team(name) for name in TEAM}
    links = {frozenset((a, b)) for a in TEAM for b in TEAM if a < b}
    for name, team in teams.items():
        team.write(knowledge(name, 30))
    exchange(teams, range(400), links, rng, loss=0.3)
    digests = {team.journal.digest() for team in teams.values()}
    assert len(digests) == 1
    assert len(teams["r1"].journal) == 4 * (30 + 4 + 1)
    assert not any(team.malformed for team in teams.values())


def test_nobody_is_told_at_once_what_he_wrote_himself() -> None:
    """A vector is a second old; only who still lacks his own entries later has lost them."""
    teams = {name: make_team(name) for name in ("r1", "r2")}
    told: list[EntryName] = []
    for tick in range(60):
        teams["r1"].write(knowledge("r1", 1)[1:])
        frames = {name: team.speak(tick, LIVE) for name, team in teams.items()}
        for sender, receiver in (("r1", "r2"), ("r2", "r1")):
            for frame in frames[sender]:
                if frame.kind == ENTRIES and receiver == "r1":
                    told += [name for name, _ in unpack_entries(frame.payload)]
                teams[receiver].hear(tick + 1, (heard(sender, tick, frame),))
    assert told
    assert {name.log.robot for name in told} == {"r2"}


def test_of_two_who_could_pass_a_log_on_one_does() -> None:
    """Also while its owner writes on: r4, which r1 does not hear."""
    teams = {name: make_team(name) for name in TEAM}
    teams["r4"].write(knowledge("r4", 12))
    links = {frozenset((a, b)) for a in TEAM for b in TEAM if a < b} - {frozenset(("r1", "r4"))}
    told: list[EntryName] = []
    air: list[tuple[str, int, RadioFrame]] = []
    for tick in range(400):
        if tick % 7 == 0 and tick < 300:
            teams["r4"].write([Anchor(2 + tick // 7, Pose2(1.0, 0.1, 0.1), np.eye(3))])
        for sender, sent, frame in air:
            for name in TEAM:
                if frozenset((sender, name)) in links and frame.to in ("*", name):
                    teams[name].hear(tick, (heard(sender, sent, frame),))
                    if name == "r1" and frame.kind == ENTRIES:
                        told += [entry for entry, _ in unpack_entries(frame.payload)]
        air = [(name, tick, frame) for name in TEAM for frame in teams[name].speak(tick, LIVE)]
    passed_on = [name for name in told if name.log.robot == "r4"]
    assert len(set(passed_on)) == teams["r4"].journal.count_of("r4")
    # What reached both at once for the first time neither knows the other to hold.
    repeated = {name.sequence for name in passed_on if passed_on.count(name) > 1}
    assert all(sequence < 20 for sequence in repeated), sorted(repeated)
    assert len({team.journal.digest() for team in teams.values()}) == 1


def test_nothing_new_is_sent_between_equals() -> None:
    teams = {name: make_team(name) for name in ("r1", "r2")}
    teams["r1"].write(knowledge("r1", 20))
    exchange(teams, range(42), {frozenset(("r1", "r2"))})
    frames = [frame for tick in range(42, 82) for frame in teams["r1"].speak(tick, LIVE)]
    assert not [frame for frame in frames if frame.kind == ENTRIES]


def test_the_capacity_of_the_link_is_respected() -> None:
    teams = {name: make_team(name, bytes_per_tick=2000) for name in ("r1", "r2")}
    teams["r1"].write(knowledge("r1", 200))
    sizes: list[int] = []
    two = teams["r2"]
    for tick in range(150):
        frames = teams["r1"].speak(tick, LIVE)
        sizes.append(sum(frame.size_bytes for frame in frames))
        two.hear(tick, tuple(heard("r1", tick, frame) for frame in frames))
        answer = two.speak(tick, LIVE)
        teams["r1"].hear(tick, tuple(heard("r2", tick, frame) for frame in answer))
    assert max(sizes) <= 2000
    assert two.journal.count_of("r1") == teams["r1"].journal.count_of("r1")


def test_a_long_entry_travels_in_parts() -> None:
    teams = {name: make_team(name, beams=4000) for name in ("r1", "r2")}
    teams["r1"].write(knowledge("r1", 2, beams=4000))
    exchange(teams, range(30), {frozenset(("r1", "r2"))})
    assert teams["r1"].journal.digest() == teams["r2"].journal.digest()
    log = teams["r2"].graph.log(LogName("r1", 0))
    assert log is not None
    assert len(log.keyframes) == 2


def test_joint_solutions_are_equal_to_the_last_bit() -> None:
    teams = {name: make_team(name) for name in ("r1", "r2", "r3")}
    for name, team in teams.items():
        team.write(knowledge(name, 40))
        team.write([Closure(0, 3, Pose2(2.9, 0.8, 0.35), np.eye(3) * 1e3)])
    links = {frozenset(("r1", "r2")), frozenset(("r2", "r3"))}
    exchange(teams, range(200), links, np.random.default_rng(7), loss=0.2)
    assert len({team.journal.digest() for team in teams.values()}) == 1
    for tick in range(200, 240):
        for team in teams.values():
            team.solve(tick)
    reference = teams["r1"].solution
    assert len(reference) == 3
    for team in teams.values():
        for log, poses in reference.items():
            assert np.array_equal(team.solution[log], poses)


def test_the_first_body_under_a_name_stays() -> None:
    journal = Journal()
    name = EntryName(LogName("r1", 0), 0)
    assert journal.add(name, b"first")
    assert not journal.add(name, b"second")
    assert journal.body(name) == b"first"
    assert journal.conflicts == 1


def test_malformed_frames_are_counted_and_dropped() -> None:
    team = make_team("r1")
    before = team.journal.digest()
    for kind in ("beacon", "entries", "part", "nonsense"):
        for payload in (b"", b"\xc1", b"\x93\x01\x02\x03", b"\x91\x94\xa2r2\x00\x00\x01"):
            team.hear(3, (heard("r2", 2, RadioFrame(kind=kind, payload=payload)),))
    team.hear(3, (heard("stranger", 2, RadioFrame(kind="beacon", payload=b"")),))
    assert sum(team.malformed.values()) == 17
    assert team.journal.digest() == before


def heard(sender: str, tick: int, frame: RadioFrame) -> HeardFrame:
    return HeardFrame(
        sender=sender, sent_tick=tick, to=frame.to, kind=frame.kind, payload=frame.payload
    )


def test_who_is_out_of_earshot_and_has_not_been_told() -> None:
    teams = {name: make_team(name) for name in ("r1", "r2", "r3")}
    chain = {frozenset(("r1", "r2")), frozenset(("r2", "r3"))}
    exchange(teams, range(60), {*chain, frozenset(("r1", "r3"))})
    assert teams["r1"].untold(60) == ()
    # r2 passes on what r3 is to be told; once r2 is gone too, nobody does.
    exchange(teams, range(60, 160), chain)
    assert teams["r1"].untold(160) == ()
    exchange(teams, range(160, 260), set())
    assert teams["r1"].untold(260) == ("r2", "r3")
    assert teams["r3"].untold(260) == ("r1", "r2")
    # Of a pair both go by the same name: r2 thinks of r1 first.
    assert teams["r2"].untold(260) == ("r1", "r3")


def test_who_had_finished_and_knows_everything_is_not_looked_for() -> None:
    teams = {name: make_team(name) for name in ("r1", "r2")}
    done = replace(LIVE, finished=True)
    for tick in range(100):
        said = {name: teams[name].speak(tick, done) for name in teams}
        for name, other in (("r1", "r2"), ("r2", "r1")):
            frames = tuple(
                HeardFrame(sender=other, sent_tick=tick, to=f.to, kind=f.kind, payload=f.payload)
                for f in said[other]
            )
            teams[name].hear(tick, frames)
    assert teams["r1"].untold(300) == ()
    teams["r1"].write(knowledge("r1", 3))
    assert teams["r1"].untold(300) == ("r2",)
    assert teams["r2"].untold(300) == ()


def test_who_meets_a_stranger_speaks_at_once_and_then_less_often() -> None:
    teams = {name: make_team(name) for name in ("r1", "r2")}
    exchange(teams, range(22), {frozenset(("r1", "r2"))})
    one = teams["r1"]
    one.write(knowledge("r1", 3))
    assert one.speak(23, LIVE) == []  # what is new waits for more
    spoken = {tick: one.speak(tick, replace(LIVE, meeting=True)) for tick in range(24, 36)}
    assert [frame.kind for frame in spoken[24]] == [BEACON, ENTRIES]
    beacons = [tick - 24 for tick, frames in spoken.items() if frames]
    assert beacons == [*range(GLIMPSE_BEACONS), *range(GLIMPSE_BEACONS + MEETING_TICKS - 1, 12, 3)]
    assert one.speak(37, LIVE) == []
    assert one.speak(38, replace(LIVE, meeting=True))
