"""The ledger of the radio: every frame offered is delivered, dropped for a reason, or in flight."""

from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from protocol.errors import EarshotError
from world import radio_kernels

# A robot may name its kinds of frames as it likes; beyond so many they are counted together.
MAX_KINDS = 64
OTHER_KINDS = "other"

Counts = npt.NDArray[np.int64]


class Verdict(IntEnum):
    """What became of an offer: of one frame, to one robot."""

    DELIVERED = radio_kernels.DELIVERED
    RANGE = radio_kernels.RANGE
    """Farther than d when it was sent."""
    LOSS = radio_kernels.LOSS
    """Lost at random on the way."""
    CAPACITY = radio_kernels.CAPACITY
    """The directed pair had no room for it in that tick."""
    ABSENT = radio_kernels.ABSENT
    """The receiver was dead, or frozen for long, when it was sent or when it arrived."""
    FADE = radio_kernels.FADE
    """Within d, but walls or shadowing left too little of it."""


DROPPED = tuple(verdict for verdict in Verdict if verdict is not Verdict.DELIVERED)


class LedgerError(EarshotError):
    """A ledger whose sums do not agree: a fault of the gate, never of a robot."""


class Ledger:
    """Frames (…, 0) and bytes (…, 1), by ordered pair and by kind of frame.

    A broadcast is one offer to every other robot. What is sent to nobody on the roster, and what
    no radio would carry, is an offer to no pair: it is counted by sender alone. Only a radio that
    `fades` has that reason in its tables.
    """

    def __init__(self, names: Sequence[str], fades: bool = False) -> None:
        n = len(names)
        self._reasons = tuple(v for v in DROPPED if fades or v is not Verdict.FADE)
        self.names = tuple(names)
        self.sent: Counts = np.zeros((n, 2), np.int64)
        """What each robot handed to its radio, a broadcast once."""
        self.unknown_recipient: Counts = np.zeros((n, 2), np.int64)
        self.malformed: Counts = np.zeros((n, 2), np.int64)
        self.offered: Counts = np.zeros((n, n, 2), np.int64)
        self.in_flight: Counts = np.zeros((n, n, 2), np.int64)
        self.ended: Counts = np.zeros((n, n, len(Verdict), 2), np.int64)
        self.kinds: dict[str, int] = {}
        self.kinds_offered: Counts = np.zeros((MAX_KINDS, 2), np.int64)
        self.kinds_ended: Counts = np.zeros((MAX_KINDS, len(Verdict), 2), np.int64)

    @property
    def delivered(self) -> Counts:
        """By ordered pair (n×n×2: sender, receiver; frames, bytes)."""
        return self.ended[:, :, Verdict.DELIVERED]

    @property
    def heard(self) -> Counts:
        """What was delivered to each robot (n×2)."""
        total: Counts = self.delivered.sum(axis=0)
        return total

    def kind_numbers(self, kinds: Iterable[str]) -> Counts:
        """A number for each kind; new ones are taken up as long as there is room."""
        for kind in kinds:
            if kind not in self.kinds:
                full = len(self.kinds) >= MAX_KINDS - 1
                self.kinds.setdefault(OTHER_KINDS if full else kind, len(self.kinds))
        last = self.kinds.get(OTHER_KINDS, MAX_KINDS - 1)
        return np.array([self.kinds.get(kind, last) for kind in kinds], dtype=np.int64)

    def book_sent(self, verdicts: Counts, senders: Counts, sizes: Counts, kinds: Counts) -> None:
        """Take in verdicts (f×n) over frames (f) that were sent; what passed is in flight."""
        radio_kernels.book_sent(
            verdicts,
            senders,
            sizes,
            kinds,
            self.offered,
            self.in_flight,
            self.ended,
            self.kinds_offered,
            self.kinds_ended,
        )

    def book_arrived(self, verdicts: Counts, senders: Counts, sizes: Counts, kinds: Counts) -> None:
        """Take in verdicts (f×n) over frames (f) that were in flight."""
        radio_kernels.book_arrived(
            verdicts, senders, sizes, kinds, self.in_flight, self.ended, self.kinds_ended
        )

    def check(self) -> None:
        """Raise LedgerError unless offered = delivered + dropped + in flight, pair by pair, and
        pairs and kinds count the same."""
        accounted = self.ended.sum(axis=2) + self.in_flight
        if not np.array_equal(self.offered, accounted):
            s, r = np.argwhere((self.offered != accounted).any(axis=2))[0]
            raise LedgerError(
                f"ledger {self.names[s]} -> {self.names[r]}: offered {self.offered[s, r].tolist()}"
                f" but accounted for {accounted[s, r].tolist()} (frames, bytes)"
            )
        by_pair, by_kind = self.ended.sum(axis=(0, 1)), self.kinds_ended.sum(axis=0)
        if not np.array_equal(by_pair, by_kind):
            raise LedgerError(f"ledger: pairs say {by_pair.tolist()}, kinds {by_kind.tolist()}")

    def table(self) -> list[dict[str, Any]]:
        """One row for each ordered pair that was offered anything."""
        rows = []
        for s, r in np.argwhere(self.offered[:, :, 0] > 0).tolist():
            row: dict[str, Any] = {"sender": self.names[s], "receiver": self.names[r]}
            amounts = self.offered[s, r], self.ended[s, r], self.in_flight[s, r]
            rows.append(row | self._row(*amounts))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """The whole ledger as plain numbers, in an order that does not depend on the run."""
        n = range(len(self.names))
        kinds_in_flight = self.kinds_offered - self.kinds_ended.sum(axis=1)
        return {
            "total": self._row(
                self.offered.sum(axis=(0, 1)),
                self.ended.sum(axis=(0, 1)),
                self.in_flight.sum(axis=(0, 1)),
            ),
            "robots": {
                self.names[i]: {
                    "sent": _amount(self.sent[i]),
                    "heard": _amount(self.heard[i]),
                    "unknown_recipient": _amount(self.unknown_recipient[i]),
                    "malformed": _amount(self.malformed[i]),
                }
                for i in n
            },
            "pairs": self.table(),
            "kinds": {
                kind: self._row(self.kinds_offered[k], self.kinds_ended[k], kinds_in_flight[k])
                for kind, k in sorted(self.kinds.items())
            },
        }

    def _row(self, offered: Counts, ended: Counts, in_flight: Counts) -> dict[str, Any]:
        row: dict[str, Any] = {"offered": _amount(offered)}
        row["delivered"] = _amount(ended[Verdict.DELIVERED])
        row["dropped"] = {v.name.lower(): _amount(ended[v]) for v in self._reasons}
        row["in_flight"] = _amount(in_flight)
        return row


def _amount(counts: Counts) -> dict[str, int]:
    return {"frames": int(counts[0]), "bytes": int(counts[1])}
