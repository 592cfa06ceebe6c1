"""The reference of faults, from the registry of `virtual_bus.faults`."""

from __future__ import annotations

from collections.abc import Iterator

from docs.generate.markdown import block, code, number, sentence, table
from docs.generate.markdown import page as whole
from virtual_bus.faults.fault import PLACES, FaultKind, Parameter
from virtual_bus.faults.registry import fault_kinds, states

INTRODUCTION = """
A fault is something that goes wrong in the emulated machine at a time: a brake that stays open, a drive that does not
listen, a foreign node on the bus. This page lists every fault with its places and parameters. `emulate` and
`run --bus lockstep:` take a faults file with `--faults`; `isocenter faults list --json` prints this catalogue for
programs. How to use it is in [Try faults](../how-to/try-faults.md).
"""

EXAMPLE = """
format = 1

[[fault]]
name = "brake_stays_open"
at = "roll"
when = "settled roll"

[[fault]]
name = "hold_to_run_released"
when = "abs(speed_roll) > 0.3"
from_s = 0.2
for_s = 1.0
"""

FILE_TEXT = """
`format` is 1 and may be left out. A parameter's key ends in its unit; parameters that are left out have their default.

| key | meaning |
| --- | --- |
| `name` | a fault of this page |
| `at` | where it acts; may be left out where the machine has one such place |
| `when` | the condition that must have come once, see below; without it the machine's power-on counts |
| `from_s` | time between that instant and the fault [s], 0 unless given |
| `for_s` | how long the fault lasts [s]; for ever unless given |

Times are the emulated machine's, which moves by a sample period per SYNC. A condition is looked at once per sample. It
is a comparison (`<`, `<=`, `>`, `>=`, `==`, `!=`) of a quantity or its magnitude with a number in SI, such as
`abs(speed_roll) > 0.3`; or a state, of any axis or of the axis named behind it, such as `moving` or `moving roll`.
Quantities of an axis A are what truly is, not what is measured: `position_A`, `speed_A`, `link_position_A`, `command_A`
(the power stage's effort in the drive's unit), `temperature_A` [degC] and `statusword_A`; `time` is the machine's.
"""

RANDOM_TEXT = """
What is random in a fault is drawn from the run's `--seed`, so that runs on `lockstep:` repeat bit for bit. A faults file
without `[[fault]]` changes nothing.
"""


def page() -> str:
    """Write the page."""
    kinds = list(fault_kinds().values())
    parts = [INTRODUCTION, "## Faults file", block(EXAMPLE, "toml"), FILE_TEXT]
    parts += [table(("state", "an axis is in it while"), ((code(name), meaning) for name, meaning in states().items())), RANDOM_TEXT]
    parts += ["## Places", table(("place", "`at` is"), ((code(place), meaning) for place, meaning in PLACES.items()))]
    for group in dict.fromkeys(kind.group for kind in kinds):
        parts.append(f"## Class: {group}")
        parts.append(table(("fault", "at", "does", "parameters"), _rows([kind for kind in kinds if kind.group == group])))
    return whole("Faults", *parts)


def _rows(kinds: list[FaultKind]) -> Iterator[tuple[str, ...]]:
    for kind in kinds:
        parameters = "; ".join(_parameter(parameter) for parameter in kind.parameters)
        yield code(kind.name), kind.at if kind.begin is not None else f"{kind.at} (not emulated)", sentence(kind.does), parameters


def _parameter(parameter: Parameter) -> str:
    spread = f"{number(parameter.low)} to {number(parameter.high)}"
    return f"{code(parameter.key)}: {parameter.description}, {spread}, {number(parameter.default)} unless given"
