"""SE(2) in compiled loops: what `protocol.pose` does, on rows (x, y, θ) of arrays.

Angles are added up as they are: `wrap` those that leave the loop.
"""

import math

from protocol.kernel import inlined


@inlined
def wrap(angle):
    """The same direction in [-π, π)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@inlined
def apply(T_a_b, x, y):
    """A point of frame b as frame a has it."""
    c = math.cos(T_a_b[2])
    s = math.sin(T_a_b[2])
    return T_a_b[0] + c * x - s * y, T_a_b[1] + s * x + c * y


@inlined
def apply_inverse(T_a_b, x, y):
    """A point of frame a as frame b has it."""
    c = math.cos(T_a_b[2])
    s = math.sin(T_a_b[2])
    dx = x - T_a_b[0]
    dy = y - T_a_b[1]
    return c * dx + s * dy, -s * dx + c * dy


@inlined
def compose(T_a_b, T_b_c, out):
    """out = T_a_c; it may be one of the two."""
    theta = T_a_b[2] + T_b_c[2]
    out[0], out[1] = apply(T_a_b, T_b_c[0], T_b_c[1])
    out[2] = theta


@inlined
def between(T_a_b, T_a_c, out):
    """out = T_b_c; it may be one of the two."""
    theta = T_a_c[2] - T_a_b[2]
    out[0], out[1] = apply_inverse(T_a_b, T_a_c[0], T_a_c[1])
    out[2] = theta


@inlined
def exp(tangent, out):
    """out = the motion reached by following a twist (x, y, θ) for one unit of time."""
    theta = tangent[2]
    if abs(theta) < 1e-6:
        a = 1.0 - theta * theta / 6.0
        b = 0.5 * theta
    else:
        a = math.sin(theta) / theta
        b = (1.0 - math.cos(theta)) / theta
    out[0] = a * tangent[0] - b * tangent[1]
    out[1] = b * tangent[0] + a * tangent[1]
    out[2] = theta
