"""Rigid motions of the plane, SE(2).

`T_a_b` maps coordinates in frame b into frame a, so that `T_a_b @ T_b_c` is `T_a_c`. Angles are
radians in [-π, π). Tangent vectors are ordered (x, y, θ), in the frame of the right-hand side
(the body): `T @ Pose2.exp(v)`. Source: Sola, Deray, Atchuthan, "A micro Lie theory for state
estimation in robotics", 2018, section on SE(2).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

# Below this angle sin θ / θ and (1 − cos θ) / θ lose digits to cancellation; the series do not.
SMALL_ANGLE = 1e-6


def wrap_angle(angle: float) -> float:
    """The same direction in [-π, π)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@dataclass(frozen=True, slots=True, init=False)
class Pose2:
    """A pose or rigid motion: metres, metres, radians."""

    x: float
    y: float
    theta: float

    def __init__(self, x: float, y: float, theta: float) -> None:
        # A scan makes dozens of poses, and what a frozen dataclass does here takes twice as long.
        _SET_X(self, x)
        _SET_Y(self, y)
        _SET_THETA(self, theta)

    def __matmul__(self, other: "Pose2") -> "Pose2":
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose2(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap_angle(self.theta + other.theta),
        )

    def inverse(self) -> "Pose2":
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.theta))

    def apply(self, points: FloatArray) -> FloatArray:
        """Map n×2 points from frame b into frame a."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        out = np.empty_like(points)
        out[:, 0] = self.x + c * points[:, 0] - s * points[:, 1]
        out[:, 1] = self.y + s * points[:, 0] + c * points[:, 1]
        return out

    def adjoint(self) -> FloatArray:
        """The 3×3 matrix with `T @ exp(v) == exp(adjoint @ v) @ T`."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return np.array([[c, -s, self.y], [s, c, -self.x], [0.0, 0.0, 1.0]])

    def log(self) -> FloatArray:
        """The tangent vector v with `exp(v) == self`."""
        theta = wrap_angle(self.theta)
        half = 0.5 * theta
        # (θ/2) / tan(θ/2), whose limit at zero is 1 − θ²/12
        a = 1.0 - theta * theta / 12.0 if abs(theta) < SMALL_ANGLE else half / math.tan(half)
        return np.array([a * self.x + half * self.y, a * self.y - half * self.x, theta])

    @staticmethod
    def exp(tangent: FloatArray) -> "Pose2":
        """The motion reached by following a constant twist (x, y, θ) for one unit of time."""
        u, v, theta = float(tangent[0]), float(tangent[1]), float(tangent[2])
        if abs(theta) < SMALL_ANGLE:
            a, b = 1.0 - theta * theta / 6.0, 0.5 * theta
        else:
            a, b = math.sin(theta) / theta, (1.0 - math.cos(theta)) / theta
        return Pose2(a * u - b * v, b * u + a * v, wrap_angle(theta))

    @staticmethod
    def from_array(values: "FloatArray | tuple[float, float, float] | list[float]") -> "Pose2":
        if isinstance(values, np.ndarray):
            return Pose2(*values.tolist())  # its numbers one by one would take longer
        return Pose2(float(values[0]), float(values[1]), float(values[2]))

    def to_array(self) -> FloatArray:
        return np.array([self.x, self.y, self.theta])

    def distance_to(self, other: "Pose2") -> float:
        return math.hypot(self.x - other.x, self.y - other.y)


_SET_X, _SET_Y, _SET_THETA = (Pose2.__dict__[name].__set__ for name in ("x", "y", "theta"))

IDENTITY = Pose2(0.0, 0.0, 0.0)


def wrap_angles(angles: FloatArray) -> FloatArray:
    """`wrap_angle` over an array of any shape."""
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi, dtype=np.float64)


def compose(T_a_b: FloatArray, T_b_c: FloatArray) -> FloatArray:
    """`T_a_b @ T_b_c` over n×3 arrays of poses; either side may be a single pose (3,)."""
    c, s = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    return np.stack(
        [
            T_a_b[..., 0] + c * T_b_c[..., 0] - s * T_b_c[..., 1],
            T_a_b[..., 1] + s * T_b_c[..., 0] + c * T_b_c[..., 1],
            wrap_angles(T_a_b[..., 2] + T_b_c[..., 2]),
        ],
        axis=-1,
    )


def invert(T_a_b: FloatArray) -> FloatArray:
    """`T_b_a` over an n×3 array of poses or a single pose (3,)."""
    c, s = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    x, y = T_a_b[..., 0], T_a_b[..., 1]
    return np.stack([-c * x - s * y, s * x - c * y, wrap_angles(-T_a_b[..., 2])], axis=-1)
