"""Active damping of one mode: a command against the mode's speed as an observer estimates it, ramped in and out.

With the modal model (controllers/models/modal.py) η'' + 2 ζ ω η' + ω² η = bᵀ u + d. The command of least norm that adds damping is

    u = -b / (bᵀ b) · 2 (ζ_wanted - ζ) ω · η'

A command given in row k acts from row k+1 to k+2, so η' is the mean of what the observer's model says it will be in these two rows.
Every parameter is taken at the estimated pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.compiled import exactly_compiled
from controllers.errors import DesignError
from controllers.observers.linear_part import transition
from controllers.observers.modal_equations import moving, rounded
from controllers.observers.modal_observer import ModalObserver

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


@exactly_compiled
def _against_speed(constants, scheduled, mode, ratio, x, acting, effort):  # type: ignore[no-untyped-def]
    n, speed_at = constants.sizes[0], 2 * constants.sizes[0] + constants.sizes[1] + mode
    next_row, row_after = x.copy(), x.copy()
    transition(constants, scheduled, x, acting, next_row)
    transition(constants, scheduled, next_row, acting, row_after)
    speed = 0.5 * (next_row[speed_at] + row_after[speed_at])
    stretch = 1.0
    for k in range(constants.sizes[3]):
        if constants.adapted[k] == mode:
            stretch = np.exp(x[moving(constants) + k])
    stiffness, damping, given = scheduled.modes[mode, 0] * stretch * stretch, scheduled.modes[mode, 1] * stretch, 0.0
    for k in range(n):
        given += scheduled.encoders[mode, 2 * n + k] ** 2
    missing = max(2.0 * ratio * np.sqrt(stiffness) - damping, 0.0)
    for k in range(n):
        effort[k] = -missing * speed * scheduled.encoders[mode, 2 * n + k] / given


@exactly_compiled
def _as_it_acts(constants, command, out):  # type: ignore[no-untyped-def]
    rounded(constants, command, out)


class ModalDamping:
    """Active damping for the loop.

    Parameters
    ----------
    observer : ModalObserver
        Its model, as it stands after the observer's step.
    settings : DampingSettings

    Attributes
    ----------
    effort : (n_axes,) array
        To be added to the command, in the drives' units. Overwritten by every step.
    share : float
        Of the damping that is in force: 0 off, 1 all of it.

    Raises
    ------
    DesignError
        No such mode, or a ratio that is none.
    """

    def __init__(self, observer: ModalObserver, settings: DampingSettings) -> None:
        model = observer.model
        n, modes, mode = len(model.axes), model.modes, settings.mode
        if not 0 <= mode < modes:
            raise DesignError(f"damping: mode {mode + 1}: the model has modes 1 to {modes}")
        if not 0.0 < settings.ratio <= 1.0:
            raise DesignError(f"damping ratio {settings.ratio:g}: must be above 0, and 1 at most")
        if not model.at(np.zeros(n))[(mode + 1) * model.mode_stride - n : (mode + 1) * model.mode_stride].any():
            raise DesignError(f"damping: mode {mode + 1}: no drive moves it at position zero")
        self.settings, self._observer = settings, observer
        self._limit = LIMIT_SHARE * np.asarray(model.effort_limit, dtype=float)
        self._slew = SLEW * 2.0 * np.pi * float(model.frequencies_Hz(np.zeros(n))[mode]) / model.sample_rate_Hz * self._limit
        self._step = 1.0 / max(round(RAMP_s * model.sample_rate_Hz), 1)
        self._proven_rows = round(PROVEN_s * model.sample_rate_Hz)
        self._wanted, self._acting = np.zeros(n), np.zeros(n)
        self._good = np.zeros(n)  # the last wanted effort that was a number
        self.effort = np.zeros(n)
        self.restart(0)

    @property
    def ramp_rows(self) -> int:
        """Rows from all of it to nothing."""
        return round(1.0 / self._step)

    def restart(self, rows: int) -> None:
        """Off; a plan of this many ticks begins, and in the last of them it is off again."""
        self.share = 0.0
        self.effort[:] = 0.0
        self._good[:] = 0.0
        self._proven = 0
        self._rows = rows

    def law(self, state: np.ndarray, acting: np.ndarray, out: np.ndarray) -> None:
        """The command itself (n_axes,), neither limited nor ramped, from an observer's state and the command (n_axes,) that acts."""
        _against_speed(self._observer.constants, self._observer.scheduled, self.settings.mode, self.settings.ratio, state, acting, out)

    def step(self, state: np.ndarray, acting: np.ndarray, is_good: bool, tick: int) -> None:
        """One row.

        Parameters
        ----------
        state : (states,) array
            The observer's.
        acting : (n_axes,) array
            The command of the row before, on the wire now; drives round it.
        is_good : bool
            Whether the estimate is to be acted upon. When it is not, damping ramps out and comes back a second after it is again.
        tick : int
            Of the plan: those that are lost bring its end nearer, too.
        """
        left = self._rows - 1 - tick
        self._proven = self._proven + 1 if is_good else 0
        goal = 1.0 if self._proven > self._proven_rows and left > self.ramp_rows else 0.0
        self.share = min(self.share + self._step, goal) if goal > self.share else max(self.share - self._step, goal)
        self.share = min(self.share, max(left, 0) * self._step)
        _as_it_acts(self._observer.constants, acting, self._acting)
        self.law(state, self._acting, self._wanted)
        largest = 0.0
        for wanted, limit in zip(self._wanted, self._limit, strict=True):
            largest = max(largest, abs(wanted) / limit) if wanted == wanted else np.inf
        if largest < np.inf:
            change = self._wanted / max(largest, 1.0) - self._good
            self._good += np.clip(change, -self._slew, self._slew)
        np.multiply(self._good, self.share, out=self.effort)
