"""The fourth way to run: world and robots as hosts of their own on one network."""

import json
from pathlib import Path

import pytest

from station.hashes import run_hashes
from station.launch import launch
from studies.namespaces import NetworkError, network, run_on_hosts
from world.scenario import PaceConfig, RobotSpec, Scenario

SCENARIO = Scenario(
    map="rooms-small",
    seed=3,
    robots=(RobotSpec(name="r1"), RobotSpec(name="r2")),
    max_sim_s=12.0,
    pace=PaceConfig(deadline_s=60.0),
)


@pytest.fixture
def allowed() -> None:
    """Skip where network namespaces cannot be made."""
    try:
        with network(("probe",)) as addresses:
            assert set(addresses) == {"probe"}
    except NetworkError as error:
        pytest.skip(str(error))


@pytest.mark.usefixtures("allowed")
def test_on_hosts_of_their_own_the_run_is_the_same(tmp_path: Path) -> None:
    metrics = json.loads(run_on_hosts(SCENARIO, tmp_path).read_text())
    assert metrics["hashes"] == run_hashes(launch(SCENARIO, "inline"))
    assert metrics["messages_lost"] == 0


@pytest.mark.usefixtures("allowed")
def test_a_host_that_fails_is_quoted(tmp_path: Path) -> None:
    robots = (RobotSpec(name="r1", engine="no-such-engine"),)
    wrong = SCENARIO.model_copy(
        update={"robots": robots, "pace": PaceConfig(deadline_s=60.0, roster_s=10.0)}
    )
    with pytest.raises(NetworkError, match="no-such-engine"):
        run_on_hosts(wrong, tmp_path)
