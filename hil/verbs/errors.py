"""At the front door every error is one of `hil.errors`, whichever floor it comes from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from controllers.errors import ControlError
from drivers.errors import DriverError
from hil.errors import BadAnswerError, BenchError, LoopAbortedError, UnusableInputError
from virtual_bus.errors import EmulatorError

REFUSED = 2
"""Exit status by which an error says that nothing was run."""


@contextmanager
def as_bench_errors() -> Iterator[None]:
    """Raise errors of drivers, controllers and emulator as what they are for a user, with the same line; also decorates a function.

    Raises
    ------
    UnusableInputError
        The input cannot be used; nothing was run.
    LoopAbortedError
        A driver stopped the motors.
    BadAnswerError
        It ran and the answer is bad.
    """
    try:
        yield
    except (DriverError, ControlError, EmulatorError) as error:
        if error.exit_status == REFUSED:
            told: BenchError = UnusableInputError(str(error))
        else:
            told = LoopAbortedError(str(error)) if isinstance(error, DriverError) else BadAnswerError(str(error))
        for note in getattr(error, "__notes__", ()):
            told.add_note(note)
        raise told.with_traceback(error.__traceback__) from None
