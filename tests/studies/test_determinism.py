import pytest

from studies.determinism import Run, case, same, scenario_of


def test_one_hash_that_differs_is_found() -> None:
    first = Run("inline", "1", {"map": "a", "ledger": "b"})
    second = Run("memory", "77", {"map": "a", "ledger": "c"})
    assert same([first, first]) == {"ledger": True, "map": True}
    assert same([first, second]) == {"ledger": False, "map": True}


@pytest.mark.slow
def test_a_slice_of_the_study() -> None:
    row = case(scenario_of("loop", 1, 2, 15.0), ("inline", "processes"), ("1", "77"))
    assert row["equal"], row
    assert row["runs"] == 4
