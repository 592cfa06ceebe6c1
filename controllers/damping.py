"""Active damping of one mode: a command against the mode's estimated speed, ramped in and out.

With the modal model (controllers/models/modal.py) η'' + 2 ζ ω η' + ω² η = bᵀ u + d. The command of least norm that adds damping is

    u = -b / (bᵀ b) · 2 (ζ_wanted - ζ) ω · η'

A command given in row k acts from row k+1 to k+2, so η' is the mean of what the observer's model says it will be in these two rows.
Every parameter is evaluated at the estimated pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controllers.bound import Bound, bound
from controllers.compiled import exactly_compiled
from controllers.errors import DesignError
from controllers.observers.linear_part import transition
from controllers.observers.modal_equations import Constants, Scheduled, moving, rounded
from controllers.observers.modal_observer import ModalObserver

RAMP_s = 0.5
"""Duration of the ramp from zero to full damping and back: four periods of an 8 Hz mode, so that the ramp itself excites nothing."""

PROVEN_s = 1.0
"""An estimate must have been good for this long before damping acts on it."""

LIMIT_SHARE = 0.25
"""Share of a drive's limit that damping may use; the rest belongs to the position loop."""

SLEW = 1.5
"""The command changes no faster than a full swing at this multiple of the mode's frequency at position zero: a jump is no vibration."""


@dataclass(frozen=True)
class DampingSettings:
    """Settings of active damping.

    Parameters
    ----------
    ratio : float
        Damping ratio that the mode shall have, as far as this command alone decides it.
    mode : int
        Index of the mode in the model, from 0.
    """

    ratio: float
    mode: int = 0


@exactly_compiled
def _against_speed(
    constants: Constants, scheduled: Scheduled, mode: int, ratio: float, x: np.ndarray, acting: np.ndarray, effort: np.ndarray
) -> None:
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


class Law(NamedTuple):
    """What the compiled step of a damping needs, and what it keeps from row to row."""

    mode: int
    ratio: float
    limit: np.ndarray  # (axes,)
    slew: np.ndarray  # (axes,)
    acting: np.ndarray  # (axes,): the command that acts, as the drives round it
    wanted: np.ndarray  # (axes,)
    good: np.ndarray  # (axes,): the last wanted effort that was finite, limited
    effort: np.ndarray  # (axes,)


@exactly_compiled
def _damped(of: Bound, x: np.ndarray, command: np.ndarray, share: float) -> None:
    """Write the effort of a row: the law's, within limit and slew rate, times the share in force.

    `of` binds constants, scheduled model and law. An effort that is not finite leaves the last one that was.
    """
    constants, scheduled, law = of.held
    rounded(constants, command, law.acting)
    _against_speed(constants, scheduled, law.mode, law.ratio, x, law.acting, law.wanted)
    largest = 0.0
    for k in range(len(law.wanted)):
        if law.wanted[k] != law.wanted[k]:
            largest = np.inf
        elif abs(law.wanted[k]) / law.limit[k] > largest:
            largest = abs(law.wanted[k]) / law.limit[k]
    for k in range(len(law.wanted)):
        if largest < np.inf:
            change = law.wanted[k] / max(largest, 1.0) - law.good[k]
            law.good[k] += min(max(change, -law.slew[k]), law.slew[k])
        law.effort[k] = law.good[k] * share


class ModalDamping:
    """Active damping as the sample loop runs it.

    Parameters
    ----------
    observer : ModalObserver
        Its model is used as it stands after the observer's step.
    settings : DampingSettings

    Attributes
    ----------
    effort : (n_axes,) array
        Added to the command, in the drives' units. Overwritten by every step.
    share : float
        Share of the damping in force: 0 is off, 1 is all of it.

    Raises
    ------
    DesignError
        The mode does not exist, no drive moves it at position zero, or the ratio is out of range.
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
        limit = LIMIT_SHARE * np.asarray(model.effort_limit, dtype=float)
        slew = SLEW * 2.0 * np.pi * float(model.frequencies_Hz(np.zeros(n))[mode]) / model.sample_rate_Hz * limit
        self._law = Law(mode, float(settings.ratio), limit, slew, np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n))
        self._bound = bound((observer.constants, observer.scheduled, self._law))
        self.effort = self._law.effort
        self._step = 1.0 / max(round(RAMP_s * model.sample_rate_Hz), 1)
        self._proven_rows = round(PROVEN_s * model.sample_rate_Hz)
        self.restart(0)

    @property
    def ramp_rows(self) -> int:
        """Rows of the ramp from full damping to zero."""
        return round(1.0 / self._step)

    def restart(self, rows: int) -> None:
        """Switch off for the start of a plan of `rows` ticks; damping is off again in the last of them."""
        self.share = 0.0
        self.effort[:] = 0.0
        self._law.good[:] = 0.0
        self._proven = 0
        self._rows = rows

    def law(self, state: np.ndarray, acting: np.ndarray, out: np.ndarray) -> None:
        """Write the command (n_axes,), neither limited nor ramped, for an observer's state and the command (n_axes,) that acts."""
        _against_speed(self._observer.constants, self._observer.scheduled, self.settings.mode, self.settings.ratio, state, acting, out)

    def step(self, state: np.ndarray, acting: np.ndarray, is_good: bool, tick: int) -> None:
        """Compute `effort` for one row.

        Parameters
        ----------
        state : (states,) array
            State of the observer.
        acting : (n_axes,) array
            The command of the row before, which is on the wire; drives round it.
        is_good : bool
            Whether damping may act on the estimate. When it may not, damping ramps out, and returns once the estimate has been good for
            `PROVEN_s`.
        tick : int
            Tick of the plan. Lost ticks count too: they bring the end nearer.
        """
        left = self._rows - 1 - tick
        self._proven = self._proven + 1 if is_good else 0
        goal = 1.0 if self._proven > self._proven_rows and left > self.ramp_rows else 0.0
        self.share = min(self.share + self._step, goal) if goal > self.share else max(self.share - self._step, goal)
        self.share = min(self.share, max(left, 0) * self._step)
        _damped(self._bound, state, acting, self.share)
