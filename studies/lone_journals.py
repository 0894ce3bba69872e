"""Journals of robots that explored a world alone, out of everybody's earshot, kept on disk.

What a study of merging draws from: each is played once, and with it lies the true way.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.brain import Brain
from robot.journal_file import FORMAT, frame_record
from robot.recollection import read_records
from robot.slam.engine import Anchor, Closure
from robot.team.entries import Hello, Known
from robot.team.journal import decode_record
from robot.team.keyframes import StoredKeyframe
from robot.team.log_reading import read_in_order
from world.scenario import GateConfig, RobotSpec, Scenario
from world.simulation import Simulation


@dataclass(frozen=True, slots=True)
class LoneJournal:
    """What a robot wrote down, without its start, and its true poses (ticks×3) in the world."""

    world: str
    seed: int
    entries: tuple[Known, ...]
    truth: FloatArray

    @property
    def start(self) -> Pose2:
        return Pose2.from_array(self.truth[0])

    @property
    def keyframes(self) -> list[StoredKeyframe]:
        return [entry for entry in self.entries if isinstance(entry, StoredKeyframe)]

    def cut(self, share: float) -> "LoneJournal":
        """As it was when the robot had written that share of its keyframes: its true way ends there
        too, for what came after it had not seen."""
        wanted = max(1, round(share * len(self.keyframes)))
        kept: list[Known] = []
        for entry in self.entries:
            if wanted == 0 and isinstance(entry, StoredKeyframe):
                break
            kept.append(entry)
            wanted -= isinstance(entry, StoredKeyframe)
        last = max(entry.tick for entry in kept if isinstance(entry, StoredKeyframe))
        return replace(self, entries=tuple(kept), truth=self.truth[: last + 1])


def lone_journal(world: str, seed: int, seconds: float, folder: Path) -> LoneJournal:
    """The journal of a robot that a seed put into a world; played now if it is not in `folder`.

    Raises MapFileError and StartError as `Simulation` does.
    """
    # Entries of another format are none: such files stay where they are.
    stem = f"{file_name(world)}-{seed}-{seconds:g}s-{FORMAT.split()[-1]}"
    path, way = folder / f"{stem}.journal", folder / f"{stem}.npy"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        records, truth = _play(world, seed, seconds)
        np.save(way, truth)
        partial = path.with_suffix(".part")
        partial.write_bytes(b"".join(frame_record(record) for record in records))
        partial.replace(path)
    entries: list[Known] = []
    for _, entry in read_in_order(map(decode_record, read_records(path))):
        if isinstance(entry, Hello):
            entries.append(replace(entry, start=None))
        elif isinstance(entry, Anchor | StoredKeyframe | Closure):
            entries.append(entry)
    return LoneJournal(world, seed, tuple(entries), np.load(way))


def _play(world: str, seed: int, seconds: float) -> tuple[list[bytes], FloatArray]:
    simulation = Simulation(
        Scenario(
            map=world,
            seed=seed,
            robots=(RobotSpec(name="r1"),),
            starts="unknown",
            radio=GateConfig(range_m=0.0),
            max_sim_s=seconds,
        )
    )
    brain = Brain(simulation.robot_config("r1"))
    records: list[bytes] = []
    truth: list[FloatArray] = []
    senses = simulation.step({})
    while not simulation.done:
        truth.append(simulation.poses[0].copy())
        action = brain.step(senses["r1"])
        records += brain.take_records()
        senses = simulation.step({"r1": action})
    return records, np.array(truth)


def file_name(world: str) -> str:
    """A world's name with nothing in it that a file's must not have."""
    stem = Path(world).stem if world.endswith((".yaml", ".yml")) else world
    return "".join(letter if letter.isalnum() else "-" for letter in stem)
