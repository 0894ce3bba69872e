from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.journal_file import JournalFile, JournalFileError, journal_path, read_records

RECORDS = st.lists(st.binary(max_size=60), max_size=8)


@given(RECORDS)
def test_records_are_read_as_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, records: list[bytes]
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    with JournalFile(folder, "r1") as journal:
        for record in records:
            journal.append([record])
        assert read_records(journal_path(folder, "r1", 0)) == records


@given(RECORDS, st.integers(0, 600))
def test_a_torn_tail_costs_at_most_the_records_it_tears(
    tmp_path_factory: pytest.TempPathFactory, records: list[bytes], size: int
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    with JournalFile(folder, "r1") as journal:
        journal.append(records)
    path = journal_path(folder, "r1", 0)
    data = path.read_bytes()[:size]
    path.write_bytes(data)
    whole = read_records(path)
    assert whole == records[: len(whole)]
    assert len(data) - sum(8 + len(record) for record in whole) < 8 + 60


@given(st.integers(0, 2), st.integers(0, 40), st.integers(1, 255))
def test_reading_stops_at_damage(
    tmp_path_factory: pytest.TempPathFactory, record: int, offset: int, flip: int
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    records = [bytes([n]) * 40 for n in range(3)]
    with JournalFile(folder, "r1") as journal:
        journal.append(records)
    path = journal_path(folder, "r1", 0)
    data = bytearray(path.read_bytes())
    data[record * 48 + offset] ^= flip
    path.write_bytes(data)
    assert read_records(path) == records[:record]


def test_every_start_is_an_incarnation_of_its_own(tmp_path: Path) -> None:
    for expected in range(3):
        with JournalFile(tmp_path, "r1") as journal:
            assert journal.incarnation == expected
    with JournalFile(tmp_path, "r2") as journal:
        assert journal.incarnation == 0


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(JournalFileError, match="file/journals"):
        JournalFile(tmp_path / "file" / "journals", "r1")
