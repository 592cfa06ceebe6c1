"""The Electro-Mechanical Positioning System: a prismatic axis in its position loop, as the baseline takes it.

Recordings have the file's rows. In the metric's free runs a command acts at once and is held for a row. In a simulation it acts a row
later, which is too late: the recorded motion follows the commands 0.4 ms after their rows. So the loop of a free run has three rows for one
of the file: a command acts one of them late and is held for one, on average as late as in the metric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from real.common import DATA, RealSet, nrmse, on_rows
from real_data import _section_states

from hil.machine import Machine, load_machine
from hil.recording import Channel, Recording, read_recording
from hil.simulation import Inputs, Simulator
from virtual_bus.settings import EffectSetting

AXIS = "carriage"
FINER = 3
SLOPE_ROWS = 11
"""Of the quadratic that gives the first speed."""
PULSE_V = {"official": 1.0, "reversed": 1.0139}
"""What a unit of the recorded pulses adds to the command: fitted where they are in the part to fit."""
SPLITS = {"official": ("DATA_EMPS", "DATA_EMPS_PULSES"), "reversed": ("DATA_EMPS_PULSES", "DATA_EMPS")}
"""Record to fit, and record held out."""


def splits() -> dict[str, RealSet]:
    """Return the baselines' splits: "official" and "reversed"."""
    machine = load_machine("emps")
    return {split: RealSet(machine, *({name: recording(name, PULSE_V[split])} for name in names)) for split, names in SPLITS.items()}


@cache
def recording(name: str, pulse_V: float) -> Recording:
    """Return a record, its pulses in volts, from its first position and speed on."""
    machine = load_machine("emps")
    read = read_recording(DATA / "emps" / f"{name}.mat", machine)
    channels = {channel: read.channel(channel) for channel in read.channels}
    if f"excitation_{AXIS}" in read:
        channels[f"excitation_{AXIS}"] = Channel("V", pulse_V * read[f"excitation_{AXIS}"])
    position, speed = first_state(read)
    states = _loop_states(machine.controllers[0].position_sections, position, speed, machine.sample_rate_Hz)
    initial = {"speeds": [speed], "controller_states": states}
    return Recording(channels, {**read.metadata, "experiment": {"start_pose": [position]}, "initial": initial})


def first_state(record: Recording) -> tuple[float, float]:
    """Return the first position [m], and the slope there [m/s] of a quadratic through the first rows."""
    position = record[f"position_{AXIS}"][:SLOPE_ROWS]
    return float(position[0]), float(np.polyfit(record.time[:SLOPE_ROWS] - record.time[0], position, 2)[1])


def errors(
    split: str, machine: Machine, values: np.ndarray | None = None, effects: Sequence[EffectSetting] = (), finer: int = FINER
) -> dict[str, dict[str, float]]:
    """Return the baselines' error of an answer: NRMSE of position and command `vir` in a free run of the closed loop, all rows.

    Parameters
    ----------
    split : str
        One of `splits`.
    machine : Machine
        Its controller is proportional, less the difference of positions over two rows.
    values : (parameters,) array or None
        Plant parameters; None: the machine's own.
    effects : sequence of EffectSetting
        Besides the machine's own.
    finer : int
        Rows of the loop for one of the file: 3 as in the metric; 1 as the machine file says, with commands that act a row late.
    """
    rate_Hz = finer * machine.sample_rate_Hz
    law = replace(machine.controllers[0], position_sections=_finer(machine.controllers[0].position_sections, finer))
    simulator = Simulator(replace(on_rows(machine, rate_Hz, 1), controllers=(law,)))
    found: dict[str, dict[str, float]] = {"position": {}, "vir": {}}
    for part, name in zip(("train", "held_out"), SPLITS[split], strict=True):
        record = recording(name, PULSE_V[split])
        rows = finer * np.arange(record.rows)
        fine = np.arange(rows[-1] + 1)
        reference, excitation = (
            np.interp(fine, rows, record[channel])[:, None] if channel in record else np.zeros((len(fine), 1))
            for channel in (f"reference_{AXIS}", f"excitation_{AXIS}")
        )
        position, speed = first_state(record)
        states = _loop_states(law.position_sections, position, speed, rate_Hz)
        start = np.array([position]), states, np.array([speed])
        inputs = Inputs(reference, excitation, np.zeros_like(excitation), None, *start)
        outputs = simulator.run(inputs, values, (*machine.plant.effects, *effects))
        found["position"][part] = nrmse(outputs.position[rows, 0], record[f"position_{AXIS}"])
        found["vir"][part] = nrmse(outputs.command[rows, 0], record[f"command_{AXIS}"])
    return found


def _finer(sections: np.ndarray, finer: int) -> np.ndarray:
    """Return the sections of a law `a x(k) - b x(k - 2)` on rows that are 1 or 3 times as many: `a x(k) - b x(k - 2 finer)`.

    With w = z^-2 and r = b / a the law is a (1 - r w), or with s^3 = r it is a (1 - s w) (1 + s w + s^2 w^2).
    """
    if finer == 1:
        return sections
    ((a, _, c, *_),) = sections
    s = float(np.cbrt(-c / a))
    root = np.sqrt(s)
    return np.array([[a, 0.0, -a * s, 1.0, 0.0, 0.0], [1.0, root, s, 1.0, 0.0, 0.0], [1.0, -root, s, 1.0, 0.0, 0.0]])


def _loop_states(sections: np.ndarray, position: float, speed: float, rate_Hz: float) -> dict[str, dict[str, list[list[float]]]]:
    """Return the controller's states after positions along a straight line."""
    before = position - speed / rate_Hz * np.arange(2 * FINER, 0, -1)
    return {AXIS: {"position": _section_states(sections, before), "reference": [[0.0, 0.0]]}}
