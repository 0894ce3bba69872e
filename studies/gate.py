"""A million random frames through the radio gate, each checked against the plain rule.

    python -m studies.gate --frames 1000000 --json gate.json

The check knows nothing of the gate's code: it follows every frame by a number in its payload,
and measures distances itself.
"""

import argparse
import json
import math
import struct
import sys
from collections import Counter
from pathlib import Path

import numpy as np

from protocol.config import BROADCAST
from protocol.messages import RadioFrame
from world.ledger import Verdict
from world.noise import Noise
from world.radio import Radio
from world.scenario import GateConfig

ROBOTS, PER_TICK, HALL_M = 12, 20, 40.0
CONFIG = GateConfig(range_m=15.0, loss=0.1, latency_ticks=3, bytes_per_tick=1000)


def check(frames: int, seed: int) -> dict[str, int]:
    """Offers by what became of them, and how many of those broke a rule."""
    names = [f"r{i}" for i in range(ROBOTS)]
    radio, noise = Radio(CONFIG, names), Noise(seed)
    rng = np.random.default_rng(seed)
    present = np.ones(ROBOTS, dtype=bool)
    in_range: dict[int, set[str]] = {}
    counts: Counter[str] = Counter()
    ticks = math.ceil(frames / (ROBOTS * PER_TICK))
    number = 0
    for tick in range(ticks + CONFIG.latency_ticks):
        poses = rng.uniform(0.0, HALL_M, (ROBOTS, 3))
        sent: dict[str, list[RadioFrame]] = {}
        for s, name in enumerate(names if tick < ticks else []):
            sent[name] = []
            for _ in range(PER_TICK):
                to = int(rng.integers(-1, ROBOTS - 1))  # -1: everybody
                to += to >= s  # nobody sends to himself
                receivers = [r for r in range(ROBOTS) if r != s and to in (-1, r)]
                near = {names[r] for r in receivers if _apart(poses, s, r) <= CONFIG.range_m}
                in_range[number] = near
                counts["offers"] += len(receivers)
                counts["offers_in_range"] += len(near)
                payload = struct.pack("<q", number) + bytes(int(rng.integers(0, 400)))
                address = BROADCAST if to < 0 else names[to]
                sent[name].append(RadioFrame(to=address, kind="test", payload=payload))
                number += 1
        counts["frames"] = number
        radio.send(sent, tick, poses, present, noise)
        for name, heard in zip(names, radio.receive(tick, present), strict=True):
            for frame in heard:
                (found,) = struct.unpack_from("<q", frame.payload)
                counts["delivered"] += 1
                counts["delivered_beyond_range"] += name not in in_range[found]
                in_range[found].discard(name)
    return _with_ledger(radio, counts)


def _apart(poses: np.ndarray[tuple[int, ...], np.dtype[np.float64]], s: int, r: int) -> float:
    return math.hypot(poses[s, 0] - poses[r, 0], poses[s, 1] - poses[r, 1])


def _with_ledger(radio: Radio, counts: Counter[str]) -> dict[str, int]:
    """Hold what was seen against what the ledger booked."""
    radio.ledger.check()
    ended = radio.ledger.ended[..., 0].sum(axis=(0, 1))
    booked = int(ended[Verdict.LOSS] + ended[Verdict.CAPACITY] + ended[Verdict.ABSENT])
    missing = counts["offers_in_range"] - counts["delivered"]
    return {
        "frames": counts["frames"],
        "offers": counts["offers"],
        "offers_in_range": counts["offers_in_range"],
        "delivered": counts["delivered"],
        "booked_lost": int(ended[Verdict.LOSS]),
        "booked_capacity": int(ended[Verdict.CAPACITY]),
        "delivered_beyond_range": counts["delivered_beyond_range"],
        "lost_in_range_without_reason": missing - booked,
    }


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m studies.gate",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args(argv)
    result = check(arguments.frames, arguments.seed)
    for name, value in result.items():
        print(f"{name:>30}  {value}")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")
    wrong = result["delivered_beyond_range"] or result["lost_in_range_without_reason"]
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
