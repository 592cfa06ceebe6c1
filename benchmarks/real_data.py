"""Recordings that other people measured, read in place as recordings of the shipped machines: no file is copied or changed.

`REAL_SETS` lists them by machine: what a diagnosis is fitted to, and what is held out. The folder is `../shared/data` beside the project.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.signal

from hil.machine import Machine, load_machine
from hil.machine.load import machine_from_text
from hil.recording import Channel, Recording, read_recording, recording_metadata

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

SILVERBOX_ARROW_ROWS = 40_000
"""The benchmark's test: noise of growing amplitude."""
SILVERBOX_FIT_ROWS = (40_600, 48_800)
SILVERBOX_BAND = 0.48
"""Share of the sample rate up to which the measured input is taken for a signal."""

DRIVES_FIT_ROWS = 400
MOTOR_SECONDS = 0.1
MOTOR_PIECES = 24
"""Pieces of a motor's record, and how long each is: 5 cogs, which they pass without losing phase."""
MOTOR_SPEED_LATE_ROWS = 2
"""The recorded speed is a weighted mean of the last five differences of positions (regressed), this late; taken back here."""
MOTOR_RUN_UP_S = 1.0
"""Left out at the beginning: the motor starts from standstill there."""
MOTOR_SLOPE_ROWS = 7
"""Rows of the second-order polynomial that a piece's first speed is taken from."""
MOTOR_SPEED_A = 0.555
"""What the speed loop asks for at standstill: its gain times the reference of 6.28 rad/s."""
MOTOR_LOOP = """
# The loop that drove it: regressed on positions, Iq is 0.555 A less 0.0887 A s/rad times a weighted mean of the last five differences
# of positions, 0.20, 0.26, 0.24, 0.19 and 0.12 (0.025 A rms are left of 0.29).
[controller.rotor]
position_sections = [
    [17.4, 26.4764, 14.1825, 1, 0, 0],
    [1, -0.205538, 0.733297, 1, 0, 0],
    [1, -1, 0, 1, 0, 0],
]

[limits.rotor]
range_rad = [-1.0e4, 1.0e4]
speed_rad_s = 100.0
acceleration_rad_s2 = 1.0e6
jerk_rad_s3 = 1.0e9
tracking_error_rad = 1.0e4
"""
"""In open loop the position runs away by e in 5 ms on top of a cog of 0.16 Nm at 72 a turn; in this loop it does not."""


@dataclass(frozen=True)
class RealSet:
    """One machine's recordings."""

    machine: Machine
    train: Mapping[str, Recording]
    held_out: Mapping[str, Recording]


def emps() -> RealSet:
    """The prismatic axis in closed loop: its first record for fitting, the one with force pulses held out."""
    machine = load_machine("emps")
    return RealSet(
        machine,
        {"DATA_EMPS": read_recording(DATA / "emps" / "DATA_EMPS.mat", machine)},
        {"DATA_EMPS_PULSES": read_recording(DATA / "emps" / "DATA_EMPS_PULSES.mat", machine)},
    )


def silverbox() -> RealSet:
    """The electronic mass on a spring: a stretch of the odd multisines for fitting, the arrow held out."""
    machine = load_machine("silverbox")
    v1, v2 = _table(DATA / "silverbox" / "SNLS80mV.csv", 2).T
    command = _one_row_later(hold_equivalent(v1))
    arrow = slice(0, SILVERBOX_ARROW_ROWS)
    return RealSet(
        machine,
        {"multisines": _recording(machine, {"command_mass": command, "position_mass": v2}, slice(*SILVERBOX_FIT_ROWS), settle_rows=1000)},
        {"arrow": _recording(machine, {"command_mass": command, "position_mass": v2}, arrow)},
    )


def coupled_electric_drives() -> RealSet:
    """Motors, belt and pulley: samples 0 to 399 of each record with uniform noise for fitting, 400 to 499 held out.

    The held-out recordings are whole, so that the motion at sample 400 is known; their first 400 rows only settle.
    """
    machine = load_machine("coupled_electric_drives")
    u1, u2, z1, z2 = _table(DATA / "coupled_electric_drives" / "DATAUNIF.csv", 4).T
    records = {"z11": (u1, z1), "z12": (u2, z2)}

    def parts(rows: slice, settle_rows: int) -> dict[str, Recording]:
        return {
            name: _recording(machine, {"command_motors": u, "speed_motors": z}, rows, settle_rows=settle_rows)
            for name, (u, z) in records.items()
        }

    return RealSet(machine, parts(slice(0, DRIVES_FIT_ROWS), 0), parts(slice(None), DRIVES_FIT_ROWS))


def laas_anti_cogging() -> RealSet:
    """The bare motor, uncompensated, in its speed loop: pieces of speed_test1 for fitting, pieces of speed_test held out.

    The flag means the opposite in the two files: the rough half, which nothing compensates, has flag 0 in speed_test1 and 1 in speed_test.
    """
    machine = machine_from_text(load_machine("laas_anti_cogging").text + MOTOR_LOOP, label="laas_anti_cogging in its loop")
    return RealSet(machine, _motor_pieces(machine, "speed_test1.txt", 0), _motor_pieces(machine, "speed_test.txt", 1))


REAL_SETS: dict[str, Callable[[], RealSet]] = {
    "emps": emps,
    "silverbox": silverbox,
    "coupled_electric_drives": coupled_electric_drives,
    "laas_anti_cogging": laas_anti_cogging,
}


def hold_equivalent(values: np.ndarray) -> np.ndarray:
    """The staircase (N,) whose hold over each sample is, within the band, the band-limited signal with these samples.

    A hold delays by half a sample and weakens frequency f by sinc(f T); both are taken back in the spectrum of the record and its mirror
    image.
    """
    spectrum = np.fft.rfft(np.concatenate([values, values[::-1]]))
    frequency = np.fft.rfftfreq(2 * len(values))
    spectrum *= np.where(frequency < SILVERBOX_BAND, np.exp(1j * np.pi * frequency) / np.sinc(frequency), 0.0)
    return np.fft.irfft(spectrum)[: len(values)]


def _one_row_later(effort: np.ndarray) -> np.ndarray:
    """Commands (N,) of an effort that acts from each row to the next: command k acts from row k + 1 on."""
    return np.append(effort[1:], effort[-1])


def _motor_pieces(machine: Machine, file: str, rough_flag: int) -> dict[str, Recording]:
    """Pieces of the uncompensated half, spread over it, each from its own pose, speed and controller state, where the motor is fastest:
    an error of the first pose or speed shrinks with the speed from there, and would grow from where the motor creeps over a cog.
    """
    table = _table(DATA / "laas_anti_cogging" / file, 6)
    time, position, speed, _, current, _ = table[table[:, 5] == rough_flag].T
    rate_Hz = machine.sample_rate_Hz
    even = np.arange(time[0], time[-1], 1.0 / rate_Hz)
    position, speed, current = (np.interp(even, time, values) for values in (position, speed, current))
    acting = np.append(0.5 * (current[1:] + current[:-1]), current[-1])
    speed = np.append(speed[MOTOR_SPEED_LATE_ROWS:], speed[-MOTOR_SPEED_LATE_ROWS:])
    slope = scipy.signal.savgol_filter(position, MOTOR_SLOPE_ROWS, 2, deriv=1, delta=1.0 / rate_Hz)
    rows = round(MOTOR_SECONDS * rate_Hz)
    run_up = round(MOTOR_RUN_UP_S * rate_Hz)
    fastest, _ = scipy.signal.find_peaks(slope[: len(even) - rows], distance=8, height=np.quantile(slope[run_up:], 0.8))
    fastest = fastest[fastest > run_up]
    starts = np.sort(np.random.default_rng(0).choice(fastest, MOTOR_PIECES, replace=False))
    inertia = machine.plant.tree.bodies[0].inertia_kg_m2[2, 2]
    pieces = {}
    for number, start in enumerate(starts, 1):
        channels = {"command_rotor": _one_row_later(acting), "position_rotor": position, "speed_rotor": speed}
        channels |= {"reference_rotor": np.full(len(even), position[start]), "excitation_rotor": np.full(len(even), MOTOR_SPEED_A)}
        states = {"rotor": {"position": _section_states(machine.controllers[0].position_sections, position[start] - position[:start])}}
        # until its first command acts a simulation has no effort: what acted goes into the first speed
        begins = float(slope[start] + acting[start] / inertia / rate_Hz)
        part = slice(start, start + rows)
        initial = {"speeds": [begins], "controller_states": states}
        pieces[f"{Path(file).stem} piece {number}"] = _recording(machine, channels, part, initial=initial)
    return pieces


def _section_states(sections: np.ndarray, errors: np.ndarray) -> list[list[float]]:
    """(sections, 2) states after these errors of position."""
    states = np.zeros((len(sections), 2))
    _, states = scipy.signal.sosfilt(sections, errors, zi=states)
    return states.tolist()


def _recording(
    machine: Machine, channels: Mapping[str, np.ndarray], rows: slice, *, settle_rows: int = 0, initial: Mapping[str, object] | None = None
) -> Recording:
    units = machine.units[0]
    unit_of = {"command": units.effort, "excitation": units.effort, "speed": f"{units.position}/s"}
    unit_of |= dict.fromkeys(("reference", "position"), units.position)
    values = {name: column[rows] for name, column in channels.items()}
    count = len(next(iter(values.values())))
    made = {"time": Channel("s", np.arange(count) / machine.sample_rate_Hz)}
    made |= {name: Channel(unit_of[name.split("_")[0]], column) for name, column in values.items()}
    experiment = {"settle_rows": settle_rows} if settle_rows else {}
    return Recording(made, recording_metadata(machine, experiment=experiment, initial=dict(initial or {})))


def _table(path: Path, columns: int) -> np.ndarray:
    return np.genfromtxt(path, delimiter=",", skip_header=1)[:, :columns]
