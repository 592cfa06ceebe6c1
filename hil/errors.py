"""What can go wrong on the bench, drawn in one file.

BenchError                 base: one line that names what is wrong, where, and what would be right
|-- UnusableInputError          exit status 2: the input cannot be used
|   |-- RequestError           parts of a request that do not go together, or a choice that there is not
|   |-- MachineFileError       carm.toml: drives.roll.rated_current_A = -3.0: must be positive
|   |-- RecordingError         a CSV with a hole, an unknown unit, a recording without metadata
|   |-- ExperimentError        a jog off the grid, an excitation that would saturate, a pose outside the limits
|   `-- IdentificationError    an input that is not excited, periods that do not match, more unknowns than lines
|-- NothingRunsError            exit status 3: nothing ran that could be stopped
`-- BadAnswerError              exit status 1: it ran and the answer is bad (a limit tripped, a check failed)
    `-- LoopAbortedError            the sample loop stopped the motors: overrun, lost device, limit, hold-to-run released
"""

from __future__ import annotations

import re
from collections.abc import Callable

TRACEBACK_VARIABLE = "ISOCENTER_TRACEBACK"
"""Environment variable that shows the traceback of an error."""
INTERRUPTED = "interrupted"
"""What is said of a Ctrl-C."""


class BenchError(Exception):
    """Base of every error the bench raises on purpose."""

    exit_status = 1


class UnusableInputError(BenchError, ValueError):
    """The input cannot be used; nothing was run."""

    exit_status = 2


class RequestError(UnusableInputError):
    """A request that cannot be met as it is put: parts of it do not go together, or it asks for a choice that there is not.

    In its text `{name}` stands for a part of the request, and `{}` for each of `values` in turn, which are told as they are. In Python a
    part is called by its name; a command calls it as its option.
    """

    def __init__(self, text: str, *values: object) -> None:
        super().__init__(text, *values)

    def __str__(self) -> str:
        """Return the text with every part by its name."""
        return self.calling(str)

    def calling(self, part: Callable[[str], str]) -> str:
        """Return the text with every part as `part` calls it."""
        text, *values = self.args
        left = iter(values)
        return re.sub(r"\{(\w*)\}", lambda found: part(found[1]) if found[1] else str(next(left)), text)


class MachineFileError(UnusableInputError):
    """A machine or effects file that is wrong: file, key, value and what would be right."""


class RecordingError(UnusableInputError):
    """A recording that cannot be read or does not hold what the command needs."""


class ExperimentError(UnusableInputError):
    """An experiment that must not or cannot be run on this machine."""


class IdentificationError(UnusableInputError):
    """Data or settings that do not allow the requested estimate.

    Raised, for example, for an input that is not excited, records whose periods do not match, or a local model with more unknowns than
    lines.
    """


class NothingRunsError(BenchError):
    """There is nothing to stop."""

    exit_status = 3


class BadAnswerError(BenchError):
    """The command ran to its end and its answer is bad."""


class LoopAbortedError(BadAnswerError):
    """The sample loop stopped the motors before the experiment was over; what was recorded is kept."""


def in_one_line(error: Exception) -> tuple[str, int]:
    """Return what a command says of an error that ended it, and its exit status: 1 a bad answer, 2 unusable input."""
    from controllers.errors import ControlError
    from drivers.errors import KEEP_AWAY, DriverError
    from virtual_bus.errors import EmulatorError

    if isinstance(error, BenchError | DriverError | EmulatorError | ControlError):
        line, status = "; ".join([str(error), *getattr(error, "__notes__", ())]), error.exit_status
    elif isinstance(error, OSError):
        line, status = f"{f'{error.filename}: ' if error.filename else ''}{error.strerror or error}", 2
    else:
        line, status = f"a fault of isocenter itself: {error!r}; {TRACEBACK_VARIABLE}=1 shows where", 1
    if KEEP_AWAY in line:  # stands first, whatever the line tells besides
        line = f"{KEEP_AWAY}: {line.replace(f'{KEEP_AWAY}: ', '')}"
    return " ".join(line.split("\n")), status
