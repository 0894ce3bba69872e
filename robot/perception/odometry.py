"""From cumulative wheel counts to motion with covariance."""

from typing import NamedTuple

import numpy as np

from protocol.config import BodyConfig
from protocol.pose import IDENTITY, FloatArray, Pose2

# What a wheel that did not turn may hide, and the floor that keeps a covariance invertible.
STILL_SIGMA_M = 2e-4
STILL_SIGMA_RAD = 5e-4


class Motion(NamedTuple):
    """The motion since the last one: `T_before_now`, and its covariance (3×3) in the tangent
    space at `now`, ordered (x, y, θ)."""

    T_before_now: Pose2
    covariance: FloatArray


STILL = Motion(IDENTITY, np.diag([STILL_SIGMA_M**2, STILL_SIGMA_M**2, STILL_SIGMA_RAD**2]))


class WheelOdometry:
    """Differential-drive odometry. Counts are cumulative, so that gaps in time lose no motion."""

    def __init__(self, body: BodyConfig) -> None:
        self._body = body
        self._counts: tuple[int, ...] | None = None
        self.pose = IDENTITY  # dead reckoning since the first counts

    def step(self, encoders: tuple[int, ...]) -> Motion:
        """The motion since the previous call, from encoder counts (left, right)."""
        previous, self._counts = self._counts, encoders
        if previous is None or previous == encoders:
            return STILL
        body = self._body
        left = (encoders[0] - previous[0]) * body.metres_per_count
        right = (encoders[1] - previous[1]) * body.metres_per_count
        forward, turn = 0.5 * (left + right), (right - left) / body.wheel_base_m
        T_before_now = Pose2.exp(np.array([forward, 0.0, turn]))
        self.pose = self.pose @ T_before_now
        return Motion(T_before_now, self._covariance(left, right))

    def _covariance(self, left: float, right: float) -> FloatArray:
        body = self._body
        # A slip is rare and large: its variance per metre is spread over the whole drive.
        travel = abs(left) + abs(right)
        slip = body.slip_m**2 * body.slip_rate_hz * travel / max(body.max_speed_mps, 1e-6)
        var_left = (body.encoder_noise * left) ** 2 + slip
        var_right = (body.encoder_noise * right) ** 2 + slip
        base = body.wheel_base_m
        jacobian = np.array([[0.5, 0.5], [0.0, 0.0], [-1.0 / base, 1.0 / base]])
        covariance = jacobian @ np.diag([var_left, var_right]) @ jacobian.T
        turn = (right - left) / base
        # Sideways motion comes from turning while driving only; half the turn is its lever.
        covariance[1, 1] += (0.5 * turn) ** 2 * covariance[0, 0]
        return np.asarray(covariance + STILL.covariance, dtype=np.float64)
