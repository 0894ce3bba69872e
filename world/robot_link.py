"""The world's end of the wire to one robot: what it sent, what it owes, what waits for it."""

from collections.abc import Sequence

from protocol.allowance import Allowance
from protocol.messages import Action, HeardFrame, RadioFrame, Report, Sense
from world.report_log import ReportLog

MOST_WAITING_BYTES = 8_000_000


class RobotLink:
    """Bookkeeping alone; sending and receiving is the shell's.

    A robot `owes` an answer from the moment a sense is sent to it. In lockstep it gets no second
    one before it answered: the frames of the ticks between wait here, and encoders are
    cumulative, so that a robot that was frozen for a while has missed nothing when it wakes.
    Frozen for so long that it `is_full`, it should be sent no more.
    What it says beyond its `allowance` is not read, and what answers no sense that it was sent,
    or one that it answered before, counts for nothing.
    """

    def __init__(self, name: str, allowance: Allowance) -> None:
        self.name = name
        self.allowance = allowance
        self.present = False
        self.lost = False
        self.owes = False
        self.stalled = False
        self.stalls = 0
        self.missed = 0
        self.stale = 0
        self.mutes = 0
        self.returns = 0
        self.muted_until: int | None = None
        self.reports = ReportLog()
        self._answered = -1
        self._action: Action | None = None
        self._sent: list[RadioFrame] = []
        self._waiting: list[HeardFrame] = []
        self._waiting_bytes = 0

    @property
    def muted(self) -> bool:
        return self.muted_until is not None

    @property
    def alive(self) -> bool:
        return self.present and not self.lost

    def hold(self, frames: Sequence[HeardFrame]) -> None:
        """Keep frames for the next sense that is sent."""
        self._waiting.extend(frames)
        self._waiting_bytes += sum(frame.size_bytes for frame in frames)

    @property
    def is_full(self) -> bool:
        """Whether no more frames should be kept for it."""
        return self._waiting_bytes >= MOST_WAITING_BYTES

    def outgoing(self, sense: Sense) -> tuple[list[HeardFrame], Sense]:
        """All frames that are due with a sense, and the sense with their number."""
        frames, self._waiting = [*self._waiting, *sense.frames], []
        self._waiting_bytes = 0
        self.owes = True
        if len(frames) == sense.frame_count:
            return frames, sense
        return frames, sense.model_copy(update={"frame_count": len(frames)})

    def accept_frame(self, frame: RadioFrame) -> None:
        self._sent.append(frame)

    def accept_action(self, action: Action, tick: int) -> None:
        """The newest action counts; also a late one ends a stall. `tick` is the present one."""
        if not self._answered < action.tick <= tick:
            self.stale += 1
            return
        self._answered = action.tick
        self._action = action
        self.owes = self.stalled = False

    def accept_report(self, report: Report, tick: int) -> None:
        """One report for each tick at most is kept."""
        before = self.reports.latest
        if not (before.tick if before else -1) < report.tick <= tick:
            self.stale += 1
            return
        self.reports.append(report)

    def take_action(self) -> Action | None:
        """The newest action since the last call, with every frame that came up to it."""
        action, self._action = self._action, None
        if action is None:
            return None
        frames, self._sent = tuple(self._sent), []
        return action.model_copy(update={"frames": frames, "frame_count": len(frames)})

    def stall(self) -> None:
        """The robot missed the deadline."""
        self.stalled = True
        self.stalls += 1

    def come_back(self) -> None:
        """A robot that was lost is there again, in a new life: what its old one owed is void."""
        self.lost = self.owes = self.stalled = False
        self.returns += 1
        self._action = None
        self._sent.clear()
        self._waiting.clear()

    def mute(self, until_tick: int) -> None:
        """The robot flooded: nobody waits for it until it is listened to again."""
        self.mutes += 1
        self.muted_until = until_tick
        self.stalled = True

    def unmute(self) -> None:
        """What it answered in between was not read, so it owes nothing and gets a new sense."""
        self.muted_until = None
        self.owes = False

    @property
    def note(self) -> str:
        """What became of the robot, where that is not the ordinary."""
        parts = []
        if self.lost:
            parts.append("lost")
        if self.returns:
            parts.append(f"started again {self.returns} times")
        if self.stalls:
            parts.append(f"stalled {self.stalls} times")
        if self.missed:
            parts.append(f"missed {self.missed} ticks")
        if self.stale:
            parts.append(f"{self.stale} stale messages dropped")
        if self.mutes:
            parts.append(f"muted {self.mutes} times for flooding")
        return ", ".join(parts)
