"""The emps axis as Euler steps of a mass on a damper in its loop: written from docs/notation.md, sharing nothing with the plant."""

from __future__ import annotations

import numpy as np
from scipy.signal import sosfilt, sosfilt_zi

from hil.machine import load_machine

MASS_kg, DAMPING_N_s_m, GAIN_N_V = 95.1089, 203.5034, 35.15065
STEPS = 10


def pushed_mass(reference, push, excitation=None) -> tuple[np.ndarray, np.ndarray]:
    """Position and command (N,) along a reference (N,), pushed by `push(time, speed)` [N] besides its drive and damper."""
    machine = load_machine("emps")
    period_s = 1.0 / machine.sample_rate_Hz
    forward, back = machine.controllers[0].reference_sections, machine.controllers[0].position_sections
    states = sosfilt_zi(forward) * reference[0], sosfilt_zi(back) * reference[0]
    position, speed, command = float(reference[0]), 0.0, 0.0
    rows = np.zeros((len(reference), 2))
    for k in range(len(reference)):
        effort = command
        from_r, state_r = sosfilt(forward, [reference[k]], zi=states[0])
        from_y, state_y = sosfilt(back, [position], zi=states[1])
        states = state_r, state_y
        command = float(from_r[0] - from_y[0]) + (0.0 if excitation is None else float(excitation[k]))
        rows[k] = position, command
        for _ in range(STEPS):
            force = GAIN_N_V * effort - DAMPING_N_s_m * speed + push(k * period_s, speed)
            speed += force / MASS_kg * period_s / STEPS
            position += speed * period_s / STEPS
    return rows[:, 0], rows[:, 1]
