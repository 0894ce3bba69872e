"""The study of made-up logs, in small."""

from pathlib import Path

import numpy as np
import pytest

from maps.library import load_map
from station.scan_log import read_log
from studies.synthetic_logs import FROZEN, KINDS, main, make_log, measure, wheels_said
from world.terrain import Terrain


@pytest.mark.parametrize("kind", ["sick-8m", "all-round"])
def test_a_log_is_made_and_played(tmp_path: Path, kind: str) -> None:
    path = make_log(Terrain(load_map("rooms-small")), KINDS[kind], 25.0, 1, tmp_path)
    log = read_log(path)
    assert len(log.scans[0].ranges) == KINDS[kind].beams
    figures = measure(path, 3)
    assert figures["metres"] > 20.0
    assert max(figures["forwards"], figures["backwards"], figures["every 3"]) < 0.06


def test_wheels_that_freeze_catch_up() -> None:
    way = np.column_stack([0.03 * np.arange(4000), np.zeros((4000, 2))])
    said = wheels_said(way, FROZEN, np.random.default_rng(0))
    steps = np.hypot(*np.diff(said[:, :2], axis=0).T)
    assert (steps[1:] == 0.0).sum() > 20
    assert steps.max() > 0.2
    assert steps.sum() == pytest.approx(0.98 * 0.03 * 4000, rel=0.1)


def test_kinds_that_are_not_there_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--kinds", "sonar"]) == 2
    assert "there are sick-180" in capsys.readouterr().err
