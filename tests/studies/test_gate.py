"""The check of the gate finds nothing wrong with it, and would find what is."""

import pytest

from studies import gate
from world.radio import Radio


def test_no_frame_breaks_the_rule() -> None:
    result = gate.check(10_000, seed=1)
    assert result["frames"] >= 10_000
    assert result["delivered"] > 1000
    assert result["booked_lost"] > 100
    assert result["booked_capacity"] > 100
    assert result["delivered_beyond_range"] == 0
    assert result["lost_in_range_without_reason"] == 0


def test_a_gate_with_another_range_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    rule = gate.CONFIG.model_copy(update={"range_m": 10.0})
    monkeypatch.setattr(gate, "Radio", lambda _, names: Radio(rule, names))
    assert gate.check(5_000, seed=1)["lost_in_range_without_reason"] > 0
