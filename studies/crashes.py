"""Robot processes killed at random moments, each started again from its journal.

    python -m studies.crashes --kills 200 --json crashes.json

Patrolling robots on the office, in processes, one of which is killed (SIGKILL) every few simulated
seconds, at a random moment of a tick, and started again with `--resume`. Afterwards the journals on
disk are held against each other: what anybody holds of a life must be on the disk of the robot that
lived it (nothing was told before it was durable), and every file must be whole but for the record
that was being written. A run of the same length without kills says what map there would have been.
Runs that are finished are kept in `--out`, and a study that was cut off goes on there.
"""

import json
import os
import random
import signal
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from protocol.messages import Report
from robot.recollection import read_contents
from robot.team.journal import EntryName, LogName, decode_record
from station.forks import forked_robots
from station.hosts import Unwatched
from station.launch import launch
from station.report_metrics import measure
from station.warm_up import ensure_warm
from studies.command import aligned, study_parser, write_figures
from world.scenario import GateConfig, PaceConfig, RobotSpec, Scenario
from world.simulation import Simulation

KILLS_A_RUN = 20
FIRST_S, EVERY_S, LAST_S = 20.0, 8.0, 40.0
DELAY_S = 0.05  # wall time: a few ticks
ROBOTS = ("r1", "r2", "r3")


class Killer(Unwatched):
    """Kills a robot now and then, if all are there."""

    def __init__(self, kills: int, seed: int) -> None:
        self.killed: list[tuple[int, str]] = []
        self._kills = kills
        self._rng = random.Random(seed)
        self._due_s = FIRST_S

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        del reports
        if len(self.killed) >= self._kills or simulation.stamp < self._due_s:
            return
        if simulation.alive != simulation.names:
            return
        self._due_s = simulation.stamp + EVERY_S
        name = self._rng.choice(simulation.names)
        pid = forked_robots(os.getpid()).get(name)
        if pid is not None:
            self.killed.append((simulation.tick, name))
            threading.Timer(self._rng.uniform(0.0, DELAY_S), _kill, (pid,)).start()


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):  # the run has ended in the meantime
        os.kill(pid, signal.SIGKILL)


def scenario(kills: int, seed: int) -> Scenario:
    """A patrol with time for so many kills, everybody in everybody's earshot."""
    return Scenario(
        map="office",
        seed=seed,
        robots=tuple(RobotSpec(name=name, policy="patrol") for name in ROBOTS),
        starts="known",
        radio=GateConfig(range_m=100.0),
        max_sim_s=FIRST_S + kills * EVERY_S + LAST_S,
        pace=PaceConfig(deadline_s=60.0),
    )


def run(kills: int, seed: int, folder: Path) -> dict[str, Any]:
    """One run with kills, and what became of journals and map."""
    killer = Killer(kills, seed)
    outcome = launch(scenario(KILLS_A_RUN, seed), "processes", killer, folder=folder, restart=True)
    metrics = measure(outcome)
    return {
        "seed": seed,
        "kills": len(killer.killed),
        "restarts": sum(
            len(list((folder / "journals").glob(f"{name}.*.journal"))) - 1 for name in ROBOTS
        ),
        "alive": len(outcome.simulation.alive),
        "coverage": metrics.coverage,
        "coverage_worst_joint": metrics.coverage_worst_joint,
        "precision": metrics.walls.precision,
        "team_error_m": metrics.team.ate_rmse_m,
        **compare_journals(folder / "journals"),
    }


def compare_journals(folder: Path) -> dict[str, int]:
    """What the files of all lives say of each other, in records.

    `told_unwritten`: held by anybody, but not on the disk of the robot that lived it. `untold`: of
    lives that have ended, and not held by everybody at the end. `torn`, `damaged`: files with a
    torn end, and damaged stretches."""
    lives: dict[LogName, set[EntryName]] = {}
    memories: dict[str, set[EntryName]] = {}
    torn = damaged = 0
    for path in sorted(folder.glob("*.journal")):
        robot, incarnation, _ = path.name.split(".")
        contents = read_contents(path)
        torn += contents.torn
        damaged += len(contents.damaged)
        names = {decode_record(record)[0] for record in contents.records[1:]}
        life = LogName(robot, int(incarnation))
        lives[life] = {name for name in names if name.log == life}
        memories.setdefault(robot, set()).update(names)
    told = {name for names in memories.values() for name in names}
    written = {name for names in lives.values() for name in names}
    newest = {robot: max(life for life in lives if life.robot == robot) for robot in memories}
    ended = {name for name in written if name.log != newest[name.log.robot]}
    return {
        "lives": len(lives),
        "records": len(written),
        "told_unwritten": len(told - written),
        "untold": sum(len(ended - names) for names in memories.values()),
        "torn": torn,
        "damaged": damaged,
    }


def table(rows: list[dict[str, Any]], calm: dict[str, Any]) -> str:
    def total(key: str) -> str:
        return str(sum(row[key] for row in rows))

    def worst(key: str) -> str:
        values = [row[key] for row in rows if row[key] is not None]
        return f"{min(values):.4f} (without kills {calm[key]:.4f})"

    errors = [row["team_error_m"] for row in rows if row["team_error_m"] is not None]
    return aligned(
        [
            ("kills", total("kills")),
            ("restarts", total("restarts")),
            ("robots alive at the end", f"{total('alive')} of {len(ROBOTS) * len(rows)}"),
            ("lives", total("lives")),
            ("journal entries", total("records")),
            ("told but not written", total("told_unwritten")),
            ("of ended lives, not held by all", total("untold")),
            ("torn ends", total("torn")),
            ("damaged stretches", total("damaged")),
            ("least coverage", worst("coverage")),
            ("of the poorest joint map", worst("coverage_worst_joint")),
            ("least precision of walls", worst("precision")),
            ("greatest team error", f"{max(errors):.4f} m ({calm['team_error_m']:.4f} m)"),
        ]
    )


def kept(path: Path, kills: int, seed: int, folder: Path) -> dict[str, Any]:
    """The figures of a run, from its file if it has one."""
    if path.exists():
        found: dict[str, Any] = json.loads(path.read_text())
        return found
    row = run(kills, seed, folder)
    write_figures(row, path)
    return row


def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.crashes", __doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("runs/crashes"), help="finished runs")
    arguments = parser.parse_args(argv)
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    ensure_warm()
    calm = kept(out / "calm.json", 0, 0, out / "calm")  # as long as the others
    rows: list[dict[str, Any]] = []
    done = 0
    while done < arguments.kills:
        seed = len(rows)
        rows.append(kept(out / f"run-{seed}.json", KILLS_A_RUN, seed, out / f"run-{seed}"))
        done += rows[-1]["kills"]
        print(f"[{done}/{arguments.kills}] {rows[-1]}", flush=True)
        if rows[-1]["kills"] == 0:
            print("error: nobody could be killed: are robots forked here?", file=sys.stderr)
            return 2
    print(table(rows, calm))
    write_figures({"runs": rows, "calm": calm}, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
