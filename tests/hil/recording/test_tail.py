"""A journal read while it is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.errors import RecordingError
from hil.recording.journal import Journal
from hil.recording.tail import JournalTail

CHANNELS = [("time", "s"), ("position_roll", "rad")]


def rows_of(tail: JournalTail) -> np.ndarray:
    return np.concatenate([np.zeros((0, 2)), *(np.frombuffer(values, "<f8").reshape(count, 2) for count, values in tail.take())])


def test_every_row_comes_once_and_in_order(tmp_path: Path) -> None:
    part = tmp_path / "run.mf4.part"
    table = np.arange(20.0).reshape(10, 2)
    with Journal.create(part, CHANNELS, {"experiment": {"kind": "jog"}}) as journal:
        tail = JournalTail(part)
        assert tail.channels == CHANNELS
        assert tail.metadata["experiment"] == {"kind": "jog"}
        assert len(rows_of(tail)) == 0
        journal.append(table[:3])
        journal.append(table[3:4])
        assert rows_of(tail) == pytest.approx(table[:4])
        journal.append(table[4:])
        assert rows_of(tail) == pytest.approx(table[4:])
        assert len(rows_of(tail)) == 0
        assert tail.rows == 10
    tail.close()


def test_half_a_block_waits_for_the_rest(tmp_path: Path) -> None:
    part = tmp_path / "run.mf4.part"
    with Journal.create(part, CHANNELS, {}) as journal:
        before = part.stat().st_size
        journal.append(np.ones((3, 2)))
    whole = part.read_bytes()
    part.write_bytes(whole[: before + 20])
    tail = JournalTail(part)
    assert len(rows_of(tail)) == 0
    with part.open("r+b") as file:
        file.write(whole)
    assert len(rows_of(tail)) == 3
    tail.close()


def test_the_last_rows_are_read_after_the_journal_has_become_a_recording(tmp_path: Path) -> None:
    part = tmp_path / "run.mf4.part"
    with Journal.create(part, CHANNELS, {}) as journal:
        tail = JournalTail(part)
        assert not tail.ended
        journal.append(np.ones((5, 2)))
    part.unlink()
    assert tail.ended
    assert len(rows_of(tail)) == 5
    tail.close()


@pytest.mark.parametrize("content", [b"", b"ISOJRNL1", b"no journal"])
def test_what_is_no_journal_is_told(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.part"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"x\.part"):
        JournalTail(path)
