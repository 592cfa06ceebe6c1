"""Archives of arrays are either whole or not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import answer_or_refusal

from hil.errors import UnusableInputError
from hil.files.arrays import read_arrays, write_arrays


def test_what_was_written_is_read_again(tmp_path: Path) -> None:
    values = np.arange(6.0).reshape(2, 3)
    write_arrays(tmp_path / "a.npz", {"format": 1, "names": ("propeller", "roll"), "values": values})
    read = read_arrays(tmp_path / "a.npz", "an archive")
    assert int(read["format"]) == 1
    assert list(read["names"]) == ["propeller", "roll"]
    np.testing.assert_array_equal(read["values"], values)


def test_a_full_disk_leaves_what_was_there_and_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.npz"
    write_arrays(path, {"values": np.zeros(3)})

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(UnusableInputError, match=r"a\.npz: cannot be written: No space left on device"):
        write_arrays(path, {"values": np.ones(3)})
    np.testing.assert_array_equal(read_arrays(path, "an archive")["values"], np.zeros(3))
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.parametrize("content", [b"", b"hello\n", b"PK\x03\x04 the beginning of an archive"])
def test_what_is_no_archive_is_said_in_our_words(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(UnusableInputError, match=r"a\.npz: not an archive: no whole archive of NumPy arrays \(\.npz\)$"):
        read_arrays(path, "an archive")


def test_an_archive_that_has_changed_is_read_as_it_was_or_said_to_be_none(tmp_path: Path) -> None:
    path, generator = tmp_path / "a.npz", np.random.default_rng(1)
    write_arrays(path, {"values": np.arange(4.0), "names": ("propeller", "roll")})
    whole = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    for at in range(0, len(whole), 3):
        changed = whole.copy()
        changed[at] ^= generator.integers(1, 256, dtype=np.uint8)
        path.write_bytes(changed.tobytes())
        _, refusal = answer_or_refusal(UnusableInputError, read_arrays, path, "an archive")
        assert refusal is None or refusal.startswith(f"{path}: not an archive")
