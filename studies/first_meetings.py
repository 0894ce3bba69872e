"""How soon two robots that see each other know how their maps fit.

    python -m studies.first_meetings scoring repeating --seeds 0-4 --json meetings.json

Two robots explore each world from random starts that they do not know. From the first tick at which
they see and hear each other both get `WITHIN_S` to call their maps aligned and see the other within
`RIGHT_M` and `RIGHT_RAD` of where it is; false is who is aligned otherwise by then. Runs in which
they do not meet within `--limit` are listed and not counted.
"""

import sys
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from statistics import median

from protocol.messages import Report
from protocol.model import Model
from protocol.pose import IDENTITY, Pose2
from robot.brain import Brain
from station.scenario_file import changed
from station.warm_up import ensure_warm
from studies.command import one_line_errors, study_parser, write_figures
from studies.lone_journals import file_name
from studies.merging_worlds import worlds_of
from studies.trials import parse_seeds
from world.scenario import Scenario
from world.simulation import Simulation

WITHIN_S = 10.0
# What tells a right alignment from one of another place; sightings alone are good to a decimetre.
RIGHT_M, RIGHT_RAD = 0.5, 0.1
ALIGNED = "aligned"


class Meeting(Model):
    """Of one run: when the two met first (None: never), how long it took until both were aligned
    and right (None: not aligned in time), and by how much that was off at most; their reasons."""

    world: str
    seed: int
    met_s: float | None
    took_s: float | None = None
    error_m: float | None = None
    error_rad: float | None = None
    reasons: tuple[str, ...] = ()

    @property
    def outcome(self) -> str:
        """What it counts as."""
        if self.met_s is None:
            return "never met"
        if self.took_s is None or self.error_m is None or self.error_rad is None:
            return "undecided"
        right = self.error_m <= RIGHT_M and self.error_rad <= RIGHT_RAD
        return "right" if right else "false"


def play(world: str, seed: int, limit_s: float) -> Meeting:
    """One run, up to its first meeting and `WITHIN_S` longer."""
    values = {"map": world, "seed": seed, "max_sim_s": limit_s + WITHIN_S}
    simulation = Simulation(changed(Scenario(), values, robots=2))
    brains = {name: Brain(simulation.robot_config(name)) for name in simulation.names}
    senses = simulation.step({})
    met: float | None = None
    found = Meeting(world=world, seed=seed, met_s=None)
    while not simulation.done and (simulation.stamp <= limit_s or met is not None):
        if met is None and simulation.links[0, 1] and all(s.sightings for s in senses.values()):
            met = simulation.stamp
        senses = simulation.step({name: brain.step(senses[name]) for name, brain in brains.items()})
        if met is None:
            continue
        reports = [brain.report() for brain in brains.values()]
        mates = [report.team[1 - k] for k, report in enumerate(reports)]
        found = Meeting(
            world=world,
            seed=seed,
            met_s=met,
            reasons=tuple(mate.alignment_reason for mate in mates),
        )
        if all(mate.alignment == ALIGNED and mate.pose is not None for mate in mates):
            errors = [_error(simulation, k, report) for k, report in enumerate(reports)]
            told = {
                "took_s": simulation.stamp - met,
                "error_m": max(error.distance_to(IDENTITY) for error in errors),
                "error_rad": max(abs(error.theta) for error in errors),
            }
            found = found.model_copy(update=told)
        if found.outcome == "right" or simulation.stamp - met >= WITHIN_S:
            break
    return found


def kept(world: str, seed: int, limit_s: float, out: Path) -> Meeting:
    """A run, from its file if it has been played before."""
    path = out / f"{file_name(world)}-{seed}-{limit_s:g}s.json"
    if path.exists():
        return Meeting.model_validate_json(path.read_text())
    meeting = play(world, seed, limit_s)
    path.write_text(meeting.model_dump_json())
    return meeting


def _error(simulation: Simulation, own: int, report: Report) -> Pose2:
    """Where a robot sees the other on its map, against where that was when it was heard last."""
    mate = report.team[1 - own]
    assert mate.pose is not None
    poses = simulation.history.poses
    here, there = poses[report.tick, own], poses[mate.last_heard_tick, 1 - own]
    true = Pose2.from_array(here).inverse() @ Pose2.from_array(there)
    return true.inverse() @ report.pose.to_pose().inverse() @ mate.pose.to_pose()


def summary(meetings: Iterable[Meeting]) -> str:
    """How many there were of each outcome, and how long it took."""
    found = list(meetings)
    outcomes = [meeting.outcome for meeting in found]
    counts = ", ".join(f"{outcomes.count(what)} {what}" for what in dict.fromkeys(outcomes))
    took = [meeting.took_s for meeting in found if meeting.took_s is not None]
    if not took:
        return f"{len(found)} runs: {counts}"
    times = f"{median(took):.1f} s in the median, {max(took):.1f} s at most"
    return f"{len(found)} runs: {counts}; aligned after {times}"


def line(meeting: Meeting) -> str:
    """One run in words."""
    words = f"{meeting.world}, seed {meeting.seed}: {meeting.outcome}"
    if meeting.met_s is None:
        return words
    words += f", met after {meeting.met_s:.1f} s"
    if meeting.took_s is None:
        return f"{words}: {'; '.join(meeting.reasons)}"
    return f"{words}, aligned {meeting.took_s:.1f} s later, {meeting.error_m:.3f} m off"


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.first_meetings", __doc__)
    parser.add_argument(
        "worlds", nargs="*", default=["scoring"], help="as in studies.merging, or a map"
    )
    parser.add_argument("--seeds", type=parse_seeds, default=list(range(5)), help="e.g. 0-4")
    parser.add_argument("--limit", type=float, default=180.0, metavar="S", help="simulated")
    parser.add_argument("--out", type=Path, default=Path("runs/first-meetings"), help="kept runs")
    arguments = parser.parse_args(argv)
    ensure_warm()
    arguments.out.mkdir(parents=True, exist_ok=True)
    worlds = [world for names in arguments.worlds for world in worlds_of(names)]
    meetings = []
    for seed, world in product(arguments.seeds, worlds):
        meetings.append(kept(world, seed, arguments.limit, arguments.out))
        print(line(meetings[-1]), flush=True)
    print(summary(meetings))
    write_figures([meeting.model_dump() for meeting in meetings], arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
