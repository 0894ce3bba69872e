"""Where the frames lie that robots think in while a run goes on: by the truth, for the operator."""

import numpy as np

from protocol.pose import IDENTITY, Pose2
from world.simulation import Simulation


def frame_of(simulation: Simulation, name: str) -> Pose2:
    """`T_world_frame` of what a robot reports now.

    Who was told where it starts thinks in the frame in which it was told; who was not, in that of
    its first anchor: where it began its present life, after a death where it stood then.
    """
    number, history = simulation.names.index(name), simulation.history
    missing = np.flatnonzero(~history.present[:, number])
    if len(missing):
        back = min(int(missing[-1]) + 1, len(history) - 1)
        return Pose2.from_array(history.poses[back, number])
    starts = simulation.scenario.starts
    if starts == "known":
        return IDENTITY
    return Pose2.from_array(simulation.starts[number if starts == "unknown" else 0])
