"""What a robot reported over a run: the newest whole, the others as what is drawn of them."""

from array import array

import numpy as np
import numpy.typing as npt

from protocol.messages import Report
from protocol.pose import FloatArray


class ReportLog:
    """In the order of ticks. A report is some kilobytes and comes each second, for as long as a
    robot runs: of the older ones 24 bytes are kept."""

    def __init__(self) -> None:
        self.latest: Report | None = None
        self._ticks = array("q")
        self._known_m2 = array("d")
        self._journal_entries = array("q")

    def __len__(self) -> int:
        return len(self._ticks)

    def append(self, report: Report) -> None:
        """Add the next report."""
        self.latest = report
        self._ticks.append(report.tick)
        self._known_m2.append(report.known_m2)
        self._journal_entries.append(report.journal_entries)

    @property
    def ticks(self) -> npt.NDArray[np.int64]:
        """The tick of each report (n)."""
        return np.array(self._ticks, dtype=np.int64)

    @property
    def known_m2(self) -> FloatArray:
        """The area (n, m²) that the robot's joint map knew."""
        return np.array(self._known_m2, dtype=np.float64)

    @property
    def journal_entries(self) -> npt.NDArray[np.int64]:
        """How many entries (n) of all robots it held."""
        return np.array(self._journal_entries, dtype=np.int64)
