"""The world's end of the wire to one robot: what it sent, what it owes, what waits for it."""

from collections.abc import Sequence

from protocol.messages import Action, HeardFrame, RadioFrame, Report, Sense


class RobotLink:
    """Bookkeeping alone; sending and receiving is the shell's.

    A robot `owes` an answer from the moment a sense is sent to it. In lockstep it gets no second
    one before it answered: the frames of the ticks between wait here, and encoders are
    cumulative, so that a robot that was frozen for a while has missed nothing when it wakes.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.present = False
        self.lost = False
        self.owes = False
        self.stalled = False
        self.stalls = 0
        self.missed = 0
        self.reports: list[Report] = []
        self._action: Action | None = None
        self._sent: list[RadioFrame] = []
        self._waiting: list[HeardFrame] = []

    @property
    def alive(self) -> bool:
        return self.present and not self.lost

    def hold(self, frames: Sequence[HeardFrame]) -> None:
        """Keep frames for the next sense that is sent."""
        self._waiting.extend(frames)

    def outgoing(self, sense: Sense) -> tuple[list[HeardFrame], Sense]:
        """All frames that are due with a sense, and the sense with their number."""
        frames, self._waiting = [*self._waiting, *sense.frames], []
        self.owes = True
        if len(frames) == sense.frame_count:
            return frames, sense
        return frames, sense.model_copy(update={"frame_count": len(frames)})

    def accept_frame(self, frame: RadioFrame) -> None:
        self._sent.append(frame)

    def accept_action(self, action: Action) -> None:
        """The newest action counts; also a late one ends a stall."""
        self._action = action
        self.owes = self.stalled = False

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

    @property
    def note(self) -> str:
        """What became of the robot, where that is not the ordinary."""
        parts = []
        if self.lost:
            parts.append("lost")
        if self.stalls:
            parts.append(f"stalled {self.stalls} times")
        if self.missed:
            parts.append(f"missed {self.missed} ticks")
        return ", ".join(parts)
