"""Four Damiao servos without load, in speed control by their own drives: the set `damiao` of the baselines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.integrate
import scipy.signal
from real.common import AS_FILED, DATA, ControllerSide, RealSet, machine_of, nrmse, on_rows, recording_of

from hil.machine import Machine
from hil.recording import Recording
from hil.simulation import Inputs, Simulator
from virtual_bus.settings import EffectSetting

RUNS = (1, 2, 3)
TURN_rad = 25.0
"""Positions wrap from 12.5 to -12.5."""
UNIT_OF_SPEED = {1: 0.9952, 3: 1.990, 5: 1.658, 6: 1.658}
"""How far the position moves per recorded radian of speed: the median over the rows in motion."""
SPEED_COMMAND = "speed_command"
AXIS = "rotor"

# sample rate [Hz]: some steps in the time that inertia over kd is, and 63 of them as long as the delay of commands; kd; inertia [kg m2];
# steps of torque [Nm] and speed [rad/s]
MOTORS = {
    1: (1000.0, 1.0, 0.0227, 0.0264, 0.0220),
    3: (1000.0, 0.8, 0.0566, 0.0137, 0.0049),
    5: (2000.0, 0.6, 0.0011, 0.00488, 0.01465),
    6: (2000.0, 0.6, 0.0017, 0.00488, 0.01465),
}


def splits() -> dict[str, RealSet]:
    """Return the baselines' splits, of every motor one set: "run 3 held out, motor 1"."""
    found = {}
    for motor in MOTORS:
        machine = machine_of_motor(motor)
        runs = {number: read(machine, motor, number) for number in RUNS}
        for held_out in (3, 2, 1):
            train = {f"run {number}": runs[number] for number in RUNS if number != held_out}
            found[f"run {held_out} held out, motor {motor}"] = RealSet(machine, train, {f"run {held_out}": runs[held_out]})
    return found


def machine_of_motor(motor: int, kd: float | None = None) -> Machine:
    """Return the nominal machine of a motor, under a kd other than the configured one if any."""
    rate_Hz, configured, inertia, torque_step, speed_step = MOTORS[motor]
    gain = (configured if kd is None else kd) * rate_Hz
    return machine_of(
        "damiao",
        name=f'"damiao_{motor}"',
        sample_rate_Hz=str(rate_Hz),
        inertia_kg_m2=str([inertia] * 3 + [0.0] * 3),
        resolution_rad_s=str(speed_step),
        resolution_Nm=str(torque_step),
        position_sections=str([[gain, -gain, 0.0, 1.0, 0.0, 0.0]]),
    )


def read(machine: Machine, motor: int, number: int) -> Recording:
    """Return the speed phase of a run, at its own rows."""
    path = DATA / "damiao" / f"motor{motor}_run{number}.csv.gz"
    seconds, position, speed, torque, _, command, in_torque, _ = np.genfromtxt(path, delimiter=",", skip_header=1).T
    rows = slice(int(np.argmax(in_torque == 0)), None)
    turned = np.unwrap(position[rows], period=TURN_rad) / UNIT_OF_SPEED[motor]
    reference = turned[0] + scipy.integrate.cumulative_trapezoid(command[rows], seconds[rows], initial=0.0)
    columns = {
        f"reference_{AXIS}": ("rad", reference),
        f"position_{AXIS}": ("rad", turned),
        f"speed_{AXIS}": ("rad/s", speed[rows]),
        f"effort_{AXIS}": ("Nm", torque[rows]),
        SPEED_COMMAND: ("rad/s", command[rows]),
    }
    initial = {"speeds": [float(speed[rows][0])], "controller_states": _states(machine, command[rows][0] - speed[rows][0])}
    return recording_of(machine, seconds[rows], columns, initial, experiment={"start_pose": [float(turned[0])]})


def errors(
    split: str, machine: Machine, values: np.ndarray | None, effects: Sequence[EffectSetting], side: ControllerSide = AS_FILED
) -> dict[str, dict[str, float]]:
    """Return the baselines' error of an answer: NRMSE of torque and speed in free runs of the closed loop, at all recorded rows.

    Parameters
    ----------
    split : str
        One of `splits`.
    machine : Machine
        Its controller is the drive's law.
    values : (parameters,) array or None
        Plant parameters; None: the machine's own.
    effects : sequence of EffectSetting
        Besides the machine's own.
    side : ControllerSide
    """
    data = splits()[split]
    simulator = Simulator(on_rows(machine, machine.sample_rate_Hz, machine.plant.substeps))
    motor = split.rsplit(" ", 1)[1]
    found: dict[str, dict[str, float]] = {f"motor_{motor}_{channel}": {} for channel in ("torque", "speed")}
    for part, recordings in (("train", data.train), ("held_out", data.held_out)):
        runs = [(free_run(simulator, recording, values, effects, side), recording) for recording in recordings.values()]
        for column, (channel, name) in enumerate((("torque", f"effort_{AXIS}"), ("speed", f"speed_{AXIS}"))):
            error = nrmse([simulated[column] for simulated, _ in runs], [recording[name] for _, recording in runs])
            found[f"motor_{motor}_{channel}"][part] = error
    return found


def free_run(
    simulator: Simulator, recording: Recording, values: np.ndarray | None, effects: Sequence[EffectSetting], side: ControllerSide = AS_FILED
) -> tuple[np.ndarray, np.ndarray]:
    """Return torque and speed (rows,) at the recorded rows, from the commands, by straight lines, and the first speed alone."""
    machine = simulator.machine
    fine_s = np.arange(0.0, recording.time[-1] + 2.0 / machine.sample_rate_Hz, 1.0 / machine.sample_rate_Hz)
    machine = replace(
        machine,
        controllers=tuple(
            replace(each, position_sections=each.position_sections * np.array([*[side.gain] * 3, 1.0, 1.0, 1.0]))
            for each in machine.controllers
        ),
    )
    simulator = Simulator(machine)
    command = np.interp(fine_s - side.lateness_s, recording.time, recording[SPEED_COMMAND])
    command = np.clip(command, -side.speed_limit, side.speed_limit)
    start, speed = float(recording[f"position_{AXIS}"][0]), float(recording[f"speed_{AXIS}"][0])
    reference = start + scipy.integrate.cumulative_trapezoid(command, fine_s, initial=0.0)
    nothing = np.zeros((len(fine_s), 1))
    states = _states(machine, command[0] - speed)
    inputs = Inputs(reference[:, None], nothing, nothing, None, np.array([start]), states, np.array([speed]))
    outputs = simulator.run(inputs, values, (*machine.plant.effects, *effects))
    read = outputs.effort
    if side.effort_lag_s > 0.0:
        left = float(np.exp(-1.0 / (side.effort_lag_s * machine.sample_rate_Hz)))
        read = scipy.signal.lfilter([1.0 - left], [1.0, -left], read, axis=0, zi=left * read[:1])[0]
    torque, turning = (np.interp(recording.time, fine_s, column[:, 0]) for column in (read + side.effort_zero, outputs.speed))
    torque[0] = recording[f"effort_{AXIS}"][0]  # the metric's first reading is the recorded one
    return torque, turning


def _states(machine: Machine, error: float) -> dict[str, dict[str, list[list[float]]]]:
    """Return the controller's state at a row where the speed is off its command by `error`, and the position is the reference."""
    kd = machine.controllers[0].position_sections[0, 0] / machine.sample_rate_Hz
    return {AXIS: {"position": [[float(kd * error), 0.0]]}}
