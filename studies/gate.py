"""A million random frames through the radio gate, each checked against the plain rule; its load.

    python -m studies.gate --frames 1000000 --json gate.json
    python -m studies.gate --load --model line-of-sight --json load.json

With --load, 64 robots in range of each other broadcast 1 kB at every tick, and what the gate adds
to a tick is timed. Otherwise every frame is checked, and the check knows nothing of the gate's
code: it follows every frame by a number in its payload, and measures distances itself.
"""

import math
import struct
import sys
import time
from collections import Counter
from collections.abc import Mapping

import numpy as np

from maps.grid import OccupancyGrid
from protocol.config import BROADCAST
from protocol.messages import RadioFrame
from studies.command import print_figures, study_parser, write_figures
from world.channel import Channel
from world.ledger import Verdict
from world.noise import Noise
from world.radio import Radio
from world.scenario import GateConfig
from world.terrain import Terrain

ROBOTS, PER_TICK, HALL_M = 12, 20, 40.0
# The load: all in one hall, and one frame of a robot is what fits into a tick.
LOAD_ROBOTS, LOAD_PAYLOAD, LOAD_HALL_M = 64, 1000, 7.0
LOAD_WARM_UP = 20
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


def load(ticks: int, seed: int, model: str) -> dict[str, float]:
    """Milliseconds that judging, delivering and booking take of a tick."""
    names = [f"r{i}" for i in range(LOAD_ROBOTS)]
    side = round(LOAD_HALL_M / 0.05)
    terrain = Terrain(OccupancyGrid(np.zeros((side, side), np.int8), 0.05, 0.0, 0.0))
    noise = Noise(seed)
    config = GateConfig.model_validate({"model": model})
    radio = Radio(config, names, Channel(config, terrain, noise))
    rng = np.random.default_rng(seed)
    present = np.ones(LOAD_ROBOTS, dtype=bool)
    took_ms = []
    for tick in range(ticks + LOAD_WARM_UP):
        poses = rng.uniform(0.0, LOAD_HALL_M, (LOAD_ROBOTS, 3))
        payload = rng.bytes(LOAD_PAYLOAD)
        sent = {name: [RadioFrame(kind="test", payload=payload)] for name in names}
        began = time.perf_counter()
        radio.send(sent, tick, poses, present, noise)
        radio.receive(tick + 1, present)
        took_ms.append(1e3 * (time.perf_counter() - began))
    radio.ledger.check()
    delivered = int(radio.ledger.delivered[..., 0].sum())
    timed = np.array(took_ms[LOAD_WARM_UP:])
    return {
        "robots": LOAD_ROBOTS,
        "ticks": ticks,
        "delivered_per_tick": delivered / (ticks + LOAD_WARM_UP),
        "gate_ms_median": float(np.median(timed)),
        "gate_ms_p99": float(np.percentile(timed, 99)),
    }


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
    parser = study_parser("studies.gate", __doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--load", action="store_true", help="time the gate in place of checking")
    parser.add_argument("--ticks", type=int, default=2000, help="of --load")
    parser.add_argument(
        "--model", choices=("disc", "line-of-sight", "shadowing"), default="disc", help="of --load"
    )
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    result: Mapping[str, float]
    if arguments.load:
        result = load(arguments.ticks, arguments.seed, arguments.model)
    else:
        result = check(arguments.frames, arguments.seed)
    print_figures(result)
    write_figures(result, arguments.json)
    wrong = ("delivered_beyond_range", "lost_in_range_without_reason")
    return 1 if any(result.get(name) for name in wrong) else 0


if __name__ == "__main__":
    sys.exit(main())
