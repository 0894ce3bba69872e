"""What access control costs, and what one robot that floods the world takes from the others.

    python -m studies.flood --rounds 3 --json flood.json

The wall: a team that answers each sense with one frame and no thought, so that the wire alone is
timed, on an open and on a walled router. The flood: r1 answers without thought, beside two robots
that map the office, and all the while sends actions and frames at 100 times the rate of its own in
the same round without the flood; how many ticks a second the team keeps, against that round. Where
cores are few, the flooding process takes its share of them whether anybody listens or not: in a
third run it pours into a bus of its own, and what is lost against that is lost by the world.
"""

import argparse
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from protocol.bus import Bus, open_bus
from protocol.bus_config import BusConfig, loopback_endpoint
from protocol.config import RobotConfig
from protocol.interrupt import Interrupt, interrupts
from protocol.keys import key_path, make_keys
from protocol.messages import Action, MapReply, RadioFrame, Report, Sense, TrajectoryReply
from protocol.topics import ACT, RADIO_OUT
from robot.brain import Brain
from robot.jobs import Jobs
from robot.process import run_robot
from station.child import Spawned, children
from station.free_port import free_port
from station.hosts import Timed, Unwatched
from station.warm_up import ensure_warm
from studies.command import one_line_errors, print_figures, study_parser, write_figures
from world.process import WorldProcess
from world.scenario import PaceConfig, RobotSpec, Scenario
from world.simulation import Simulation

NAMES = ("r1", "r2", "r3")
TIMES = 100
MESSAGES_PER_TICK = 2  # an action and a frame
POUR_S = 0.005
FRAME = RadioFrame(kind="hello", payload=bytes(300))


class Parrot:
    """A brain's double that thinks of nothing: one frame with each action."""

    def __init__(self, config: RobotConfig, incarnation: int, jobs: Jobs) -> None:
        self._brain = Brain(config, incarnation, jobs)
        self._tick = 0

    def remember(self, records: Sequence[bytes]) -> None:
        self._brain.remember(records)

    def step(self, sense: Sense) -> Action:
        if sense.tick == 0:  # so that there is something to report, and a map to show at the end
            self._brain.step(sense)
        self._tick = sense.tick
        return Action(tick=sense.tick, frame_count=1, frames=(FRAME,))

    def take_records(self) -> list[bytes]:
        return []

    def report(self) -> Report:
        return self._brain.report().model_copy(update={"tick": self._tick})

    def map_reply(self, exact: bool = False) -> MapReply:
        return self._brain.map_reply(exact)

    def trajectory_reply(self) -> TrajectoryReply:
        return self._brain.trajectory_reply()


def be_parrot(
    name: str, endpoint: str, key: Path | None, flood_hz: float, aside: bool = False
) -> None:
    """Be a parrot, and send so many messages a second more than it should, or to nobody."""
    with (
        interrupts() as interrupt,
        open_bus(BusConfig.client(endpoint, key=key)) as bus,
        open_bus(BusConfig.memory()) as nowhere,
    ):
        ended = threading.Event()
        target = nowhere if aside else bus
        flood = threading.Thread(target=pour, args=(target, name, flood_hz, ended))
        flood.start()
        try:
            run_robot(bus, name, Parrot, interrupt)
        finally:
            ended.set()
            flood.join()


def pour(bus: Bus, name: str, flood_hz: float, ended: threading.Event) -> None:
    """Frames and actions in turn, in as many as are due every few milliseconds."""
    began, poured = time.monotonic(), 0
    while not ended.wait(POUR_S):
        due = int(flood_hz * (time.monotonic() - began))
        for _ in range((due - poured) // 2):
            bus.publish(RADIO_OUT, FRAME, name)
            bus.publish(ACT, Action(tick=poured), name)
            poured += 2
    if poured:
        print(f"{poured / (time.monotonic() - began):.0f} messages/s", file=sys.stderr)


def ticks_per_second(
    seconds: float,
    walled: bool,
    parrots: tuple[str, ...],
    flood_hz: float = 0.0,
    aside: bool = False,
) -> float:
    """The pace of one run in lockstep, while r1 sends so much beside what it should."""
    scenario = Scenario(
        robots=tuple(RobotSpec(name=name) for name in NAMES),
        starts="known",
        max_sim_s=seconds,
        pace=PaceConfig(deadline_s=60.0),
    )
    simulation, timed = Simulation(scenario), Timed(Unwatched())
    endpoint = loopback_endpoint(free_port())
    config = BusConfig.router(endpoint)
    with tempfile.TemporaryDirectory(prefix="earshot-") as scratch:
        folder = Path(scratch)
        make_keys(folder, NAMES)
        config = config.walled(folder, NAMES) if walled else config
        with open_bus(config) as bus, children() as family:
            world = WorldProcess(simulation, bus, timed, Interrupt())
            for name in NAMES:
                words = [name, "--connect", endpoint]
                words += ["--keys", str(key_path(folder, name))] if walled else []
                if name in parrots:
                    pours = str(flood_hz if name == "r1" else 0.0)
                    words = ["studies.flood", "--pour", pours, "--be", *words]
                    words += ["--aside"] if aside else []
                else:
                    words = ["station.main", "robot", *words]
                family.append(Spawned(name, [sys.executable, "-m", *words], folder / f"{name}.log"))
            world.run()
        print((folder / "r1.log").read_text(), end="")
    for name, link in world.roster.links.items():
        if link.note:
            print(f"  {name}: {link.note}", flush=True)
    return simulation.tick / timed.wall_s


def measure(rounds: int, wire_s: float, team_s: float) -> dict[str, float]:
    """Medians over so many rounds, each kind of run once in every round."""
    paces: dict[str, list[float]] = {}

    def keep(kind: str, pace: float) -> float:
        paces.setdefault(kind, []).append(pace)
        print(f"{kind:>14}  {pace:.1f} ticks/s", flush=True)
        return pace

    for _ in range(rounds):
        keep("wire_open", ticks_per_second(wire_s, False, NAMES))
        keep("wire_walled", ticks_per_second(wire_s, True, NAMES))
        calm = keep("team_calm", ticks_per_second(team_s, True, ("r1",)))
        flood_hz = TIMES * MESSAGES_PER_TICK * calm
        keep("team_busy", ticks_per_second(team_s, True, ("r1",), flood_hz, aside=True))
        keep("team_flooded", ticks_per_second(team_s, True, ("r1",), flood_hz))
    result = {f"{kind}_ticks_per_s": statistics.median(paces[kind]) for kind in paces}
    result["walled_to_open"] = statistics.median(
        walled / free for walled, free in zip(paces["wire_walled"], paces["wire_open"], strict=True)
    )
    result["flooded_to_calm"] = statistics.median(
        wet / dry for wet, dry in zip(paces["team_flooded"], paces["team_calm"], strict=True)
    )
    result["flooded_to_busy"] = statistics.median(
        wet / dry for wet, dry in zip(paces["team_flooded"], paces["team_busy"], strict=True)
    )
    return result


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.flood", __doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--wire-s", type=float, default=60.0, metavar="S", help="simulated")
    parser.add_argument("--team-s", type=float, default=40.0, metavar="S", help="simulated")
    parser.add_argument("--be", metavar="NAME", help=argparse.SUPPRESS)
    parser.add_argument("--connect", help=argparse.SUPPRESS)
    parser.add_argument("--keys", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--pour", type=float, default=0.0, help=argparse.SUPPRESS)
    parser.add_argument("--aside", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.be:
        be_parrot(arguments.be, arguments.connect, arguments.keys, arguments.pour, arguments.aside)
        return 0
    ensure_warm()
    result = measure(arguments.rounds, arguments.wire_s, arguments.team_s)
    print_figures(result)
    write_figures(result, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
