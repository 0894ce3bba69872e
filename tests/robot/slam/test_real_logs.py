"""Real logs, forwards and backwards, with the parameters that every robot has.

Relations: Kümmerle et al., "On measuring the accuracy of SLAM algorithms", 2009; a relation counts
when both of its ends lie within 0.02 s of a scan. The data is research data beside the repository.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from station.formats import read_g2o, read_tum
from station.graph_solution import solve
from station.relations import read_relations, reference_errors, relation_errors
from station.replay import Replay, ReplaySettings, play
from station.scan_log import read_log

SHARED = Path(os.environ.get("EARSHOT_DATA") or Path(__file__).parents[4] / "shared")
DATA = SHARED / "data"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not DATA.is_dir(), reason=f"no logs in {DATA}; EARSHOT_DATA names their folder"
    ),
]


def replay(name: str, backwards: bool = False, noise_m: float = 0.0, seed: int = 1) -> Replay:
    settings = ReplaySettings(reverse=backwards, range_noise_m=noise_m, seed=seed)
    return play(read_log(DATA / "carmen" / f"{name}.clf"), settings)


@pytest.mark.parametrize("backwards", [False, True])
def test_intel_relations(backwards: bool) -> None:
    relations = read_relations(DATA / "relations" / "intel.relations")
    errors = relation_errors(replay("intel-dense", backwards), relations, interpolate=False)
    assert errors.used == 1030
    assert errors.translation_mean_m <= (0.018 if backwards else 0.016)
    assert errors.rotation_mean_deg <= 0.25


@pytest.mark.parametrize("backwards", [False, True])
def test_synthetic_building(backwards: bool) -> None:
    truth = read_tum(DATA / "carmen" / "synth-361.truth.tum")
    assert reference_errors(replay("synth-361", backwards), truth).ate_rmse_m <= 0.006


@pytest.mark.parametrize(
    ("name", "backwards", "noise_m", "limit_m"),
    [
        ("mit-csail", False, 0.0, 0.08),
        ("mit-csail", False, 0.01, 0.12),
        pytest.param(
            "mit-csail",
            True,
            0.0,
            0.12,
            marks=pytest.mark.xfail(strict=True, reason="0.140 m, of a spread from 0.09"),
        ),
        ("mit-csail", True, 0.01, 0.15),  # was 0.83: a turn ended on a lesser peak
        ("intel-910", False, 0.0, 0.12),
        ("intel-910", True, 0.0, 0.12),
    ],
)
def test_loops_of_other_logs_close(
    name: str, backwards: bool, noise_m: float, limit_m: float
) -> None:
    """Against the poses of another SLAM system: agreement, not truth."""
    reference = read_tum(DATA / "carmen" / f"{name}.reference.tum")
    errors = reference_errors(replay(name, backwards, noise_m), reference)
    assert errors.used > 300
    assert errors.ate_rmse_m <= limit_m


def test_mit_csail_backwards() -> None:
    """One run says little: five seeds of range noise scatter from 0.09 to 0.14 m."""
    reference = read_tum(DATA / "carmen" / "mit-csail.reference.tum")
    errors = [
        reference_errors(replay("mit-csail", True, 0.01, seed), reference).ate_rmse_m
        for seed in range(1, 6)
    ]
    assert np.median(errors) <= 0.12
    assert max(errors) <= 0.15


@pytest.mark.parametrize(
    ("name", "chi2"), [("intel", 45.00), ("manhattan", 3549.04), ("MIT", 41.16)]
)
def test_public_pose_graphs(name: str, chi2: float) -> None:
    figures, _ = solve(read_g2o(DATA / "pose_graphs" / f"{name}.g2o"), "auto", robust=False)
    assert figures.converged
    assert figures.chi2 == pytest.approx(chi2, abs=0.01)
