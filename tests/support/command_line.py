"""Running `isocenter` in this process, as its user would see it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from hil.cli import main


@dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    status: int
    out: str
    err: str

    @property
    def line(self) -> str:
        """The one line of an error: there must be no other, and it must not be a traceback."""
        lines = [line for line in self.err.splitlines() if not line.startswith("... ")]  # progress of a slow computer aside
        assert len(lines) == 1, self.err
        assert lines[0].startswith("isocenter: "), self.err
        assert "Traceback" not in self.err
        assert "fault of isocenter itself" not in self.err
        assert len(lines[0]) > 20  # it says something
        return lines[0]


Isocenter = Callable[..., Outcome]


def runner(capsys: pytest.CaptureFixture[str]) -> Isocenter:
    """A function that runs `isocenter ARGUMENTS...`."""

    def isocenter(*arguments: object) -> Outcome:
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        status = left.value.code
        assert isinstance(status, int)
        return Outcome(status, captured.out, captured.err)

    return isocenter
