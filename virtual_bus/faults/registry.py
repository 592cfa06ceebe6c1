"""The list of faults: every kind that a file of this package declares."""

from __future__ import annotations

from functools import cache

from virtual_bus.faults import brakes, bus, commissioning, drives, encoders, imu, io, nodes, processes, temperatures
from virtual_bus.faults.condition import STATES
from virtual_bus.faults.fault import PLACES, FaultKind

_MODULES = (brakes, drives, io, encoders, imu, temperatures, nodes, bus, commissioning, processes)


@cache
def fault_kinds() -> dict[str, FaultKind]:
    """Return every fault by name, in the order of the files that declare them."""
    found: dict[str, FaultKind] = {}
    for module in _MODULES:
        for kind in module.KINDS:
            if kind.name in found:
                raise ImportError(f"{module.__name__}: a fault {kind.name!r} is declared already; give it another name")
            found[kind.name] = kind
    return found


def catalogue() -> list[dict[str, object]]:
    """Return names, places, classes and parameters of every fault, as plain data."""
    return [
        {
            "name": kind.name,
            "does": kind.does,
            "class": kind.group,
            "at": kind.at,
            "at_in_words": PLACES[kind.at],
            "emulated": kind.begin is not None,
            "parameters": [
                {
                    "name": parameter.name,
                    "key": parameter.key,
                    "unit": parameter.unit,
                    "default": parameter.default,
                    "low": parameter.low,
                    "high": parameter.high,
                    "whole": parameter.whole,
                    "description": parameter.description,
                }
                for parameter in kind.parameters
            ],
        }
        for kind in fault_kinds().values()
    ]


def states() -> dict[str, str]:
    """Return the states that a condition may name, and what they mean."""
    return dict(STATES)
