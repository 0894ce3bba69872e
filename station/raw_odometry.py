"""Motion by a log's odometry, of which nothing is known but that it errs."""

import math

import numpy as np

from protocol.pose import FloatArray, Pose2, compose, invert
from robot.perception.odometry import Motion


def raw_motions(odometry: FloatArray) -> list[Motion]:
    """The motion to each pose (n×3) from the one before, to the first one none.

    Stamps are late and wheels scrub, and turns are worth little.
    """
    before = np.concatenate([odometry[:1], odometry[:-1]])
    steps = compose(invert(before), odometry)
    metres = np.array(list(map(math.hypot, *steps[:, :2].T.tolist())))
    radians = np.abs(steps[:, 2])
    covariances = np.zeros((len(steps), 3, 3))
    covariances[:, 0, 0] = (0.10 * metres + 0.02 * radians + 0.001) ** 2
    covariances[:, 1, 1] = (0.05 * metres + 0.02 * radians + 0.001) ** 2
    covariances[:, 2, 2] = (0.20 * radians + 0.05 * metres + 0.001) ** 2
    poses = [Pose2(*step) for step in steps.tolist()]
    return [Motion(step, covariance) for step, covariance in zip(poses, covariances, strict=True)]
