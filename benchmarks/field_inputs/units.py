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
NAMED: list[tuple[str, str, float]] = [
    ("position_deg", "position_roll", TURN / 360),
    ("Position (deg)", "position_roll", TURN / 360),
    ("Position / deg", "position_roll", TURN / 360),
    ("posRev", "position_roll", TURN),
    ("enc_counts", "position_roll", TURN / 4096 / 500),
    ("phi.mrad", "position_roll", 1e-3),
    ("speed_rpm", "speed_roll", TURN / 60),
    ("vel_deg_s", "speed_roll", TURN / 360),
    ("velRadPerS", "speed_roll", 1.0),
    ("Drehzahl 1/min", "speed_roll", TURN / 60),
    ("Iq_mA", "current_roll", 1e-3),
    ("load_pct", "current_roll", 0.05),
    ("torque {N*m}", "effort_roll", 1.0),
    ("q_rot", "position_roll", 1.0),
    ("phase_A", "current_roll", 1.0),
]
"""Heads of columns, and the factor of the unit in them; the last two have none."""

TIMES = [("time_ms", 1e3), ("Time (us)", 1e6), ("stamp_ns", 1e9), ("time", 1e3), ("stamp", 1e9)]
OTHER_FILES = [
    (".bag", "rosbags-convert"),
    (".gz", "unpack"),
    (".xlsx", "CSV"),
    (".tdms", "nptdms"),
    (".h5", "pandas"),
    (".ulg", "ulog2csv"),
]
REFUSED = [("position_roll", "gon"), ("position_roll", "mm"), ("speed_roll", "knot"), ("current_roll", "LSB"), ("effort_roll", "lbf")]
REFUSED += [("temperature_roll", "degF")]


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


def named(folder: Path, head: str, channel: str, factor: float, time: str = "t [s]", per_s: float = 1.0) -> Outcome:
    """Judge a column with its unit in the name, at the machine's rate."""
    path = folder / "log.csv"
    step = per_s / CARM.sample_rate_Hz
    path.write_text(f"{time};{head}\n" + "".join(f"{step * k!r};{value}\n" for k, value in enumerate(VALUES)), encoding="utf-8")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(path, CARM, {time.removesuffix(" [s]"): "time", head: channel})
    if factor != 1.0 and "by its name" not in " ".join(str(one.message) for one in caught):
        return Outcome(WRONG, "not said")
    steps = np.diff(recording.time) * CARM.sample_rate_Hz
    right = np.allclose(recording[channel], factor * VALUES) and np.allclose(steps, 1.0)
    return Outcome(RIGHT) if right else Outcome(WRONG, f"read as {recording[channel]} at {recording.time}")


def other_file(folder: Path, suffix: str, way: str) -> Outcome:
    path = folder / f"log{suffix}"
    path.write_bytes(b"\0")
    try:
        read_recording(path, CARM)
    except RecordingError as refusal:
        return refused(str(refusal), suffix, way)
    return Outcome(WRONG, "read")


INPUTS += [
    Input(f"{head!r} as {channel}", "units", "text", partial(named, head=head, channel=channel, factor=factor))
    for head, channel, factor in NAMED
]
INPUTS += [
    Input(f"{time!r} in steps of {per_s:g} a second", "units", "text", judge)
    for time, per_s in TIMES
    for judge in (partial(named, head="position_deg", channel="position_roll", factor=TURN / 360, time=time, per_s=per_s),)
]
INPUTS += [Input(f"a file {suffix}", "units", "bytes", partial(other_file, suffix=suffix, way=way)) for suffix, way in OTHER_FILES]
