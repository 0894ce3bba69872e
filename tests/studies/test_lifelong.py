"""The study of hours of patrol, in small."""

import pytest

from studies import lifelong
from world.scenario import RobotSpec, Scenario


def test_samples_come_as_the_robot_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lifelong, "SAMPLE_EVERY_S", 5.0)
    robots = (RobotSpec(name="r1", policy="patrol"),)
    samples = list(lifelong.patrol(Scenario(map="rooms-small", robots=robots, max_sim_s=11.0)))
    assert [sample.stamp for sample in samples] == pytest.approx([5.0, 10.0])
    assert samples[1].driven_m > samples[0].driven_m > 0.0
    assert all(sample.error_m < 0.1 for sample in samples)
    assert lifelong.summary(samples)["nodes"] == [sample.nodes for sample in samples]
