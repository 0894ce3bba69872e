"""The study of peers: what it makes of a converted log, and what it says without a peer."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from station.formats import Trajectory
from station.scan_log import read_log
from studies.peers import PEERS, Figures, Measure, PeerError, compare, require_peer


def write_log(path: Path) -> None:
    """A robot that drives 4 m along the middle of a room of 10 × 4 m."""
    angles = np.radians(np.arange(180) - 90.0)
    lines = []
    for number in range(40):
        x = 0.1 * number
        with np.errstate(divide="ignore"):
            ahead = np.where(np.cos(angles) > 1e-9, (8.0 - x) / np.cos(angles), np.inf)
            aside = np.where(np.abs(np.sin(angles)) > 1e-9, 2.0 / np.abs(np.sin(angles)), np.inf)
        ranges = " ".join(f"{value:.3f}" for value in np.minimum(ahead, aside))
        pose = f"{x:.3f} 0.0 0.0"
        lines.append(f"FLASER 180 {ranges} {pose} {pose} {number:.1f} host {number:.1f}\n")
    path.write_text("".join(lines))


def test_without_the_peer_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(PeerError, match="mrpt-apps"):
        require_peer()


def test_both_play_the_same_log(tmp_path: Path) -> None:
    try:
        require_peer()
    except PeerError as error:
        pytest.skip(str(error))
    path = tmp_path / "room.clf"
    write_log(path)
    log = read_log(path)
    stamps = np.array([scan.stamp for scan in log.scans])
    truth = np.column_stack([0.1 * np.arange(40), np.zeros((40, 2))])
    found = dict(compare(path, log, Measure(Trajectory(stamps, truth), None, False), 60.0))
    assert set(found) == {"earshot", *PEERS}
    for figures in found.values():
        assert isinstance(figures, Figures)
        assert figures.ate_rmse_m is not None
        assert figures.ate_rmse_m < 0.2
        assert math.isfinite(figures.ms_per_scan)  # of so few scans less than the start varies by
    assert isinstance(found["earshot"], Figures)
    assert found["earshot"].ms_per_scan > 0.0
