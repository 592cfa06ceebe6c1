"""Baseline of a double pendulum that swings freely: arms of the authors' numbers, with friction in both bearings.

The machine has no motor. Both angles are absolute: pi hangs, 0 stands up. The second bearing sits at the end of the first arm. Friction
acts on the speed of the first arm, and on the speed of the second arm relative to the first.

Fitted, by least squares on the angles of the training windows: viscous and Coulomb friction of both bearings, three of the four ratios
that masses and lengths leave in the equations, and the zero of both encoders. With no motor the overall scale of mass cannot be seen:
the product of the second arm's mass and centre keeps the authors' value. The fourth ratio follows from the first arm's length.

The error is that of a free run over windows of 1.333 s, pooled, for each angle. The recorded speeds lag the angles by 0.5 to 1 ms, which
costs accuracy. So a window starts from the recorded angles and from the slope of a quadratic fitted to them. The results
from recorded speeds are given as well.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from common import data_folder, nrmse, run
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

PERIOD_s = 0.001
WINDOW_ROWS = 1333  # 1.333 s, about one swing and a half: longer windows of the first 15 s are chaotic
SLOPE_ROWS = 21  # rows of the quadratic that gives a window's first speeds: 1/30 of a swing, so that its cubic part stays below the noise
SLIP_SPEED_rad_s = 0.02  # Coulomb friction is smooth within this speed, 0.3 % of the largest: free of steps for the integrator
FITTED_ROWS = 4  # every fourth row is fitted: the angles are smooth over 4 ms
GRAVITY_m_s2 = 9.81

# The authors' arms
MASS_kg = (0.09384, 0.1376)
CENTRE_m = (0.10857, 0.11678)
INERTIA_kg_m2 = (4.375e-4, 1.2688e-3)  # about the centres
FIRST_ARM_m = 0.17272
SECOND_MOMENT_kg_m = MASS_kg[1] * CENTRE_m[1]


@dataclass(frozen=True)
class Parameter:
    """One number of the model: the authors' value, what is documented of it, its fitting scale, and whether it may be negative."""

    name: str
    unit: str
    authors: float
    documented: float | None
    scale: float
    signed: bool = True


FIRST_INERTIA = INERTIA_kg_m2[0] + MASS_kg[0] * CENTRE_m[0] ** 2 + MASS_kg[1] * FIRST_ARM_m**2
SECOND_INERTIA = INERTIA_kg_m2[1] + MASS_kg[1] * CENTRE_m[1] ** 2
FIRST_MOMENT = MASS_kg[0] * CENTRE_m[0] + MASS_kg[1] * FIRST_ARM_m
PARAMETERS = (
    Parameter("first_inertia", "kg m2", FIRST_INERTIA, FIRST_INERTIA, 0.01 * FIRST_INERTIA),  # both masses, about the first bearing
    Parameter("second_inertia", "kg m2", SECOND_INERTIA, SECOND_INERTIA, 0.01 * SECOND_INERTIA),  # second arm, about its bearing
    Parameter("first_moment", "kg m", FIRST_MOMENT, FIRST_MOMENT, 0.01 * FIRST_MOMENT),  # mass times centre, what gravity pulls at
    Parameter("first_viscous", "Nm s/rad", 0.0, 2.37e-4, 1e-4, signed=False),
    Parameter("second_viscous", "Nm s/rad", 0.0, 1.0e-5, 1e-5, signed=False),
    Parameter("first_coulomb", "Nm", 0.0, 5.4e-4, 1e-4, signed=False),  # documented as instead of the viscous friction
    Parameter("second_coulomb", "Nm", 0.0, None, 1e-5, signed=False),
    Parameter("first_zero", "rad", 0.0, None, 1e-3),
    Parameter("second_zero", "rad", 0.0, None, 1e-3),
)
NAMES = [parameter.name for parameter in PARAMETERS]
AUTHORS = np.array([parameter.authors for parameter in PARAMETERS])
SCALES = np.array([parameter.scale for parameter in PARAMETERS])
LOWER = np.array([-np.inf if parameter.signed else 0.0 for parameter in PARAMETERS])
INERTIAS = ("first_inertia", "second_inertia", "first_moment")
VISCOUS = ("first_viscous", "second_viscous")
COULOMB = ("first_coulomb", "second_coulomb")
ZEROS = ("first_zero", "second_zero")


def derivative(state: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Return the rates of two angles and two speeds; all further axes are simulated side by side."""
    J1, J2, moment, b1, b2, Fc1, Fc2, zero1, zero2 = parameters
    angle1, angle2, speed1, speed2 = state
    coupling = FIRST_ARM_m * SECOND_MOMENT_kg_m
    sine, cosine = np.sin(angle1 - angle2), np.cos(angle1 - angle2)
    relative = speed2 - speed1
    friction1 = b1 * speed1 + Fc1 * np.tanh(speed1 / SLIP_SPEED_rad_s)
    friction2 = b2 * relative + Fc2 * np.tanh(relative / SLIP_SPEED_rad_s)
    torque1 = -coupling * sine * speed2**2 + GRAVITY_m_s2 * moment * np.sin(angle1 - zero1) - friction1 + friction2
    torque2 = coupling * sine * speed1**2 + GRAVITY_m_s2 * SECOND_MOMENT_kg_m * np.sin(angle2 - zero2) - friction2
    determinant = J1 * J2 - (coupling * cosine) ** 2
    acceleration1 = (J2 * torque1 - coupling * cosine * torque2) / determinant
    acceleration2 = (J1 * torque2 - coupling * cosine * torque1) / determinant
    return np.stack([speed1, speed2, acceleration1, acceleration2])


def simulate(start: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Return the angles (rows, 2, ...) of all windows from `start` (4, ...), by Runge and Kutta's fourth-order step of one row."""
    state = start
    angles = [state[:2]]
    for _ in range(WINDOW_ROWS - 1):
        k1 = derivative(state, parameters)
        k2 = derivative(state + PERIOD_s / 2 * k1, parameters)
        k3 = derivative(state + PERIOD_s / 2 * k2, parameters)
        k4 = derivative(state + PERIOD_s * k3, parameters)
        state = state + PERIOD_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        angles.append(state[:2])
    return np.stack(angles)


@dataclass(frozen=True)
class Windows:
    """Angles (rows, 2, windows) and the states (4, windows) from which they are simulated."""

    angles: np.ndarray
    start: np.ndarray

    def only(self, chosen: np.ndarray) -> Windows:
        """Return some of the windows."""
        return Windows(self.angles[:, :, chosen], self.start[:, chosen])


def read_windows() -> tuple[Windows, Windows]:
    """Return all windows, started from the slope of a local quadratic, and the same started from the recorded speeds."""
    rows = np.genfromtxt(data_folder() / "dpend" / "dpend.csv.gz", delimiter=",", skip_header=1)
    angles, speeds = rows[:, 1:3], rows[:, 3:5]
    first_rows = np.arange(0, len(rows) - WINDOW_ROWS + 1, WINDOW_ROWS)
    slopes = savgol_filter(angles, SLOPE_ROWS, 2, deriv=1, delta=PERIOD_s, axis=0, mode="interp")
    cut = np.stack([angles[row : row + WINDOW_ROWS] for row in first_rows], axis=2)
    starts = [np.concatenate([angles[first_rows].T, speed[first_rows].T]) for speed in (slopes, speeds)]
    return Windows(cut, starts[0]), Windows(cut, starts[1])


def fit(windows: Windows, names: Sequence[str]) -> np.ndarray:
    """Return all parameters, those of `names` fitted to the angles, each angle weighed by its own spread."""
    free = [NAMES.index(name) for name in names]
    step = 0.01  # of a parameter's scale, for differences: errors of 1e-4 in a slope
    measured = windows.angles[::FITTED_ROWS]
    spread = measured.std(axis=(0, 2))[None, :, None]

    def candidates(scaled: np.ndarray) -> np.ndarray:
        parameters = np.repeat(AUTHORS[:, None], len(free) + 1, axis=1)
        parameters[free] = (scaled * SCALES[free])[:, None]
        parameters[free, np.arange(1, len(free) + 1)] += step * SCALES[free]
        return parameters

    def runs(scaled: np.ndarray) -> np.ndarray:
        start = np.repeat(windows.start[:, None, :], len(free) + 1, axis=1)
        return simulate(start, candidates(scaled)[:, :, None])[::FITTED_ROWS]

    def residual(scaled: np.ndarray) -> np.ndarray:
        return np.asarray((runs(scaled)[:, :, 0] - measured) / spread).ravel()

    def jacobian(scaled: np.ndarray) -> np.ndarray:
        angles = runs(scaled)
        slopes = (angles[:, :, 1:] - angles[:, :, :1]) / step / spread[:, :, None]
        return np.asarray(np.moveaxis(slopes, 2, -1).reshape(-1, len(free)))

    guess = AUTHORS.copy()
    for name in (*VISCOUS, *COULOMB):  # away from the bound at zero
        guess[NAMES.index(name)] = 0.5 * SCALES[NAMES.index(name)]
    found = least_squares(residual, guess[free] / SCALES[free], jac=jacobian, bounds=(LOWER[free] / SCALES[free], np.inf), xtol=1e-6)
    parameters = AUTHORS.copy()
    parameters[free] = found.x * SCALES[free]
    return parameters


def errors(windows: Windows, parameters: np.ndarray) -> list[float]:
    """Return the NRMSE of both angles, pooled over the windows."""
    angles = simulate(windows.start, parameters[:, None])
    return [nrmse(angles[:, arm], windows.angles[:, arm]) for arm in (0, 1)]


def split(train: np.ndarray, held_out: np.ndarray, words: tuple[str, str], official: bool) -> dict[str, Any]:
    """Fit the training windows and measure both parts."""
    began = time.perf_counter()
    windows, recorded_speeds = read_windows()
    damped = np.array([p.documented if p.name in VISCOUS else p.authors for p in PARAMETERS])
    stages = {
        "nominal": AUTHORS,
        "documented": damped,
        "viscous": fit(windows.only(train), VISCOUS),
        "coulomb": fit(windows.only(train), COULOMB),
        "fitted": fit(windows.only(train), (*INERTIAS, *VISCOUS, *COULOMB, *ZEROS)),
    }

    def table(of: Windows, some: Mapping[str, np.ndarray]) -> dict[str, Any]:
        found = {name: (errors(of.only(train), stage), errors(of.only(held_out), stage)) for name, stage in some.items()}
        return {
            f"angle_{arm + 1}": {name: {"train": round(a[arm], 5), "held_out": round(b[arm], 5)} for name, (a, b) in found.items()}
            for arm in (0, 1)
        }

    return {
        "train": [words[0]],
        "held_out": [words[1]],
        "metric": "NRMSE of each absolute angle in a free run, pooled over windows of 1333 rows at 1 kHz (1.333 s; window n starts at row "
        "1333 (n - 1), 60 windows), all rows counted. Initial angles: recorded. Initial speeds: slope of a quadratic fitted to the "
        "recorded angles of the 21 rows centred on the window's first row (rows 0 to 20 for window 1). No input.",
        "official": official,
        "nominal_is": "the authors' arms, no friction, nothing fitted; 'documented' adds their viscous friction, unfitted; 'viscous' and "
        "'coulomb' fit that friction alone",
        "parameters": {
            parameter.name: {
                "value": float(f"{value:.4g}"),
                "unit": parameter.unit,
                "documented": None if parameter.documented is None else float(f"{parameter.documented:.4g}"),
            }
            for parameter, value in zip(PARAMETERS, stages["fitted"], strict=True)
        },
        "channels": table(windows, stages),
        "other_metrics": {"initial speeds as recorded": table(recorded_speeds, {name: stages[name] for name in ("nominal", "fitted")})},
        "seconds": round(time.perf_counter() - began, 1),
    }


def splits() -> dict[str, Any]:
    """Return all splits; windows are counted from 1."""
    number = np.arange(1, 61)
    odd, even = number[number % 2 == 1] - 1, number[number % 2 == 0] - 1
    first, second = number[:30] - 1, number[30:] - 1
    return {
        "readme": split(odd, even, ("odd windows", "even windows"), official=True),
        "reversed": split(even, odd, ("even windows", "odd windows"), official=False),
        "time": split(first, second, ("windows 1 to 30 (0 to 39.99 s)", "windows 31 to 60 (39.99 to 79.98 s)"), official=False),
    }


if __name__ == "__main__":
    run("dpend", __doc__, splits)
