"""A robot that starts again looks for the place where its last life ended: it should stand there.

Its wheels stopped when it died, so its first scans show what the last ones of its old log showed.
Where they are found there, and at the right spot, the two logs are tied as surely as by a meeting:
nobody else leaves a log that ends here. Carried elsewhere meanwhile, it finds nothing, and its logs
are aligned like those of strangers.
"""

from dataclasses import replace

import numpy as np

from protocol.config import LidarConfig
from protocol.pose import FloatArray
from robot.jobs import Jobs
from robot.perception.returns import noise_model
from robot.slam.gaussian import carry, invert_spd
from robot.team.entries import Link
from robot.team.evidence import Kind
from robot.team.joint import JointGraph
from robot.team.journal import LogName
from robot.team.place import Stretch, make_place
from robot.team.place_match import find_place
from robot.team.place_search import SearchGround

JOB = "homecoming"
EVERY_TICKS = 5
LANDING_TICKS = 4
# Keyframes of the new life with which it is tried, and links that are enough.
TRIED_AT = (1, 2, 3, 5, 8)
ENOUGH = 2
# Of the old life so many keyframes are looked at, and it ended at most so far from here: a keyframe
# that was not taken yet, or lost, and the way that it takes to stop.
LAST_KEYFRAMES = 12
RETURN_M = 2.0


class Homecoming:
    """Ties the log of this life to that of the one before, if there was one."""

    def __init__(self, own: LogName, lidar: LidarConfig) -> None:
        self._own = own
        self._noise = noise_model(lidar)
        self._tries = 0
        self._found = 0

    def step(self, tick: int, jobs: Jobs, graph: JointGraph) -> list[Link]:
        """The links that landed at this tick; starts the next try when it is due."""
        found = [link for link in jobs.landed(JOB, tick) if link is not None]
        self._found += len(found)
        if tick % EVERY_TICKS or self._found >= ENOUGH or self._tries >= len(TRIED_AT):
            return found
        before, log = self._life_before(graph), graph.log(self._own)
        if before is None or log is None or len(log.keyframes) < TRIED_AT[self._tries]:
            return found
        if not jobs.pending(JOB):
            self._tries += 1
            logs = graph.snapshot({self._own, before})
            jobs.start(JOB, tick, LANDING_TICKS, come_home, logs, self._own, before, self._noise)
        return found

    def _life_before(self, graph: JointGraph) -> LogName | None:
        """The last life of this robot of which there is anything to be found."""
        return max(
            (
                name
                for name in graph.logs()
                if name.robot == self._own.robot
                and name < self._own
                and (log := graph.log(name)) is not None
                and log.keyframes
            ),
            default=None,
        )


def come_home(graph: JointGraph, own: LogName, before: LogName, noise: FloatArray) -> Link | None:
    """The end of the log `before` as seen from the beginning of `own`. Pure: runs as a job."""
    old_log, new_log = graph.log(before), graph.log(own)
    assert old_log is not None
    assert new_log is not None
    count = len(old_log.keyframes)
    old = make_place(old_log, Stretch(0, max(0, count - LAST_KEYFRAMES), count), noise)
    new = make_place(new_log, Stretch(0, 0, len(new_log.keyframes)), noise)
    for match in find_place(SearchGround.of(old), new):
        (stands,) = match.T_a_b.apply(new.keyframes[:1, :2])
        if float(np.hypot(*(stands - old.keyframes[-1, :2]))) <= RETURN_M:
            T_new_old = match.T_a_b.inverse()
            covariance = carry(invert_spd(match.information), T_new_old)
            evidence = replace(match.evidence, kind=Kind.SIGHTING)
            return Link(new.anchor, before, old.anchor, T_new_old, invert_spd(covariance), evidence)
    return None
