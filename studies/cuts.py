"""Journals under random cuts of the radio: whatever was lost, everybody ends with the same.

    python -m studies.cuts --schedules 200 --json cuts.json
    python -m studies.cuts --schedules 200 --out cuts   # goes on where it was cut off

A schedule is a team of 2 to 8 robots that write down what they find, each link between two of them
up half of the time. Frames on links that are up are lost (30 %), doubled and put out of order. At
the end all links are up and lose nothing. Then all journals must become equal within three
exchanges per pair, of one version vector each way and the entries that it asks for; nothing that
anybody wrote may be missing, and every robot's joint solution must be that of one who was told all
in order.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from protocol.config import LidarConfig, PoseModel, RobotConfig
from protocol.messages import HeardFrame, RadioFrame
from protocol.pose import IDENTITY, Pose2
from robot.jobs import Jobs
from robot.slam.engine import Anchor, Closure, Entry, Keyframe
from robot.team.entries import Link
from robot.team.joint import JointGraph, solve
from robot.team.journal import LogName
from robot.team.log_reading import read_in_order
from robot.team.team import BEACON_EVERY_TICKS, LiveState, Team
from studies.command import aligned, study_parser, write_figures

CUT_TICKS = 300
WRITE_SHARE = 0.15  # of the ticks, in which a robot finds something
LINK_TICKS = (10, 60)  # for how long a link stays as it is
UP, LOSS, DOUBLED, MOST_DELAY_TICKS = 0.5, 0.3, 0.2, 6
NEVER = 20  # exchanges after which a schedule is given up
BEAMS = 40
MOST_EXCHANGES, MOST_DIFFERENCE = 3, 1e-9

LIVE = LiveState(0, IDENTITY, np.eye(3) * 1e-4, None, False)
INFORMATION = np.diag([1e4, 1e4, 1e5])
STEP = Pose2(1.0, 0.1, 0.1)


class Schedule:
    """One team under one pattern of cuts, drawn by a seed."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self.names = tuple(f"r{n + 1}" for n in range(int(self._rng.integers(2, 9))))
        self.teams = {name: self._team(name) for name in self.names}
        first = Anchor(0, IDENTITY, np.eye(3))
        self._written: dict[str, list[Entry | Link]] = {name: [first] for name in self.names}
        self._air: dict[int, list[tuple[str, HeardFrame]]] = {}
        self._links: dict[frozenset[str], tuple[bool, int]] = {}
        self._tick = 0

    def play_cuts(self) -> None:
        """The time of cuts, in which everybody writes."""
        for name in self.names:
            self.teams[name].write(self._written[name])
        for _ in range(CUT_TICKS):
            for name in self.names:
                if self._rng.random() < WRITE_SHARE:
                    entry = self._finding(name)
                    self._written[name].append(entry)
                    self.teams[name].write([entry])
            self._step(cut=True)

    def settle(self) -> int:
        """How many exchanges each pair needs until all journals are equal, with all links up."""
        exchanges = 0
        while len({team.journal.digest() for team in self.teams.values()}) > 1:
            exchanges += self._tick % BEACON_EVERY_TICKS == 0
            if exchanges > NEVER:
                break
            self._step(cut=False)
        return exchanges

    def missing(self) -> int:
        """How many entries that were written somebody does not hold."""
        return sum(
            1 + len(entries) - team.journal.prefix(LogName(name, 0))
            for team in self.teams.values()
            for name, entries in self._written.items()
        )

    def difference(self) -> float:
        """The greatest difference (m, rad) of anybody's joint solution from the one that follows
        from the logs as their owners hold them."""
        graph = JointGraph()
        for name in self.names:
            log, journal = LogName(name, 0), self.teams[name].journal
            own = [entry for entry in journal.beyond({}) if entry.log == log]
            for _, entry in read_in_order((name, journal.body(name)) for name in own):
                graph.add(log, entry)
        truth = solve(graph.problem())
        worst = 0.0
        for team in self.teams.values():
            found = team.standing.exactly(team.graph).solution
            if found.keys() != truth.keys():
                return float("inf")
            worst = max(worst, *(float(np.abs(found[k] - truth[k]).max()) for k in truth))
        return worst

    def _team(self, name: str) -> Team:
        start = PoseModel(x_m=3.0 * self.names.index(name), y_m=0.0, theta_rad=0.0)
        lidar = LidarConfig(beams=BEAMS)
        return Team(RobotConfig(name=name, team=self.names, start=start, lidar=lidar), 0, Jobs())

    def _finding(self, name: str) -> Entry | Link:
        """Something that a robot may find next: a keyframe, an anchor, a closure, a link."""
        rng = self._rng
        anchors = sum(isinstance(entry, Anchor) for entry in self._written[name])
        kind = rng.random()
        error = Pose2.from_array(rng.normal(0.0, [0.01, 0.01, 0.003]))
        if kind < 0.2:
            return Anchor(anchors, STEP @ error, INFORMATION)
        if kind < 0.35 and anchors > 2:
            skipped = STEP @ STEP @ error
            return Closure(anchors - 3, anchors - 1, skipped, INFORMATION)
        if kind < 0.5:
            other = self.names[int(rng.integers(len(self.names)))]
            if other != name:
                apart = 3.0 * (self.names.index(other) - self.names.index(name))
                there = Pose2(apart, 0.0, 0.0) @ error
                return Link(0, LogName(other, 0), 0, there, INFORMATION)
        pose, scan = STEP @ error, rng.uniform(1.0, 5.0, BEAMS)
        return Keyframe(0, self._tick, anchors - 1, pose, np.eye(3) * 1e-4, scan)

    def _step(self, cut: bool) -> None:
        arrived: dict[str, tuple[HeardFrame, ...]] = {}
        for receiver, heard in self._air.pop(self._tick, []):
            arrived[receiver] = (*arrived.get(receiver, ()), heard)
        for name, team in self.teams.items():
            team.hear(self._tick, arrived.get(name, ()))
            for frame in team.speak(self._tick, LIVE):
                for other in self.names:
                    if other != name and frame.to in ("*", other):
                        self._send(name, other, frame, cut)
        self._tick += 1

    def _send(self, sender: str, receiver: str, frame: RadioFrame, cut: bool) -> None:
        copies, most_delay = 1, 1
        if cut:
            passes = self._is_up(frozenset((sender, receiver))) and self._rng.random() >= LOSS
            copies = passes * (1 + int(self._rng.random() < DOUBLED))
            most_delay = MOST_DELAY_TICKS
        heard = HeardFrame(sender=sender, sent_tick=self._tick, **frame.model_dump())
        for _ in range(copies):
            due = self._tick + 1 + int(self._rng.integers(most_delay))
            self._air.setdefault(due, []).append((receiver, heard))

    def _is_up(self, pair: frozenset[str]) -> bool:
        up, until = self._links.get(pair, (False, 0))
        if self._tick >= until:
            up = bool(self._rng.random() < UP)
            self._links[pair] = up, self._tick + int(self._rng.integers(*LINK_TICKS))
        return up


def run_schedule(seed: int) -> dict[str, Any]:
    """One schedule in numbers."""
    schedule = Schedule(seed)
    schedule.play_cuts()
    before = schedule.missing()
    exchanges = schedule.settle()
    return {
        "seed": seed,
        "robots": len(schedule.names),
        "missing_before": before,
        "exchanges": exchanges,
        "missing": schedule.missing(),
        "malformed": sum(sum(team.malformed.values()) for team in schedule.teams.values()),
        "difference": schedule.difference(),
    }


def kept(seed: int, folder: Path | None) -> dict[str, Any]:
    """A schedule in numbers, from the folder's file if one is there and has it."""
    path = folder / f"schedule-{seed}.json" if folder else None
    if path is not None and path.exists():
        found: dict[str, Any] = json.loads(path.read_text())
        return found
    row = run_schedule(seed)
    write_figures(row, path)
    return row


def passed(row: dict[str, Any]) -> bool:
    """Whether a schedule ended as it must."""
    whole: bool = row["missing"] == row["malformed"] == 0
    equal: bool = row["exchanges"] <= MOST_EXCHANGES and row["difference"] <= MOST_DIFFERENCE
    return whole and equal


def table(rows: list[dict[str, Any]]) -> str:
    counts = [sum(row["exchanges"] == n for row in rows) for n in range(NEVER + 2)]
    settled = ", ".join(f"{count} in {n}" for n, count in enumerate(counts) if count)
    return aligned(
        [
            ("schedules that ended as they must", f"{sum(map(passed, rows))} of {len(rows)}"),
            ("entries missing somewhere before", str(sum(row["missing_before"] for row in rows))),
            ("and at the end", str(sum(row["missing"] for row in rows))),
            ("exchanges until equal", settled),
            ("greatest difference", f"{max(row['difference'] for row in rows):.2g} m or rad"),
        ]
    )


def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.cuts", __doc__)
    parser.add_argument("--schedules", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the first schedule")
    parser.add_argument("--out", type=Path, help="finished schedules are kept there")
    arguments = parser.parse_args(argv)
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for seed in range(arguments.seed, arguments.seed + arguments.schedules):
        rows.append(kept(seed, arguments.out))
        if not passed(rows[-1]):
            print(f"schedule {seed} did not end as it must: {rows[-1]}", flush=True)
    print(table(rows))
    write_figures(rows, arguments.json)
    return 0 if all(map(passed, rows)) else 1


if __name__ == "__main__":
    sys.exit(main())
