"""Who shares a map with whom now, by the robots' own word.

Robots that were not told where they start think in frames of their own. What the operator sees
follows that: two robots are in one group when both say that their maps are aligned, and what is not
in one group is never drawn as one map.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from protocol.messages import Report
from protocol.pose import Pose2
from robot.team.standing import TEAM_FRAME
from station.observer import RunOutcome
from station.report_tracks import matched
from world.accuracy import align_frames, by_frame
from world.frames import was_told
from world.simulation import Simulation

Group = tuple[str, ...]

# Where two robots say different things, the lesser word counts.
WORDS = ("contradictory", "unknown", "tentative", "aligned")
ALIGNED = "aligned"


@dataclass(frozen=True, slots=True)
class PairStatus:
    """How the maps of two robots stand to each other, and why."""

    a: str
    b: str
    state: str
    reason: str


def pairs_of(simulation: Simulation, reports: Mapping[str, Report]) -> tuple[PairStatus, ...]:
    """Every pair in the scenario's order, but for those of robots that were told where they are."""
    names = simulation.names
    told = {name for name in names if was_told(simulation, name)}
    return tuple(
        _pair(a, b, reports)
        for k, a in enumerate(names)
        for b in names[k + 1 :]
        if not {a, b} <= told
    )


def _pair(a: str, b: str, reports: Mapping[str, Report]) -> PairStatus:
    said = [_word(a, b, reports), _word(b, a, reports)]
    return PairStatus(a, b, *min(said, key=lambda word: WORDS.index(word[0])))


def _word(of: str, other: str, reports: Mapping[str, Report]) -> tuple[str, str]:
    report = reports.get(of)
    for mate in report.team if report is not None else ():
        if mate.robot == other:
            return mate.alignment, mate.alignment_reason
    return "unknown", f"{of} has said nothing yet"


def groups_of(simulation: Simulation, reports: Mapping[str, Report]) -> tuple[Group, ...]:
    """The robots that share a map, largest group first; who was told where it is shares one."""
    names = simulation.names
    told = tuple(name for name in names if was_told(simulation, name))
    groups: dict[str, Group] = {name: told if name in told else (name,) for name in names}
    for pair in pairs_of(simulation, reports):
        if pair.state == ALIGNED and groups[pair.a] != groups[pair.b]:
            joined = tuple(name for name in names if name in groups[pair.a] + groups[pair.b])
            groups.update(dict.fromkeys(joined, joined))
    return tuple(sorted(dict.fromkeys(groups.values()), key=lambda group: -len(group)))


def standing_of(group: Group, simulation: Simulation, reports: Mapping[str, Report]) -> str:
    """A group in words: who is in it, or what keeps a robot that is alone from the others."""
    if len(group) > 1:
        return f"{' '.join(group)}: one map"
    (name,) = group
    pairs = [pair for pair in pairs_of(simulation, reports) if name in (pair.a, pair.b)]
    said = [pair for pair in pairs if pair.state in ("tentative", "contradictory")]
    if not said:
        return f"{name}: no match with anybody"
    pair = said[0]
    return f"{name}: {pair.state} with {pair.a if pair.b == name else pair.b}, {pair.reason}"


# -- at the end, when robots answer in the frame of their group


def final_frames(outcome: RunOutcome) -> dict[str, Pose2]:
    """`T_world_frame` of what each robot answered, as the referee places it."""
    return align_frames(matched(outcome))


def final_groups(outcome: RunOutcome) -> tuple[Group, ...]:
    """The robots whose answers share a frame, largest group first. Who gave none is where it was
    told to be, with the others that were, or alone."""
    simulation = outcome.simulation
    frames = {name: TEAM_FRAME if was_told(simulation, name) else name for name in simulation.names}
    frames |= {name: way.frame for name, way in matched(outcome).items()}
    return tuple(sorted(by_frame(frames).values(), key=lambda group: -len(group)))
