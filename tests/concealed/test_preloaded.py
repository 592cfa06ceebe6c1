"""A command in a process forked from one that has its modules is the command."""

from __future__ import annotations

import subprocess

import pytest


@pytest.fixture
def by_itself():
    from concealed.making import COMMAND

    return lambda *arguments: subprocess.run([COMMAND, *arguments], capture_output=True, text=True, check=False)


def test_it_writes_the_same_file_as_the_command_by_itself(tmp_path, by_itself):
    from concealed.preloaded import isocenter

    ours, its = tmp_path / "ours.xml", tmp_path / "its.xml"
    assert isocenter("machine", "export", "carm", "--mjcf", str(ours)).exit_status == 0
    assert by_itself("machine", "export", "carm", "--mjcf", str(its)).returncode == 0
    assert ours.read_bytes() == its.read_bytes()


def test_it_refuses_in_the_same_words(tmp_path, by_itself):
    from concealed.preloaded import isocenter

    asked = ("diagnose", "carm", str(tmp_path / "missing.csv"), "-o", str(tmp_path / "out"))
    done, other = isocenter(*asked), by_itself(*asked)
    assert (done.exit_status, done.said) == (other.returncode, other.stderr)
    assert done.exit_status == 2 and "missing.csv" in done.said


def test_what_takes_longer_than_its_limit_has_no_exit_status():
    from concealed.preloaded import isocenter

    assert isocenter("machine", "export", "carm", limit_s=0.0).exit_status is None


def test_a_command_that_was_stopped_leaves_the_next_one_whole():
    from concealed.preloaded import isocenter

    isocenter("effects", limit_s=0.0)
    assert isocenter("effects").exit_status == 0
