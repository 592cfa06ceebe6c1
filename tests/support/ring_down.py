"""A ring-down on the bus and what can be read from it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import scipy.linalg

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Static
from hil.machine import Machine
from hil.observing.live import LiveObserver
from hil.recording import Recording, read_recording

PULSED_ROW, PULSE_ROWS, PULSE_A = 3 * 256, 16, 2.0
AFTER = slice(PULSED_ROW + 2 * PULSE_ROWS + 8, PULSED_ROW + 2 * PULSE_ROWS + 8 + 120)
"""Rows of the ring-down, once the pulse has gone through."""


def rung(machine: Machine, live: LiveObserver, path: Path, pulse_A: float = PULSE_A) -> Recording:
    """Six seconds at rest; the propeller's drive pushes there and back once, at the pace of its gear's mode."""
    plan = Static(6.0, {}).plans(machine)[0]
    excitation = plan.excitation.copy()
    excitation[PULSED_ROW : PULSED_ROW + PULSE_ROWS, 0] = pulse_A
    excitation[PULSED_ROW + PULSE_ROWS : PULSED_ROW + 2 * PULSE_ROWS, 0] = -pulse_A
    with open_bench(machine, BenchOptions("lockstep:", seed=5), plan.start_pose, live) as bench:
        bench.run(dataclasses.replace(plan, excitation=excitation), path)
    return read_recording(path)


def rung_ratio(machine: Machine, live: LiveObserver, folder: Path) -> float:
    """Damping ratio of the 8 Hz mode in closed loop, from the detector's gyro, pulse minus no pulse: the noise is the same."""
    pushed, still = (rung(machine, live, folder / f"pulse_{pulse_A:g}A.mf4", pulse_A) for pulse_A in (PULSE_A, 0.0))
    return ratio_of(pencil_poles(pushed["gyro_x"][AFTER] - still["gyro_x"][AFTER], 6), 8.4)


def pencil_poles(values: np.ndarray, order: int) -> np.ndarray:
    """Poles of a sum of damped sinusoids by the matrix pencil of Hua and Sarkar 1990: (order,) in z."""
    columns = len(values) // 3
    hankel = scipy.linalg.hankel(values[: len(values) - columns], values[len(values) - columns - 1 :])
    _, _, right = np.linalg.svd(hankel, full_matrices=False)
    kept = right[:order].T
    return np.linalg.eigvals(np.linalg.pinv(kept[:-1]) @ kept[1:])


def ratio_of(poles: np.ndarray, near_Hz: float, rate_Hz: float = 256.0) -> float:
    """Damping ratio of the pole nearest to a frequency."""
    s = np.log(poles[poles.imag > 0.0]) * rate_Hz
    nearest = s[np.argmin(np.abs(np.abs(s) / (2.0 * np.pi) - near_Hz))]
    return float(-nearest.real / abs(nearest))
