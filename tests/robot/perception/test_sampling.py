"""Looking a field up at all points at once is looking it up at each, to the last bit."""

import math

import numpy as np

from protocol.pose import Pose2
from robot.perception.field import CorrelationField
from robot.perception.field_kernels import look_up
from robot.perception.returns import Returns
from robot.perception.sampling_kernels import sample


def test_samples_are_single_look_ups() -> None:
    chance = np.random.default_rng(4)
    field = chance.integers(0, 256, (40, 60), dtype=np.uint8)
    x, y = chance.uniform(-30.0, 90.0, (2, 500))  # outside too
    c, s, u0, v0 = math.cos(0.4), math.sin(0.4), 3.25, -2.5
    cells, samples = np.empty((6, 500), dtype=np.int32), np.empty((5, 500))
    sample(field, u0, v0, c, s, x, y, cells, samples)
    places = zip(u0 + c * x - s * y, v0 + s * x + c * y, strict=True)
    single = np.array([look_up(field, u, v) for u, v in places])
    assert np.array_equal(samples[:3].T, single)
    assert 0 < np.count_nonzero(single[:, 0]) < 500


def test_a_cleared_field_is_as_a_new_one() -> None:
    """Wherever a scan was drawn, at the field's edge too."""
    chance = np.random.default_rng(5)
    field = CorrelationField.around(6.0)
    values = np.zeros((80, 6))
    values[:, :2], values[:, 4:] = chance.uniform(-7.0, 7.0, (80, 2)), (1.0, 0.02)
    field.draw(Pose2(0.3, -0.2, 0.7), Returns.unlinked(values))
    assert field.nodes.any() and field.free.any()
    field.clear()
    assert not field.nodes.any() and not field.free.any()
