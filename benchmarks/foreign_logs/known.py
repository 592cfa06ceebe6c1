"""What the files hold: signals of the shipped C-arm by formula, and frames of its bus packed by hand.

Nothing here is of the product but the machine's file, which is read as plain TOML for ratios and currents.
"""

from __future__ import annotations

import math
import struct
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROWS = 384
RATE_Hz = 256.0
TIME_s = np.arange(ROWS) / RATE_Hz
START_s = 1_767_610_800.0
"""2026-01-05 11:00 UTC: where a format has times of day."""

DOUBLE = 1e-12
"""Tolerance of values that a format keeps as they are: formulas of other tools differ in the last digit."""

SINGLE = 2e-7

MACHINE = Path(__file__).resolve().parents[2] / "hil" / "machine" / "shipped" / "carm.toml"
FORMULAS = {
    "position_roll": "0.3*sin(2*pi*0.7*t)+0.01",
    "position_propeller": "-0.2*cos(2*pi*0.4*t)",
    "current_roll": "1.5*sin(2*pi*3*t)-0.25",
}
"""Signals [rad, rad, A] as every tool can write them."""

COMMAND = "current_roll"
STATUS = (np.arange(ROWS) // 50 % 3 + 4661).astype(np.int64)
"""A statusword that changes now and then."""


def signal(name: str, time_s: np.ndarray = TIME_s) -> np.ndarray:
    """Return a signal (N,) at times (N,) [s]."""
    return np.asarray(eval(FORMULAS[name], {"sin": np.sin, "cos": np.cos, "pi": math.pi, "t": time_s}))


@dataclass(frozen=True)
class Known:
    """One channel as it should come out: values (N,), NaN where none is known, and how far it may be off."""

    values: np.ndarray
    within: float = DOUBLE


@dataclass(frozen=True)
class Foreign:
    """One file of another tool.

    Parameters
    ----------
    name, kind, tool : str
    make : callable
        Writes the file into an empty folder and returns its path.
    known : mapping
        Channel -> what it should be.
    time_s : ndarray, shape (N,)
        Times of the rows, counted from the first.
    maps : tuple of str
        For `--map`.
    left : tuple of str
        What of the file cannot be taken: each has to stand in the list of what was not.
    noted : tuple of str
        What has to stand in the notes of how it was read.
    refused : str
        Of a file that cannot be read: what the one line has to say.
    time_within_s : float
    """

    name: str
    kind: str
    tool: str
    make: Callable[[Path], Path]
    known: Mapping[str, Known] = field(default_factory=dict)
    time_s: np.ndarray = field(default_factory=lambda: TIME_s)
    maps: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    noted: tuple[str, ...] = ()
    refused: str = ""
    time_within_s: float = 1e-9
    machine: bool = True


def as_put_in(within: float = DOUBLE, names: tuple[str, ...] = tuple(FORMULAS)) -> dict[str, Known]:
    """Return the three signals as they are."""
    return {name: Known(signal(name), within) for name in names}


@dataclass(frozen=True)
class Frame:
    """One frame of a bus."""

    time_s: float
    can_id: int
    data: bytes


def counts() -> dict[str, np.ndarray]:
    """Return the integers (N,) that the frames carry."""
    k = np.arange(ROWS)
    return {
        "status": STATUS,
        "counts": np.round(30000 * np.sin(2 * np.pi * 0.7 * TIME_s)).astype(np.int64),
        "current": np.round(300 * np.sin(2 * np.pi * 3 * TIME_s)).astype(np.int64),
        "target": 10 * (k % 40) - 200,
        "link": np.round(4194304 + 20000 * np.sin(2 * np.pi * 0.7 * TIME_s)).astype(np.int64),
    }


def frames(start_s: float = START_s) -> list[Frame]:
    """Return a SYNC a tick, what roll's drive and encoder answer, and its target; 0.1 ms apart."""
    found = []
    for k, (status, position, current, target, link) in enumerate(zip(*counts().values(), strict=True)):
        tick = [
            (0x080, b""),
            (0x182, struct.pack("<Hih", status, position, current)),
            (0x18C, struct.pack("<I", link)),
            (0x202, struct.pack("<Hh", 0x0F, target)),
        ]
        found += [Frame(round(start_s + k / RATE_Hz + 1e-4 * place, 6), *one) for place, one in enumerate(tick)]
    return found


def of_the_bus() -> dict[str, Known]:
    """Return the channels of `frames` in SI, by the numbers in the machine's file."""
    document = tomllib.loads(MACHINE.read_text())
    drive, sensor = document["drives"]["roll"], document["sensors"]["link_position_roll"]
    zero = document["bus"]["nodes"]["roll_encoder"]["zero_counts"]
    raw = counts()
    link = (raw["link"] - zero) * 2 * math.pi / sensor["counts_per_turn"]
    motor = raw["counts"] * 2 * math.pi / (drive["encoder_counts_per_motor_turn"] * drive["ratio"])
    return {
        "statusword_roll": Known(raw["status"].astype(float)),
        "position_roll": Known(motor - motor[0] + link[0]),
        "current_roll": Known(raw["current"] * drive["rated_current_A"] / 1000),
        "command_roll": Known(raw["target"] * drive["rated_current_A"] / 1000),
        "link_position_roll": Known(link),
    }
