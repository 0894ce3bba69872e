"""Fingerprints of what a run came to, to hold one run against another to the last bit."""

import hashlib
import json
from collections.abc import Iterable

import msgpack

from protocol.codec import encode
from station.observer import RobotOutcome, RunOutcome

USAGE = {"sent_for", "heard_for"}


def run_hashes(outcome: RunOutcome) -> dict[str, str]:
    """SHA-256 over trajectories, maps, journals and ledger; equal runs have equal ones.

    Robots are taken in the order of their names. One that answered nothing counts as that.
    """
    robots = [outcome.robots[name] for name in sorted(outcome.robots)]
    return {
        "trajectory": _digest(map(_trajectory, robots)),
        "map": _digest(encode(robot.map) if robot.map else b"" for robot in robots),
        "journal": _digest(
            robot.trajectory.journal_digest.encode() if robot.trajectory else b""
            for robot in robots
        ),
        "ledger": _digest([_ledger(outcome)]),
        "truth": _digest([outcome.simulation.history.poses.tobytes()]),
    }


def _trajectory(robot: RobotOutcome) -> bytes:
    if robot.trajectory is None:
        return b""
    packed: bytes = msgpack.packb(robot.trajectory.model_dump(exclude=USAGE), use_bin_type=True)
    return packed


def _ledger(outcome: RunOutcome) -> bytes:
    """What the world counted, and what robots say that it was for."""
    usage = {
        name: robot.trajectory.model_dump(include=USAGE)
        for name, robot in outcome.robots.items()
        if robot.trajectory is not None
    }
    return json.dumps([outcome.simulation.ledger.to_dict(), usage], sort_keys=True).encode()


def _digest(parts: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()
