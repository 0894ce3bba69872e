"""`earshot radio`: the picture, what it says, and what it refuses."""

from pathlib import Path

import numpy as np
import pytest

from maps.library import load_map
from station.main import main
from world.channel import Channel
from world.noise import Noise
from world.scenario import GateConfig
from world.terrain import Terrain

AT = (9.5, 5.5)


@pytest.mark.parametrize("gate", ["disc", "line-of-sight", "shadowing"])
def test_a_picture_is_drawn(gate: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "deeper" / "radio.png"
    code = main(["radio", "rooms-small", "--at", "3,3", "--gate", gate, "--out", str(out)])
    assert code == 0
    assert out.read_bytes().startswith(b"\x89PNG")
    said = capsys.readouterr().out
    assert f"gate {gate}, d = 10 m" in said
    assert said.splitlines()[-1] == str(out)


@pytest.mark.parametrize("model", ["disc", "line-of-sight", "shadowing"])
def test_what_is_drawn_is_what_the_gate_does(model: str) -> None:
    terrain = Terrain(load_map("office"))
    gate = GateConfig.model_validate({"model": model, "range_m": 8.0})
    channel = Channel(gate, terrain, Noise(3))
    heard = channel.heard(AT)
    assert not (heard & ~terrain.grid.free).any()
    rows, columns = np.nonzero(terrain.grid.free)
    points = terrain.grid.to_points(rows, columns)
    rng = np.random.default_rng(0)
    for k in rng.choice(len(points), 200, replace=False).tolist():
        poses = np.array([[*AT, 0.0], [*points[k], 0.0]])
        near = np.hypot(*(poses[1] - poses[0])[:2]) <= 8.0
        assert heard[rows[k], columns[k]] == (near and not channel.faded(poses)[0, 1])


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--at", "900,900"], "not free ground"),
        (["--at", "3,3", "--set", "colour=blue"], "radio.colour"),
        (["--at", "3,3", "--set", "colour"], "FIELD=VALUE"),
        (["--at", "3,3", "--range", "-1"], "radio.range_m"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(
    options: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "radio.png"
    assert main(["radio", "rooms-small", *options, "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
    assert not out.exists()
