"""The studies of merging: that they tell right from false, and that trials can be had again."""

import math
from pathlib import Path

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from maps.library import load_map
from protocol.pose import Pose2
from robot.team.hypothesis import solve_alone
from station.merge import make_graph
from studies import false_matches
from studies.grid_features import DETECTORS, merge_by_features
from studies.lone_journals import LoneJournal, lone_journal
from studies.merging import Choice, Pair, choices, run_trial, study, table
from studies.merging_truth import ONE, TWO, Errors, Truth, outcome_of
from studies.merging_worlds import SETS, is_told_apart, kind_of, worlds_of

WORLD, SECONDS = "rooms-small", 30.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("journals")


@pytest.fixture(scope="module")
def journals(folder: Path) -> tuple[LoneJournal, LoneJournal]:
    return (
        lone_journal(WORLD, 0, SECONDS, folder),
        lone_journal(WORLD, 1, SECONDS, folder),
    )


def test_a_journal_is_played_once_and_cut_by_its_keyframes(
    journals: tuple[LoneJournal, LoneJournal], folder: Path
) -> None:
    one = journals[0]
    again = lone_journal(WORLD, 0, SECONDS, folder)
    assert len(again.entries) == len(one.entries)
    np.testing.assert_array_equal(again.truth, one.truth)
    half = one.cut(0.5)
    assert len(half.keyframes) == round(0.5 * len(one.keyframes))
    assert half.entries == one.entries[: len(half.entries)]
    assert len(half.truth) == half.keyframes[-1].tick + 1


def test_choices_follow_from_the_seed_and_go_through_all_pairs() -> None:
    asked = list(choices(["a", "b"], 3, 60.0, 6, 4, 7))
    assert asked == list(choices(["a", "b"], 3, 60.0, 6, 4, 7))
    assert len({choice.pair for choice in asked[:6]}) == 6
    assert all(choice.pair.worlds[0] == choice.pair.worlds[1] for choice in asked[:6])
    assert all(choice.pair.worlds[0] != choice.pair.worlds[1] for choice in asked[6:])
    assert not set(SETS["tuning"]) & set(SETS["scoring"])
    assert worlds_of("office") == ["office"] and kind_of("maps/aces.yaml") == "aces"


def test_a_trial_is_merged_rightly_and_not_run_again(folder: Path) -> None:
    pair = Pair(worlds=(WORLD, WORLD), seeds=(0, 1), seconds=SECONDS)
    choice = Choice(number=0, pair=pair, shares=(1.0, 1.0))
    trial = run_trial(choice, folder)
    assert trial.outcome == "right" and trial.told
    assert trial.overlap is not None and trial.overlap > 0.5
    assert trial.error_m is not None and trial.error_m < 0.05
    (folder / "trials.jsonl").write_text(trial.model_dump_json() + "\n")
    assert list(study([choice], folder, 1)) == [trial]
    assert "overlap ≥ 50 %" in table([trial])


def test_errors_are_those_of_the_second_map(journals: tuple[LoneJournal, LoneJournal]) -> None:
    one, two = journals
    truth = Truth(one, two)
    graph = make_graph({ONE: one.entries, TWO: two.entries})
    shift = Pose2(0.2, 0.0, 0.0)
    solution = {ONE: solve_alone(graph, ONE).anchors}
    first = truth.T_starts @ shift
    for T_one_two, metres in ((truth.T_starts, 0.0), (first, 0.2)):
        assert abs(truth.of_transform(T_one_two).metres - metres) < 1e-9
        lone = solve_alone(graph, TWO).anchors
        solution[TWO] = np.array(
            [(T_one_two @ Pose2.from_array(anchor)).to_array() for anchor in lone]
        )
        errors = truth.errors(graph, solution)
        assert abs(errors.metres - metres) < 0.04 and errors.radians < 0.01
        assert abs(errors.starts_m - metres) < 1e-9


@pytest.mark.parametrize(
    ("aligned", "errors", "outcome"),
    [
        (False, None, "undecided"),
        (True, None, "false"),
        (True, Errors(0.04, 0.01, 0.1), "right"),
        (True, Errors(0.06, 0.01, 0.1), "imprecise"),
        (True, Errors(0.01, 0.03, 0.1), "imprecise"),
        (True, Errors(0.6, 0.0, 0.6), "false"),
        (True, Errors(0.0, math.pi, 0.0), "false"),
    ],
)
def test_outcomes(aligned: bool, errors: Errors | None, outcome: str) -> None:
    assert outcome_of(aligned, errors) == outcome


def test_only_the_hall_tells_rows_of_rooms_apart() -> None:
    def at(x: float, world: str) -> LoneJournal:
        return LoneJournal(world, 0, (), np.array([[x, 5.0, 0.0]]))

    rows = "rows:seed=5"
    assert is_told_apart(at(2.0, rows), at(3.0, rows), 0.1)
    assert not is_told_apart(at(2.0, rows), at(20.0, rows), 0.9)
    assert not is_told_apart(at(2.0, "symmetric:seed=5"), at(3.0, "symmetric:seed=5"), 1.0)
    assert is_told_apart(at(2.0, "office"), at(20.0, "office"), 0.0)


def test_the_usual_method_finds_a_map_in_itself() -> None:
    grid = load_map("office")
    turned = OccupancyGrid(np.ascontiguousarray(np.rot90(grid.cells)), grid.resolution, 3.0, -2.0)
    for detector in DETECTORS:
        found = merge_by_features(grid, turned, detector)
        assert found is not None and found.accepted
        # The lower left corner of the turned picture is the lower right one before.
        width = grid.cells.shape[1] * grid.resolution
        corner = found.T_a_b.apply(np.array([[3.0, -2.0]]))[0]
        assert abs(abs(found.T_a_b.theta) - math.pi / 2) < 0.02
        sides = (
            [grid.origin_x, grid.origin_y + grid.cells.shape[0] * grid.resolution],
            [grid.origin_x + width, grid.origin_y],
        )
        assert min(float(np.hypot(*(corner - side))) for side in sides) < 0.3
    empty = OccupancyGrid(np.full((50, 50), -1, dtype=np.int8), 0.05, 0.0, 0.0)
    assert merge_by_features(grid, empty, "orb") is None


@pytest.mark.parametrize("number", [0, 1])
def test_false_matches_do_not_corrupt_a_map(
    journals: tuple[LoneJournal, LoneJournal], number: int
) -> None:
    stage = false_matches.Stage(*journals)
    trial = false_matches.run_trial(number, stage, 3, bool(number))
    assert trial.grouped == bool(number)
    assert trial.false == 4 * trial.true > 0
    assert trial.outcome in ("right", "undecided")
    assert trial.false_counted == 0
    assert "0 of" in false_matches.table([trial])
