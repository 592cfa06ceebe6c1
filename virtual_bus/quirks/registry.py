"""The list of quirks, and an option's text made quirks of a machine's drives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache

from virtual_bus.errors import FaultError
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.quirks import network, sdo, states, units
from virtual_bus.quirks.quirk import Quirk, QuirkSetting


@cache
def quirks() -> dict[str, Quirk]:
    """Return every quirk by name, in the order of the files that declare them."""
    found = {quirk.name: quirk for module in (network, sdo, states, units) for quirk in module.QUIRKS}
    assert len(found) == sum(len(module.QUIRKS) for module in (network, sdo, states, units))
    return found


def parse_quirks(texts: Iterable[str], drives: Sequence[str]) -> tuple[QuirkSetting, ...]:
    """Read options DRIVE:NAME.

    Parameters
    ----------
    texts : iterable of str
    drives : sequence of str
        Names of the machine's drives.

    Raises
    ------
    FaultError
        Not of that form, no such drive, or no such quirk.
    """
    return tuple(_parse(text, drives) for text in texts)


def _parse(text: str, drives: Sequence[str]) -> QuirkSetting:
    drive, colon, name = text.partition(":")
    if not colon:
        raise FaultError(f"--quirk {text}: must be DRIVE:NAME, such as {drives[0] if drives else 'roll_drive'}:sdo_late")
    if drive not in drives:
        raise FaultError(f"--quirk {text}: no drive {drive!r}; there is {', '.join(drives)}")
    if name not in quirks():
        raise FaultError(f"--quirk {text}: no quirk {name!r}; `isocenter faults quirks` names all")
    return QuirkSetting(drive, name)


def put_on(machine: FaultyMachine, settings: Iterable[QuirkSetting]) -> None:
    """Put quirks on the drives of an emulated machine, before it is powered on."""
    for setting in settings:
        quirks()[setting.name].put_on(machine, machine.drives[setting.drive])
