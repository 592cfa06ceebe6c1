"""Controllers that a machine's check fails are not run, unless this is accepted."""

from __future__ import annotations

from hil.errors import UnusableInputError
from hil.machine import Machine
from hil.machine.check import failing_controllers


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
    failing = tuple(finding.text for finding in failing_controllers(machine))
    if failing and not accept:
        raise UnusableInputError(
            f"{machine.name}: `isocenter machine check` fails its controller, so it is not run: {'; '.join(failing)}."
            f" Correct [controller], or accept this with {how}"
        )
    return failing
