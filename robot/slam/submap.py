"""A submap: the correlation field of a stretch of travel, in the frame of its anchor."""

import dataclasses
from dataclasses import dataclass

from protocol.pose import FloatArray, Pose2
from robot.perception.field import CorrelationField
from robot.perception.returns import Returns
from robot.perception.search import Blocks, Pyramid


@dataclass(slots=True)
class Submap:
    """Scans drawn relative to anchor `index`. Once finished it never changes again."""

    TRANSIENT = ("pyramid",)

    index: int
    field: CorrelationField
    keyframes: list[FloatArray] = dataclasses.field(default_factory=list)
    """`T_anchor_keyframe` (3,) of every scan drawn."""
    travel_m: float = 0.0
    finished: bool = False
    pyramid: Pyramid | None = None
    """What searches look at, of a finished one: made when it is first asked for."""

    @staticmethod
    def start(index: int, extent_m: float, spare: CorrelationField | None = None) -> "Submap":
        """An empty submap; the extent holds the sensor's range and the submap's own travel.

        `spare` is an empty field of that extent, if there is one."""
        return Submap(index, spare or CorrelationField.around(extent_m))

    def insert(self, T_anchor_base: Pose2, returns: Returns) -> None:
        """Draw a scan, and count the travel from the one before."""
        if self.keyframes:
            last = Pose2.from_array(self.keyframes[-1])
            self.travel_m += last.distance_to(T_anchor_base)
        self.keyframes.append(T_anchor_base.to_array())
        self.field.draw(T_anchor_base, returns)

    def finish(self) -> CorrelationField:
        """Keep the field without its empty margin; the large one is returned, empty again."""
        large, self.field = self.field, self.field.cropped()
        self.finished = True
        large.clear()
        return large

    def searchable(self, half_m: float) -> Pyramid:
        """What a search of a finished submap in a window of ± `half_m` looks at.

        A control step asks for it, never a job, for it is kept for the next one."""
        if self.pyramid is None or not self.pyramid.is_enough(half_m):
            self.pyramid = Pyramid.of(Blocks.of(self.field), half_m)
        return self.pyramid.up_to(half_m)
