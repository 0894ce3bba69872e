"""Random numbers keyed by what they are for, so that no robot's fate shifts another's noise."""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Stream:
    """The generator of one robot and purpose, and the state that takes it to a tick."""

    generator: np.random.Generator
    fresh: dict[str, Any]


class Noise:
    """Generators by (seed, robot, purpose, tick), each with numbers of its own.

    Philox (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", 2011) is addressed, not
    wound forward: the key names robot and purpose, the tick is the high word of the counter.
    """

    # Made anew when missing: what they draw does not depend on what was drawn before.
    TRANSIENT = ("_streams",)

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._streams: dict[tuple[str, str], Stream] | None = None

    def at(self, robot: str, purpose: str, tick: int) -> np.random.Generator:
        """The generator of one robot, purpose and tick: the same numbers however often asked.

        Use it before asking for another tick of the same robot and purpose: that is the same
        object, taken to that tick (making a new one costs six times as much).
        """
        if self._streams is None:
            self._streams = {}
        stream = self._streams.get((robot, purpose))
        if stream is None:
            stream = self._streams[robot, purpose] = _open_stream(self._seed, robot, purpose)
        stream.fresh["state"]["counter"][3] = tick
        stream.generator.bit_generator.state = stream.fresh
        return stream.generator


def _open_stream(seed: int, robot: str, purpose: str) -> Stream:
    # A robot's name cannot hold the separator, so that no two texts are the same.
    text = f"{seed}/{robot}/{purpose}"
    key = hashlib.blake2b(text.encode(), digest_size=16).digest()
    bits = np.random.Philox(key=np.frombuffer(key, dtype="<u8"))
    return Stream(np.random.Generator(bits), dict(bits.state))
