"""What was written comes back, whatever happened to the rest of the file."""

import logging
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.journal_file import (
    JournalFile,
    JournalFileError,
    Life,
    encode_life,
    journal_path,
    next_incarnation,
)
from robot.recollection import read_contents, read_records, recall

RECORDS = st.lists(st.binary(min_size=1, max_size=60), max_size=8)
LIFE = Life("r1", 0, "run")
FIRST_BYTES = 8 + len(encode_life(LIFE))


def write(folder: Path, records: list[bytes], life: Life = LIFE) -> Path:
    with JournalFile(folder, life) as journal:
        for record in records:
            journal.append([record])
    return journal_path(folder, life.robot, life.incarnation)


@given(RECORDS)
def test_records_are_read_as_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, records: list[bytes]
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    path = write(folder, records)
    assert read_records(path) == records
    assert recall(folder, "r1", "run") == records
    contents = read_contents(path)
    assert not contents.torn
    assert contents.damaged == ()


@given(RECORDS, st.integers(0, 600))
def test_a_torn_tail_costs_at_most_the_record_it_tears(
    tmp_path_factory: pytest.TempPathFactory, records: list[bytes], size: int
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    path = write(folder, records)
    data = path.read_bytes()[: FIRST_BYTES + size]
    path.write_bytes(data)
    whole = recall(folder, "r1", "run")
    assert whole == records[: len(whole)]
    kept = path.stat().st_size
    assert kept == FIRST_BYTES + sum(8 + len(record) for record in whole)
    assert len(data) - kept < 8 + 60
    assert not read_contents(path).torn


@given(st.integers(0, 4), st.integers(0, 47), st.integers(1, 255))
def test_a_damaged_record_is_passed_over_and_no_other(
    tmp_path_factory: pytest.TempPathFactory, damaged: int, offset: int, flip: int
) -> None:
    folder = tmp_path_factory.mktemp("journal")
    records = [bytes([65 + n]) * 40 for n in range(5)]
    path = write(folder, records)
    data = bytearray(path.read_bytes())
    begin = FIRST_BYTES + 48 * damaged
    data[begin + offset] ^= flip
    path.write_bytes(data)
    contents = read_contents(path)
    assert list(contents.records[1:]) == records[:damaged] + records[damaged + 1 :]
    if damaged < 4:
        assert contents.damaged == ((begin, begin + 48),)
    else:
        assert (contents.torn, contents.end) == (True, begin)


def test_what_is_lost_is_told_with_its_place(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path, [b"a" * 40, b"b" * 40, b"c" * 40])
    data = bytearray(path.read_bytes())
    data[FIRST_BYTES + 48 + 20] ^= 1
    path.write_bytes(data[:-5])
    with caplog.at_level(logging.WARNING):
        assert recall(tmp_path, "r1", "run") == [b"a" * 40]
    (torn,) = caplog.messages
    assert f"torn off at byte {FIRST_BYTES + 48} of {FIRST_BYTES + 3 * 48 - 5}" in torn
    path.write_bytes(data)
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        assert recall(tmp_path, "r1", "run") == [b"a" * 40, b"c" * 40]
    (damaged,) = caplog.messages
    assert f"bytes {FIRST_BYTES + 48} to {FIRST_BYTES + 2 * 48} are damaged" in damaged


def test_journals_of_others_are_told_and_passed_over(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write(tmp_path, [b"mine"])
    write(tmp_path, [b"of yesterday"], Life("r1", 1, "another run"))
    write(tmp_path, [b"theirs"], Life("r2", 0, "run")).rename(journal_path(tmp_path, "r1", 2))
    journal_path(tmp_path, "r1", 3).write_bytes(b"of another world")
    with caplog.at_level(logging.WARNING):
        assert recall(tmp_path, "r1", "run") == [b"mine"]
    for said in ("another run", "another robot, r2", "whose it is"):
        assert any(said in message for message in caplog.messages)
    assert journal_path(tmp_path, "r1", 3).read_bytes() == b"of another world"
    assert next_incarnation(tmp_path, "r1") == 4


def test_a_life_has_one_file(tmp_path: Path) -> None:
    write(tmp_path, [b"first"])
    with pytest.raises(JournalFileError, match="another r1"):
        JournalFile(tmp_path, LIFE)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(JournalFileError, match="file/journals"):
        JournalFile(tmp_path / "file" / "journals", LIFE)
