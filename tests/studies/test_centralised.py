"""A team that has told each other everything knows what one batch over all its data says."""

from pathlib import Path

import numpy as np
import pytest

from protocol.pose import Pose2
from robot.slam.engine import Anchor, Closure
from robot.slam.graph import UNTIED
from robot.team.entries import Hello
from robot.team.journal import LogName
from robot.team.log_graph import LogGraph
from studies.centralised import close_all, compare, kept, line, summary
from world.scenario import GateConfig, RobotSpec, Scenario

SCENARIO = Scenario(
    map="rooms-small",
    seed=3,
    robots=(RobotSpec(name="r1"), RobotSpec(name="r2")),
    radio=GateConfig(range_m=100.0),
    max_sim_s=15.0,
)


def test_a_team_in_contact_is_as_good_as_the_batch(tmp_path: Path) -> None:
    row = compare(SCENARIO)
    assert (row["robots"], row["aligned"], row["frames"]) == (2, 2, 1)
    assert row["keyframes"] > 10
    assert row["team_error_m"] == pytest.approx(row["centralised_error_m"], rel=0.1, abs=1e-3)
    path = tmp_path / "row.json"
    path.write_text('{"seed": 7}')
    assert kept(SCENARIO, path) == {"seed": 7}  # what is there is not played again
    assert "2 of 2 aligned" in line(row)


def test_the_summary_tells_the_mean_with_its_error() -> None:
    rows: list[dict[str, float | None]] = [
        {"team_error_m": 0.0102, "centralised_error_m": 0.01},
        {"team_error_m": 0.0098, "centralised_error_m": 0.01},
        {"team_error_m": None, "centralised_error_m": None},
    ]
    said = summary(rows)
    assert "2 runs: mean ratio 1.0000 ± 0.0200, greatest 1.0200" in said
    assert summary(rows[:1]) == "too few runs for a mean"


def test_the_batch_has_every_closure_once() -> None:
    """Of those of a pair the journal has the first; what holds the anchor after a step into another
    submap is a closure in the journal, and no more than a step to the robot."""
    log, apart = LogGraph(), Pose2(1.0, 0.0, 0.0)
    name = LogName("r1", 0)
    log.add(name, Hello(None, 5, -1.0, 0.5, 12.0, 0.2))
    for index, information in enumerate((np.eye(3), np.eye(3), np.eye(3), UNTIED)):
        log.add(name, Anchor(index, apart, information))
    log.add(name, Closure(0, 3, apart, np.eye(3)))
    log.add(name, Closure(0, 2, apart, np.eye(3)))
    edges = np.array([(0, 1), (1, 2), (0, 3), (0, 2), (0, 2), (1, 2)], dtype=np.int32)
    values = [[1.0, 0.0, 0.0, 4.0, 1.0, 0.5, 3.0, 0.25, float(n)] for n in range(len(edges))]
    close_all(log, edges, np.array(values))
    assert [tuple(row[:2]) for row in log.loops.values] == [(0, 3), (0, 2), (0, 2), (1, 2)]
    assert [row[-1] for row in log.loops.values] == [2.0, 3.0, 4.0, 5.0]
    full = log.loops.values[0, 5:].reshape(3, 3)
    np.testing.assert_array_equal(full, [[4.0, 1.0, 0.5], [1.0, 3.0, 0.25], [0.5, 0.25, 2.0]])
