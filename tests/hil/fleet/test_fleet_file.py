"""A fleet's file is read whole or refused with one line that names the place and what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil import UnusableInputError, read_fleet
from hil.fleet.listing import night_of

TEXT = """
format = 1
[every]
file = "carm"
recordings = "recordings/{name}"
repeats = ["scan_*"]
[limits.diagnose]
time_s = 60.0
[[machine]]
name = "room_1"
[[machine]]
name = "room_2"
recordings = "s3://bucket/second"
tasks = ["check", "diagnose"]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "fleet.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_every_machine_has_is_said_once(tmp_path: Path) -> None:
    fleet = read_fleet(written(tmp_path, TEXT))
    first, second = fleet.machines
    assert (first.file, first.recordings, first.tasks) == ("carm", str(tmp_path / "recordings/room_1"), ("check",))
    assert (second.recordings, second.repeats, second.tasks) == ("s3://bucket/second", ("scan_*",), ("check", "diagnose"))
    assert fleet.needs["diagnose"].time_s == 60.0
    assert fleet.store == tmp_path / "fleet-results"


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("format = 1", "format = 2", "format = 2: must be 1"),
        ('name = "room_2"', 'name = "room_1"', 'machine.room_1.name = "room_1": is the name of an earlier machine'),
        ('name = "room_2"', 'name = "../2"', "must be letters, digits"),
        ('"check", "diagnose"', '"chek"', "tasks"),
        ("repeats =", "repeat =", "did you mean repeats?"),
        ('file = "carm"', "", "needs `file`, here or in [every]"),
        ('repeats = ["scan_*"]', "", 'has the task "diagnose", so it needs `repeats`'),
        ("time_s = 60.0", "time_s = -1.0", "limits.diagnose.time_s = -1.0: must be positive"),
        ("format = 1", "format = = 1", "no valid TOML"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path: Path, old: str, new: str, line: str) -> None:
    path = written(tmp_path, TEXT.replace(old, new))
    with pytest.raises(UnusableInputError) as refused:
        read_fleet(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert line in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "night"),
    [
        ("2026-11-27/scan_1.mf4", "2026-11-27T00:00:00+00:00"),
        ("nightly/20261127T021530Z_scan.mf4", "2026-11-27T02:15:30+00:00"),
        ("batch_12345678901/2026-11-27 02:15/scan.mf4", "2026-11-27T02:15:00+00:00"),
        ("2026-13-27/scan.mf4", None),
        ("scan.mf4", None),
    ],
)
def test_a_recording_is_of_the_first_date_in_its_path(name: str, night: str | None) -> None:
    found = night_of(name)
    assert (None if found is None else found.isoformat()) == night
