"""How much one sender may say before it is no longer listened to, until the next tick."""

SIZE_UNIT_BYTES = 16_384
BURST_TICKS = 4


class Allowance:
    """A token bucket: filled up tick by tick, emptied message by message.

    A message costs one for itself and one for each full 16 KiB. It is taken from in Zenoh's
    receiving thread, so that what is refused is neither kept nor decoded.
    """

    def __init__(self, per_tick: int) -> None:
        self.refused = 0
        """Messages that were dropped unread, ever."""
        self._per_tick = per_tick
        self._left = self._most = BURST_TICKS * per_tick
        self._exhausted = False

    def take(self, size_bytes: int) -> bool:
        """Whether a message of this size may pass."""
        cost = 1 + size_bytes // SIZE_UNIT_BYTES
        if cost > self._left:
            self.refused += 1
            return False
        self._left -= cost
        return True

    def turned_empty(self) -> bool:
        """Whether this is the first refusal since it was last refilled; asked once for each."""
        first, self._exhausted = not self._exhausted, True
        return first

    def refill(self) -> None:
        """A tick has passed."""
        self._left = min(self._most, self._left + self._per_tick)
        self._exhausted = False
