"""Controllers that a machine's check fails are not run, unless this is accepted."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import lru_cache

from hil.errors import UnusableInputError
from hil.machine import Machine
from hil.machine.check import failing_controllers

KEPT = 8
"""Machines whose findings a process keeps."""


def accepted_margins(machine: Machine, accept: bool, how: str) -> tuple[str, ...]:
    """Return what `machine check` finds failing of the controllers, in words, where it is accepted.

    Parameters
    ----------
    machine : Machine
    accept : bool
    how : str
        How to accept it, for the message.

    Raises
    ------
    UnusableInputError
        Something fails and was not accepted.
    """
    failing = _failing(pickle.dumps(replace(machine, text="", hash="", path=None)))
    if failing and not accept:
        raise UnusableInputError(
            f"{machine.name}: `isocenter machine check` fails its controller, so it is not run: {'; '.join(failing)}."
            f" Correct [controller], or accept this with {how}"
        )
    return failing


@lru_cache(maxsize=KEPT)
def _failing(pickled: bytes) -> tuple[str, ...]:
    """Return what fails of a machine's controllers, in words.

    Linearising it in all poses takes a good part of a second, and a process that runs several experiments asks before each.
    """
    return tuple(finding.text for finding in failing_controllers(pickle.loads(pickled)))
