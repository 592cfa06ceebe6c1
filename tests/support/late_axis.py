"""A turntable under a loop of its own, at steps of 20 µs: friction, disturbance and a drive that acts late.

Nothing of the packages is in it. Position and current are taken at the SYNC: the current is what flows there.
"""

from __future__ import annotations

import math

import numpy as np

STEP_s, STEPS = 20e-6, 250
PERIOD_s = STEP_s * STEPS
INERTIA_kg_m2, DAMPING_Nm_s, Nm_A, COULOMB_Nm = 7.6, 23.0, 9.5, 2.0
MOTOR_rad, LINK_rad, STEP_A = 2.0 * math.pi / 409600, 2.0 * math.pi / 8388608, 0.005
NOISE_A, LIMIT_A = 0.05, 8.0
DISTURBANCE_Nm, CORNER_Hz = 0.05, 2.0
SECTIONS = ((94.9267984, -94.5696061, -1.0), (8.00911037, -7.76138796, -0.752277592))
"""b0, b1, a1 of the loop on reference less position."""
CHANNELS = "time [s],reference_turn [rad],position_turn [rad],link_position_turn [rad],current_turn [A],command_turn [A]"
OLDEST = 32


def wave(amplitude_rad: float, period_s: float, periods: int) -> np.ndarray:
    """Return a reference (N,) from rest and back, again and again."""
    rows = round(period_s / PERIOD_s)
    return 0.5 * amplitude_rad * (1.0 - np.cos(2.0 * np.pi * np.arange(rows * periods) / rows))


def recorded(reference: np.ndarray, delay_s: float, seed: int) -> np.ndarray:
    """Return rows (N, 6) of CHANNELS."""
    random, late = np.random.default_rng(seed), round(delay_s / STEP_s)
    left = math.exp(-2.0 * math.pi * CORNER_Hz * PERIOD_s)
    position = speed = command = disturbance = 0.0
    states, targets, rows = [0.0] * len(SECTIONS), [0.0] * OLDEST, []
    for k, wanted in enumerate(reference.tolist()):
        targets.append(round(command / STEP_A) * STEP_A)
        flowing = [targets[len(targets) - 1 + (step - late) // STEPS] for step in range(STEPS)]
        motor, link = (count * math.floor(position / count + 0.5) for count in (MOTOR_rad, LINK_rad))
        current = round((flowing[0] + NOISE_A * random.standard_normal()) / STEP_A) * STEP_A
        passed = wanted - motor
        for number, (b0, b1, a1) in enumerate(SECTIONS):
            entered, passed = passed, b0 * passed + states[number]
            states[number] = b1 * entered - a1 * passed
        command = min(max(passed, -LIMIT_A), LIMIT_A)
        rows.append((k * PERIOD_s, wanted, motor, link, current, command))
        disturbance = left * disturbance + DISTURBANCE_Nm * math.sqrt(1.0 - left * left) * random.standard_normal()
        most = STEP_s * COULOMB_Nm / INERTIA_kg_m2
        for amperes in flowing:
            free = speed + STEP_s * (Nm_A * amperes + disturbance - DAMPING_Nm_s * speed) / INERTIA_kg_m2
            after = free - min(max(free, -most), most)  # dry friction takes a speed away, and turns none round
            position += 0.5 * STEP_s * (speed + after)
            speed = after
    return np.array(rows)
