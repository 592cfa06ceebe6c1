"""When a fault begins: a comparison of one of the machine's quantities with a number, or a state in words.

abs(speed_roll) > 0.3        a quantity of the emulated machine, in SI
moving                       a state of any axis
moving roll                  of this axis
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Protocol

from virtual_bus.errors import FaultError

STATES = {
    "moving": "faster than 0.05 rad/s (m/s)",
    "settled": "enabled, its brake open and slower than 0.001 rad/s (m/s) for one second",
    "operational": "its drive is NMT operational",
    "homing": "its drive displays the homing mode",
    "enabled": "its drive is in operation enabled",
    "stopping": "its drive is in quick stop or fault reaction",
    "brakes open": "its brake is open",
    "brakes closed": "its brake is closed",
    "recording": "rows are being recorded (on lockstep: alone)",
}
"""States that a condition may name, of the axis that follows or of any."""

MOVING_SPEED = 0.05
"""rad/s or m/s: faster than a push of commissioning moves an axis, slower than a scan."""
STILL_SPEED = 1e-3
"""rad/s or m/s: some counts of an encoder per sample; structures still ring below it."""
SETTLED_S = 1.0
"""The slowest structural modes die out within it."""

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le, ">=": operator.ge, "==": operator.eq, "!=": operator.ne, "<": operator.lt, ">": operator.gt,
}  # fmt: skip
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_PATTERN = re.compile(rf"(?P<abs>abs\()?\s*(?P<name>[A-Za-z_]\w*)\s*(?P<end>\))?\s*(?P<how><=|>=|==|!=|<|>)\s*(?P<number>{_NUMBER})")


class Facts(Protocol):
    """An emulated machine as conditions see it."""

    def quantity(self, name: str) -> float:
        """Return a quantity in SI."""

    def is_in(self, state: str, axis: str) -> bool:
        """Return whether an axis is in a state, any where `axis` is ""."""


@dataclass(frozen=True)
class Comparison:
    """A quantity against a number. A quantity that is not known (NaN) fulfils nothing."""

    name: str
    magnitude: bool
    how: str
    number: float

    def holds(self, facts: Facts) -> bool:
        """Return whether it does."""
        value = facts.quantity(self.name)
        return not math.isnan(value) and _COMPARISONS[self.how](abs(value) if self.magnitude else value, self.number)

    def __str__(self) -> str:
        """Return it as a file writes it."""
        return f"{f'abs({self.name})' if self.magnitude else self.name} {self.how} {self.number!r}"


@dataclass(frozen=True)
class InState:
    """A state of an axis, or of any."""

    state: str
    axis: str = ""

    def holds(self, facts: Facts) -> bool:
        """Return whether it does."""
        return facts.is_in(self.state, self.axis)

    def __str__(self) -> str:
        """Return it as a file writes it."""
        return f"{self.state} {self.axis}".rstrip()


Condition = Comparison | InState


def parse_condition(text: str, quantities: Collection[str], axes: Collection[str]) -> Condition:
    """Read a condition.

    Parameters
    ----------
    text : str
    quantities : collection of str
        Names of the machine's quantities.
    axes : collection of str

    Raises
    ------
    FaultError
        Neither a comparison of a known quantity nor a known state; the message says what would be right.
    """
    stripped = " ".join(text.split())
    for state in STATES:
        if stripped == state:
            return InState(state)
        if stripped.startswith(f"{state} "):
            axis = stripped.removeprefix(f"{state} ")
            if axis in axes:
                return InState(state, axis)
            raise FaultError(f"when = {text!r}: no axis {axis!r}; there is {', '.join(axes)}")
    found = _PATTERN.fullmatch(stripped)
    if found is None or bool(found["abs"]) != bool(found["end"]):
        raise FaultError(
            f"when = {text!r}: must be a comparison such as abs(speed_{next(iter(axes), 'AXIS')}) > 0.3, or one of {', '.join(STATES)}"
        )
    number = float(found["number"])
    if not math.isfinite(number):
        raise FaultError(f"when = {text!r}: {found['number']} is no finite number")
    if found["name"] not in quantities:
        raise FaultError(f"when = {text!r}: no quantity {found['name']!r}; there is {', '.join(sorted(quantities))}")
    return Comparison(found["name"], bool(found["abs"]), found["how"], number)
