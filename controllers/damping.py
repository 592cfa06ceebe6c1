"""Active damping of one mode: a command against the mode's speed as an observer estimates it, ramped in and out.

With the modal model (controllers/models/modal.py) η'' + 2 ζ ω η' + ω² η = bᵀ u + d. The command of least norm that adds damping is

    u = -b / (bᵀ b) · 2 (ζ_wanted - ζ) ω · η'

A command given in row k acts from row k+1 to k+2, so η' is what the model says it will be in the middle of that, 1.5 samples on.
Every parameter is taken at the estimated pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

import controllers.models.modal
import controllers.observers.modal_equations
from controllers.compiled import sources_digest
from controllers.errors import DesignError
from controllers.models.modal import ModalModel, schedule
from controllers.observers.modal_equations import mode_step

AHEAD_SAMPLES = 1.5
"""From a row to the middle of the time in which its command acts."""

RAMP_s = 0.5
"""From nothing to all of it and back: four periods of an 8 Hz mode, so that the ramp itself excites nothing."""

PROVEN_s = 1.0
"""So long an estimate must have been good before it is acted upon."""

LIMIT_SHARE = 0.25
"""Of a drive's limit that damping may take: the rest is the position loop's."""

SLEW = 1.5
"""It changes no faster than a swing of that size at so many times the mode's frequency at position zero: what jumps is no vibration."""


@dataclass(frozen=True)
class DampingSettings:
    """What is wanted of active damping.

    Parameters
    ----------
    ratio : float
        Damping ratio that the mode is to have, as far as this command alone decides.
    mode : int
        Which mode of the model, from 0.
    """

    ratio: float
    mode: int = 0


def _compile(version: int) -> Any:
    @njit(cache=True, fastmath=False, error_model="numpy")
    def against_speed(harmonics, coefficients, places, ahead_s, ratio, x, acting, effort):  # type: ignore[no-untyped-def]
        """Effort (axes,); `places`: of deflection, speed, disturbance and log frequency ratio (-1: none) in the observer's state x."""
        n = len(effort)
        values = np.zeros(len(coefficients))
        schedule(harmonics, coefficients, x[:n], values)  # ω², 2ζω, b, gravity's push
        stretch = np.exp(x[places[3]]) if places[3] >= 0 else 1.0
        stiffness, damping = values[0] * stretch * stretch, values[1] * stretch
        force, given = values[2 + n] + x[places[2]], 0.0
        for k in range(n):
            force += values[2 + k] * acting[k]
            given += values[2 + k] * values[2 + k]
        _, _, p21, p22, _, g2 = mode_step(stiffness, damping, ahead_s)
        speed = p21 * x[places[0]] + p22 * x[places[1]] + g2 * force
        missing = max(2.0 * ratio * np.sqrt(stiffness) - damping, 0.0)
        for k in range(n):
            effort[k] = -missing * speed * values[2 + k] / given if version >= 0 else 0.0

    return against_speed


_against_speed = _compile(sources_digest(controllers.models.modal, controllers.observers.modal_equations))


class ModalDamping:
    """Active damping for the loop.

    Parameters
    ----------
    model : ModalModel
        The observer's.
    settings : DampingSettings
    adapted : sequence of int
        The observer's modes whose frequency is a state.

    Attributes
    ----------
    effort : (n_axes,) array
        To be added to the command, in the drives' units. Overwritten by every step.
    share : float
        Of the damping that is in force: 0 off, 1 all of it.

    Raises
    ------
    DesignError
        No such mode, a ratio that is none, or a mode that no drive moves.
    """

    def __init__(self, model: ModalModel, settings: DampingSettings, adapted: tuple[int, ...] = ()) -> None:
        n, modes, mode = len(model.axes), model.modes, settings.mode
        if not 0 <= mode < modes:
            raise DesignError(f"damping: mode {mode + 1}: the model has modes 1 to {modes}")
        if not 0.0 < settings.ratio <= 1.0:
            raise DesignError(f"damping ratio {settings.ratio:g}: must be above 0, and 1 at most")
        first = mode * model.mode_stride
        push = modes * model.mode_stride + n * (n + 1) + n + mode
        rows = [first, first + 1, *range(first + model.mode_stride - n, first + model.mode_stride), push]
        coefficients = np.ascontiguousarray(model.coefficients[rows], dtype=float)
        if not np.abs(coefficients[2 : 2 + n]).max() > 0.0:
            raise DesignError(f"damping: no drive moves mode {mode + 1}")
        self.settings = settings
        ratio_at = 3 * (n + modes) + adapted.index(mode) if mode in adapted else -1
        places = np.array([2 * n + mode, 2 * n + modes + mode, 3 * n + 2 * modes + mode, ratio_at], dtype=np.int64)
        ahead_s = AHEAD_SAMPLES / model.sample_rate_Hz
        self._law = (np.array(model.harmonics, dtype=np.int64), coefficients, places, ahead_s, float(settings.ratio))
        self._limit = LIMIT_SHARE * np.asarray(model.effort_limit, dtype=float)
        self._slew = SLEW * 2.0 * np.pi * float(model.frequencies_Hz(np.zeros(n))[mode]) / model.sample_rate_Hz * self._limit
        self._step = 1.0 / max(round(RAMP_s * model.sample_rate_Hz), 1)
        self._proven_rows = round(PROVEN_s * model.sample_rate_Hz)
        self._wanted = np.zeros(n)
        self._good = np.zeros(n)  # the last wanted effort that was a number
        self.effort = np.zeros(n)
        self.restart(0)

    @property
    def ramp_rows(self) -> int:
        """Rows from all of it to nothing."""
        return round(1.0 / self._step)

    def restart(self, rows: int) -> None:
        """Off; row 0 of this many follows, and in the last of them it is off again."""
        self.share = 0.0
        self.effort[:] = 0.0
        self._good[:] = 0.0
        self._proven = 0
        self._left = rows

    def law(self, state: np.ndarray, acting: np.ndarray, out: np.ndarray) -> None:
        """The command itself (n_axes,), neither limited nor ramped, from an observer's state and the command (n_axes,) on the wire."""
        _against_speed(*self._law, state, acting, out)

    def step(self, state: np.ndarray, acting: np.ndarray, is_good: bool) -> None:
        """One row.

        Parameters
        ----------
        state : (states,) array
            The observer's.
        acting : (n_axes,) array
            The command of the row before, on the wire now.
        is_good : bool
            Whether the estimate is to be acted upon. When it is not, damping ramps out and comes back a second after it is again.
        """
        self._left -= 1
        self._proven = self._proven + 1 if is_good else 0
        goal = 1.0 if self._proven > self._proven_rows and self._left > self.ramp_rows else 0.0
        self.share = min(self.share + self._step, goal) if goal > self.share else max(self.share - self._step, goal)
        self.law(state, acting, self._wanted)
        largest = 0.0
        for wanted, limit in zip(self._wanted, self._limit, strict=True):
            largest = max(largest, abs(wanted) / limit) if wanted == wanted else np.inf
        if largest < np.inf:
            change = self._wanted / max(largest, 1.0) - self._good
            self._good += np.clip(change, -self._slew, self._slew)
        np.multiply(self._good, self.share, out=self.effort)
