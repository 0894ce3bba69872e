"""The radio gate: for every (sender, receiver, frame), delivered, or dropped and why.

A frame is judged when it is sent, by true poses, and arrives `latency_ticks` later. Its size is
`RadioFrame.size_bytes`, in every count. Delivery is in the order (sent tick, sender, index).
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
import numpy.typing as npt

from maps.grid import BoolArray
from protocol.config import BROADCAST, MAX_FRAME_BYTES
from protocol.messages import HeardFrame, RadioFrame
from protocol.pose import FloatArray
from world import radio_kernels
from world.channel import Channel
from world.ledger import Ledger, Verdict
from world.noise import Noise
from world.scenario import GateConfig

TO_ALL, TO_NOBODY = -1, -2


@dataclass(frozen=True, slots=True)
class Batch:
    """The frames (f) that were sent at one tick and passed, until they arrive.

    `passed` (f×n): to whom. `senders`, `sizes` and `kinds` (f) as numbers for the ledger.
    """

    due_tick: int
    frames: tuple[HeardFrame, ...]
    passed: BoolArray
    senders: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    kinds: npt.NDArray[np.int64]


class Radio:
    """All radios of the team, and the air between them: heard within d, and as far as the channel
    lets through."""

    TRANSIENT = ("channel",)

    def __init__(
        self, config: GateConfig, names: Sequence[str], channel: Channel | None = None
    ) -> None:
        """Only the disc needs no channel."""
        if channel is None and config.model != "disc":
            raise ValueError(f"the gate model {config.model} needs a channel")
        self.ledger = Ledger(names, fades=config.model != "disc")
        self.channel = channel
        self._config = config
        self._names = tuple(names)
        self._numbers = {name: i for i, name in enumerate(names)}
        self._air: deque[Batch] = deque()

    def links(self, poses: FloatArray, present: BoolArray) -> BoolArray:
        """Who is within earshot of whom (…×n×n) at poses (…×n×3), loss and capacity apart; nobody
        of himself."""
        apart = poses[..., :, None, :2] - poses[..., None, :, :2]
        near: BoolArray = np.hypot(apart[..., 0], apart[..., 1]) <= self._config.range_m
        others = ~np.eye(poses.shape[-2], dtype=bool)
        joined: BoolArray = near & others & present[..., :, None] & present[..., None, :]
        return joined & ~self._faded(poses)

    def send(
        self,
        frames: Mapping[str, Sequence[RadioFrame]],
        tick: int,
        poses: FloatArray,
        present: BoolArray,
        noise: Noise,
    ) -> None:
        """Judge what the robots at `poses` (n×3) send at this tick. Robots that are not
        `present` (n), dead or deaf, hear nothing."""
        heard, senders, recipients, sizes = self._take(frames, tick)
        if not heard:
            return
        verdicts = np.full((len(heard), len(self._names)), radio_kernels.NOBODY, np.int64)
        radio_kernels.judge(
            np.ascontiguousarray(poses[:, :2]),
            present,
            self._faded(poses),
            self._config.range_m,
            self._config.bytes_per_tick,
            self._config.loss,
            self._luck(senders, tick, noise),
            senders,
            recipients,
            sizes,
            np.zeros((len(self._names), len(self._names)), np.int64),
            verdicts,
        )
        kinds = self.ledger.kind_numbers([frame.kind for frame in heard])
        self.ledger.book_sent(verdicts, senders, sizes, kinds)
        passed = verdicts == Verdict.DELIVERED
        due = tick + self._config.latency_ticks
        self._air.append(Batch(due, tuple(heard), passed, senders, sizes, kinds))

    def receive(self, tick: int, present: BoolArray) -> list[tuple[HeardFrame, ...]]:
        """What arrives at each robot at this tick; nothing does at one that is not `present`."""
        inboxes: list[tuple[HeardFrame, ...]] = [()] * len(self._names)
        while self._air and self._air[0].due_tick <= tick:
            batch = self._air.popleft()
            arrived = batch.passed & present
            for r in np.flatnonzero(arrived.any(axis=0)).tolist():
                inboxes[r] += tuple(compress(batch.frames, arrived[:, r].tolist()))
            verdicts = np.where(arrived, Verdict.DELIVERED, Verdict.ABSENT).astype(np.int64)
            verdicts[~batch.passed] = radio_kernels.NOBODY
            self.ledger.book_arrived(verdicts, batch.senders, batch.sizes, batch.kinds)
        return inboxes

    def _faded(self, poses: FloatArray) -> BoolArray:
        """Between whom the signal is too weak although they are in range (…×n×n)."""
        if self.channel is None:
            return np.zeros((*poses.shape[:-1], poses.shape[-2]), dtype=bool)
        return self.channel.faded(poses)

    def _take(
        self, frames: Mapping[str, Sequence[RadioFrame]], tick: int
    ) -> tuple[
        list[HeardFrame], npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]
    ]:
        """What of all that was sent is a frame to somebody: frames, senders, recipients, sizes."""
        taken: list[HeardFrame] = []
        rows: list[tuple[int, int, int]] = []
        for s, name in enumerate(self._names):
            for frame in frames.get(name, ()):
                size = frame.size_bytes
                amount = (1, size)
                to = TO_ALL if frame.to == BROADCAST else self._numbers.get(frame.to, TO_NOBODY)
                self.ledger.sent[s] += amount
                if len(frame.payload) > MAX_FRAME_BYTES:
                    self.ledger.malformed[s] += amount
                elif to in (TO_NOBODY, s):
                    self.ledger.unknown_recipient[s] += amount
                else:
                    rows.append((s, to, size))
                    taken.append(
                        HeardFrame.model_construct(
                            sender=name,
                            sent_tick=tick,
                            to=frame.to,
                            kind=frame.kind,
                            payload=frame.payload,
                        )
                    )
        senders, recipients, sizes = np.array(rows, dtype=np.int64).reshape(-1, 3).T.copy()
        return taken, senders, recipients, sizes

    def _luck(self, senders: npt.NDArray[np.int64], tick: int, noise: Noise) -> FloatArray:
        """Uniform numbers (f×n) that decide loss: each sender's own, for all robots there are."""
        n = len(self._names)
        if self._config.loss == 0.0:
            return np.zeros((len(senders), n))
        # Frames stand in the order of their senders.
        items = np.arange(len(senders)) - np.searchsorted(senders, senders)
        return noise.stream(self._names, "loss").uniforms_of(tick, senders, items, n)
