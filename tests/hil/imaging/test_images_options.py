"""Where a run's images come from is known, and fits, before anything moves."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from commands import isocenter

from hil.emulated.card import EmulatorCard, published


def refused(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: Path | str) -> str:
    """The one line that a run with these options is refused with."""
    assert isocenter("run", "static", "-m", "carm", "--seconds", "0.5", "-o", folder / "r.mf4", *arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["-b", "lockstep:", "--spool", "."], "--spool: on lockstep: the emulated panel has its own; leave it out"),
        (["-b", "lockstep:", "--image-rate", "-1"], "--image-rate -1: must be a positive number below 125"),
        (["-b", "lockstep:", "--images", "taken"], "taken: holds a scan's frames.tif already; receive into another folder"),
        (["-b", "lockstep:", "--panel", "tcp:127.0.0.1:1"], "--panel: on lockstep: the emulated panel has its own; leave it out"),
        (["-b", "udp:239.74.163.99"], "--images: nobody says where the panel of udp:239.74.163.99 is"),
        (["-b", "udp:", "--panel", "tcp:127.0.0.1:1", "--spool", "."], "--spool and --panel: frames come from one of them"),
        (["-b", "udp:", "--panel", "tcp:127.0.0.1:1", "--scene", "nothing"], "scene nothing: there are dodecahedron, "),
        (["-b", "udp:", "--panel", "there"], "panel there: its address reads tcp:HOST:PORT"),
    ],
)
def test_nobody_moves_before_it_is_known_where_frames_come_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], line: str
) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "frames.tif").write_bytes(b"an earlier scan's")
    arguments = [tmp_path / each if each == "taken" else each for each in arguments]
    assert line in refused(tmp_path, capsys, "--images", tmp_path / "s", *arguments)
    assert [each.name for each in tmp_path.iterdir()] == ["taken"]


def test_a_bare_device_has_no_panel(capsys: pytest.CaptureFixture[str]) -> None:
    assert isocenter("emulate", "--eds", "device.eds", "--bus", "udp:239.74.163.99", "--panel", "dodecahedron") == 2
    assert "--panel: is a machine's; leave it out with --eds" in capsys.readouterr().err


@pytest.mark.parametrize(("option", "value"), [("--panel", "tcp:127.0.0.1:1"), ("--spool", ".")])
def test_where_images_come_from_is_not_said_for_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str
) -> None:
    line = f"{option}: says where images come from; give --images DIR as well"
    assert line in refused(tmp_path, capsys, "-b", "udp:239.74.163.99", option, value)


def test_a_panel_that_shows_something_else_than_the_run_says_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    bus = "udp:239.74.163.99"
    with published(EmulatorCard(bus, os.getpid(), "", "", "tcp:127.0.0.1:1", "clinical")):
        said = refused(tmp_path, capsys, "-b", bus, "--images", tmp_path / "s")
    assert f"--scene dodecahedron: the panel that is emulated on {bus} shows clinical; give that one" in said
