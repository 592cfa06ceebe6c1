"""Columns in units that people use, and in some that are refused with the way out."""

from __future__ import annotations

import math
import warnings
from functools import partial
from pathlib import Path

import numpy as np

from field_inputs.kinds import RIGHT, WRONG, Input, Outcome, refused
from hil.errors import RecordingError
from hil.machine import load_machine
from hil.recording import read_recording

CARM = load_machine("carm")
TURN, VALUES = 2.0 * math.pi, np.array([0.1, 0.3, -0.2])
READ: list[tuple[str, str, float]] = [
    ("position_roll", "rev", TURN),
    ("position_roll", "turns", TURN),
    ("position_roll", "°", TURN / 360),
    ("position_roll", "degrees", TURN / 360),
    ("position_roll", "counts", TURN / 4096 / 500),
    ("link_position_roll", "counts", TURN / 2**23),
    ("reference_roll", "increments", TURN / 4096 / 500),
    ("speed_roll", "rpm", TURN / 60),
    ("speed_roll", "1/min", TURN / 60),
    ("speed_roll", "rev/s", TURN),
    ("speed_roll", "dps", TURN / 360),
    ("speed_roll", "counts/s", TURN / 4096 / 500),
    ("current_roll", "mA", 1e-3),
    ("current_roll", "Amps", 1.0),
    ("current_roll", "%", 0.05),
    ("command_roll", "permille", 0.005),
    ("effort_roll", "N·m", 1.0),
    ("effort_roll", "mNm", 1e-3),
    ("imu_x", "mg", 9.80665e-3),
    ("imu_x", "m/s²", 1.0),
    ("temperature_roll", "°C", 1.0),
]
REFUSED = [("position_roll", "gon"), ("speed_roll", "knot"), ("current_roll", "LSB"), ("effort_roll", "lbf"), ("temperature_roll", "degF")]


def judged(folder: Path, channel: str, unit: str, factor: float | None) -> Outcome:
    path = folder / "log.csv"
    path.write_text(f"time [s],{channel} [{unit}]\n" + "".join(f"{0.005 * k},{value}\n" for k, value in enumerate(VALUES)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = read_recording(path, CARM)[channel]
        except RecordingError as refusal:
            return refused(str(refusal), f"[{unit}]", "scale", "--map FILE") if factor is None else Outcome(WRONG, str(refusal))
    return Outcome(RIGHT) if factor is not None and np.allclose(found, factor * VALUES) else Outcome(WRONG, f"read as {found}")


INPUTS = [
    Input(f"{name} in {unit}", "units", "text", partial(judged, channel=name, unit=unit, factor=factor)) for name, unit, factor in READ
]
INPUTS += [Input(f"{name} in {unit}", "units", "text", partial(judged, channel=name, unit=unit, factor=None)) for name, unit in REFUSED]
