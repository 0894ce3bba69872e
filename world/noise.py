"""Random numbers keyed by what they are for, so that no robot's fate shifts another's noise."""

import hashlib
import math

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray
from world import noise_kernels

IntArray = npt.NDArray[np.int64]


class Noise:
    """Numbers by (seed, robot, purpose, tick): the same ones however often asked, in any order.

    The bulk comes from `Stream`s; what is drawn once in a run comes from generators.
    """

    # Made anew when missing: they follow from the seed and the names.
    TRANSIENT = ("_streams",)

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._streams: dict[tuple[tuple[str, ...], str], Stream] | None = None

    def at(self, robot: str, purpose: str, tick: int) -> np.random.Generator:
        """A generator for one robot, purpose and tick."""
        key = np.frombuffer(self._digest(robot, purpose, 16), dtype="<u8")
        return np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, tick]))

    def stream(self, robots: tuple[str, ...], purpose: str) -> "Stream":
        """The numbers of several robots for one purpose."""
        if self._streams is None:
            self._streams = {}
        stream = self._streams.get((robots, purpose))
        if stream is None:
            keys = b"".join(self._digest(robot, purpose, 8) for robot in robots)
            stream = Stream(np.frombuffer(keys, dtype="<u8").astype(np.uint64))
            self._streams[robots, purpose] = stream
        return stream

    def _digest(self, robot: str, purpose: str, size: int) -> bytes:
        # A robot's name cannot hold the separator, so that no two texts are the same.
        text = f"{self._seed}/{robot}/{purpose}"
        return hashlib.blake2b(text.encode(), digest_size=size).digest()


class Stream:
    """Numbers by (robot, tick, item): an item is what a robot draws several numbers for, such as
    a teammate or a frame."""

    def __init__(self, keys: npt.NDArray[np.uint64]) -> None:
        self._keys = keys

    def normals(self, tick: int, count: int) -> FloatArray:
        """`count` standard normal numbers for each robot (n×count)."""
        robots = np.arange(len(self._keys))
        return self.normals_of(tick, robots, np.zeros_like(robots), count)

    def normals_of(self, tick: int, robots: IntArray, items: IntArray, count: int) -> FloatArray:
        """The same for items (k) of robots (k, by number): k×count."""
        numbers = np.empty((len(robots), count))
        noise_kernels.fill_normals(self._keys[robots], tick, items, LAYERS, numbers)
        return numbers

    def uniforms(self, tick: int, count: int) -> FloatArray:
        """`count` numbers in [0, 1) for each robot (n×count)."""
        robots = np.arange(len(self._keys))
        return self.uniforms_of(tick, robots, np.zeros_like(robots), count)

    def uniforms_of(self, tick: int, robots: IntArray, items: IntArray, count: int) -> FloatArray:
        """The same for items (k) of robots (k, by number): k×count."""
        numbers = np.empty((len(robots), count))
        noise_kernels.fill_uniforms(self._keys[robots], tick, items, numbers)
        return numbers


def ziggurat() -> FloatArray:
    """256 layers of equal area under the normal density, as Marsaglia and Tsang (2000) cut it.

    3×256: the width of a layer by 2^−52, the share of it (of 2^52) that lies wholly under the
    density, and the density at its edge. Layer 0 is the lowest, with the tail; then they go from
    the narrowest at the top down.
    """
    edge, scale = 3.6541528853610088, 2.0**52  # where 256 layers close at the top
    floor = math.exp(-0.5 * edge * edge)
    area = edge * floor + math.sqrt(0.5 * math.pi) * math.erfc(edge / math.sqrt(2.0))
    layers = np.zeros((3, 256))
    layers[:, 0] = area / floor / scale, edge * floor / area * scale, 1.0
    layers[:, 255] = edge / scale, 0.0, floor
    for i in range(254, 0, -1):
        wider, height = edge, floor
        edge = math.sqrt(-2.0 * math.log(area / wider + height))
        floor = math.exp(-0.5 * edge * edge)
        layers[0, i], layers[2, i] = edge / scale, floor
        layers[1, i + 1] = edge / wider * scale
    return layers


LAYERS = ziggurat()
