"""Cards of emulators on this host: anything that is not one is none, and never an error."""

from __future__ import annotations

import json
import os
import stat
from dataclasses import asdict
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hil.emulated.card import EmulatorCard, card_from_text, find, published
from hil.errors import UnusableInputError

LARGEST_PID = 2**31 - 1  # pid_t has 32 bits and a sign
cards = st.builds(EmulatorCard, **{name: st.text() for name in EmulatorCard.__annotations__} | {"pid": st.integers(1, LARGEST_PID)})
WHOLE = asdict(EmulatorCard("b", os.getpid(), "", ""))
names = st.sampled_from(list(EmulatorCard.__annotations__))
documents = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text() | names, inner, max_size=5),
    max_leaves=12,
)


@given(cards)
def test_a_card_is_read_as_it_was_written(card: EmulatorCard) -> None:
    assert card_from_text(json.dumps(asdict(card))) == card


@given(st.text() | documents.map(json.dumps))
@example('{"bus": 1')
@example("[" * 100_000)
@example(json.dumps(WHOLE | {"pid": 0}))
@example(json.dumps(WHOLE | {"pid": True}))
@example(json.dumps(WHOLE | {"pid": LARGEST_PID + 1}))
@example(json.dumps(WHOLE | {"pid": 10**30}))
@example(json.dumps(WHOLE | {"imu_device": 5}))
def test_any_other_text_is_no_card_or_a_whole_one(text: str) -> None:
    card = card_from_text(text)
    if card is not None:
        assert asdict(card) == json.loads(text)
        assert 0 < card.pid <= LARGEST_PID


@given(cards, names, st.none() | st.floats() | st.lists(st.text(), max_size=1))
def test_a_card_with_one_entry_of_another_kind_is_none(card: EmulatorCard, name: str, value: object) -> None:
    assert card_from_text(json.dumps(asdict(card) | {name: value})) is None
    assert card_from_text(json.dumps({key: entry for key, entry in asdict(card).items() if key != name})) is None


# ---- whom a card is believed -----------------------------------------------------------------------------

CARD = EmulatorCard("udp:", os.getpid(), "tcp:127.0.0.1:1", "tcp:127.0.0.1:2")
only_posix = pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners and modes are POSIX's")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where this user's cards lie."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / f"isocenter-{os.getuid()}"


def published_file(folder: Path) -> Path:
    (path,) = folder.iterdir()
    return path


@only_posix
def test_a_card_and_its_folder_are_the_users_alone_whatever_the_umask(folder: Path) -> None:
    before = os.umask(0)
    try:
        with published(CARD):
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
            assert stat.S_IMODE(published_file(folder).stat().st_mode) == 0o600
            assert find("udp:") == CARD
    finally:
        os.umask(before)
    assert find("udp:") is None


def refused(words: str) -> None:
    with pytest.raises(UnusableInputError, match=words) as caught:
        find("udp:")
    assert "\n" not in str(caught.value)


@only_posix
def test_a_card_or_folder_that_others_can_write_to_is_refused(folder: Path) -> None:
    with published(CARD):
        published_file(folder).chmod(0o620)
        refused(r"\.json: can be written by others \(mode 620\), so .* not believed; remove it")
        published_file(folder).chmod(0o600)
        folder.chmod(0o777)
        refused(r"can be written by others \(mode 777\)")
    with pytest.raises(UnusableInputError, match="mode 777"), published(CARD):
        pytest.fail("published in a folder of everybody's")


@only_posix
def test_a_link_in_place_of_a_card_or_folder_is_refused(folder: Path, tmp_path: Path) -> None:
    with published(CARD):
        path = published_file(folder)
        elsewhere = path.rename(tmp_path / "elsewhere")
        path.symlink_to(elsewhere)
        refused("is a link or no file")
    folder.rename(tmp_path / "moved")
    folder.symlink_to(tmp_path / "moved")
    with pytest.raises(UnusableInputError, match="is a link or no folder"), published(CARD):
        pytest.fail("published through a link")


@only_posix
def test_a_card_or_folder_of_another_user_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with published(CARD):
        for module in ("hil.processes.private_folder", "hil.emulated.card"):
            monkeypatch.setattr(f"{module}.private_folder", lambda: folder)  # its name holds the user's number
        mine = os.getuid()
        monkeypatch.setattr(os, "getuid", lambda: mine + 1)
        refused(rf"belongs to user {mine}, not to you \({mine + 1}\)")
        with pytest.raises(UnusableInputError, match="belongs to user"), published(CARD):
            pytest.fail("published in another user's folder")


@only_posix
def test_a_pipe_or_a_mountain_in_place_of_a_card_is_no_card(folder: Path) -> None:
    with published(CARD):
        path = published_file(folder)
        path.write_bytes(b" " * 10_000_000 + json.dumps(asdict(CARD)).encode())
        assert find("udp:") is None
        path.unlink()
        os.mkfifo(path, 0o600)
        refused("is a link or no file")
