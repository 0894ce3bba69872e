"""Where the frames lie that robots think in while a run goes on: by the truth, for the operator."""

import numpy as np

from protocol.pose import IDENTITY, Pose2
from world.simulation import Simulation


def born_at(simulation: Simulation, name: str) -> int:
    """The tick at which a robot's last life began: 0, or when it was back after its death."""
    present = simulation.history.present[:, simulation.names.index(name)]
    begins = np.flatnonzero(present[1:] & ~present[:-1])
    return int(begins[-1]) + 1 if len(begins) else 0


def was_told(simulation: Simulation, name: str) -> bool:
    """Whether a robot was told where its last life began; after a death nobody is."""
    return simulation.scenario.starts != "unknown" and born_at(simulation, name) == 0


def frame_of(simulation: Simulation, name: str) -> Pose2:
    """`T_world_frame` of what a robot reports now.

    Who was told where it starts thinks in the frame in which it was told; who was not, in that of
    its first anchor: where its last life began.
    """
    number, born = simulation.names.index(name), born_at(simulation, name)
    if born:
        return Pose2.from_array(simulation.history.poses[born, number])
    if not was_told(simulation, name):
        return Pose2.from_array(simulation.starts[number])
    if simulation.scenario.starts == "known":
        return IDENTITY
    return Pose2.from_array(simulation.starts[0])
