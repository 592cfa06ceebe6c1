"""Recordings are found wherever they lie, dated, and known by what is in them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from hil.errors import UnusableInputError
from hil.fleet.listing import KnownHashes, list_recordings

fsspec = pytest.importorskip("fsspec")


def test_a_folder_of_any_storage_is_listed(tmp_path: Path) -> None:
    storage = fsspec.filesystem("memory")
    for name in ("2026-11-27/a.csv", "2026-11-27/a.toml", "2026-11-27/.hidden.csv", "2026-11-27/notes.txt", "b.mf4"):
        storage.pipe(f"/hospital/room/{name}", name.encode())
    [found], wrong = list_recordings("memory://hospital/room", KnownHashes(tmp_path))
    assert (found.file.name, found.file.url) == ("2026-11-27/a.csv", "memory:///hospital/room/2026-11-27/a.csv")
    assert found.hashes == tuple(hashlib.sha256(f"2026-11-27/a.{suffix}".encode()).hexdigest() for suffix in ("csv", "toml"))
    assert "b.mf4: its path has no date" in wrong[0]
    storage.rm("/hospital", recursive=True)


def test_images_go_with_the_recording_whose_name_their_folder_has(tmp_path: Path) -> None:
    night = tmp_path / "2026-11-27"
    (night / "spin").mkdir(parents=True)
    for name in ("spin.mf4", "spin/scan.toml", "spin/frames.tif", "spin/exposures.csv"):
        (night / name).write_text(name, encoding="utf-8")
    [found], wrong = list_recordings(str(tmp_path), KnownHashes(tmp_path / "store"), images=True)
    assert [one.name for one in found.images] == [f"2026-11-27/spin/{name}" for name in ("exposures.csv", "frames.tif", "scan.toml")]
    assert wrong == []
    (night / "spin.mf4").rename(night / "other.mf4")
    [found], wrong = list_recordings(str(tmp_path), KnownHashes(tmp_path / "store"), images=True)
    assert (found.images, len(wrong)) == ((), 1)
    assert "2026-11-27/spin: images of no recording; 2026-11-27/spin.mf4 beside them would be right" in wrong[0]


def test_a_file_is_read_once_and_again_when_it_was_changed(tmp_path: Path) -> None:
    recording, store = tmp_path / "recordings/2026-11-27/a.mf4", tmp_path / "store"
    recording.parent.mkdir(parents=True)

    def hashes(content: bytes | None) -> tuple[str, ...]:
        if content is not None:
            recording.write_bytes(content)
        known = KnownHashes(store)
        [found], _ = list_recordings(str(tmp_path / "recordings"), known)
        known.keep()
        return found.hashes

    first = hashes(b"first")
    assert len(list((store / "hashes").iterdir())) == 1
    assert hashes(None) == first
    assert len(list((store / "hashes").iterdir())) == 1
    assert hashes(b"longer than the first") != first


def test_a_pattern_may_name_the_night(tmp_path: Path) -> None:
    night = tmp_path / "room/2026-11-27"
    night.mkdir(parents=True)
    (night / "a.mf4").write_bytes(b"a")
    [found], wrong = list_recordings(f"{tmp_path}/room/2026-11-27/*.mf4", KnownHashes(tmp_path / "store"))
    assert (found.file.name, found.night.day, wrong) == ("2026-11-27/a.mf4", 27, [])


@pytest.mark.parametrize(
    ("url", "line"), [("/no/such/folder", "there is no such folder"), ("nosuch://bucket/room", "cannot be listed: Protocol not known")]
)
def test_a_place_that_is_none_is_refused(tmp_path: Path, url: str, line: str) -> None:
    with pytest.raises(UnusableInputError, match=line):
        list_recordings(url, KnownHashes(tmp_path))
