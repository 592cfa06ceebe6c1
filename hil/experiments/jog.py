"""Jog mode, alone or under a multisine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from controllers.errors import DesignError
from controllers.jog import jog, jog_line
from hil.errors import ExperimentError
from hil.experiments.metadata import experiment_metadata
from hil.experiments.plan import Plan, axis_indices, check_duration, check_periods, period_in_samples, pose_array
from hil.experiments.safety import Safety
from hil.machine import Machine


@dataclass(frozen=True)
class Jog:
    """A slow sine on the reference that keeps axes out of stick-slip.

    Thesis Sec. 3.3, corrected: 20 s base period, line 1.

    Parameters
    ----------
    amplitude_rad : float
        2 degrees unless given (m on a prismatic axis).
    line : int, optional
        Harmonic of the base period.
    frequency_Hz : float, optional
        Instead of `line`; 0.05 Hz when neither is given.
    turn_share : float
        Share of each way that the turn takes; between turns the speed is constant. 1, a sine, unless given.
    axes : tuple of str
        Axes that jog; empty: all axes of the experiment.
    """

    amplitude_rad: float = np.radians(2.0)
    line: int | None = None
    frequency_Hz: float | None = None
    turn_share: float = 1.0
    axes: tuple[str, ...] = ()

    def on_line(self, machine: Machine, period_samples: int) -> int:
        """Return the line of the jog on this base period.

        Raises
        ------
        ExperimentError
            The frequency is off the grid, or both line and frequency are given.
        """
        if self.line is not None and self.frequency_Hz is not None:
            raise ExperimentError(f"jog: line = {self.line} and frequency_Hz = {self.frequency_Hz:g} are both given; give one")
        if self.line is not None:
            return self.line
        try:
            return jog_line(0.05 if self.frequency_Hz is None else self.frequency_Hz, period_samples, machine.sample_rate_Hz)
        except DesignError as error:
            raise ExperimentError(str(error)) from None

    def motion(self, machine: Machine, axes: tuple[str, ...], period_samples: int, settle_periods: int, periods: int) -> np.ndarray:
        """Return the deviation from the start pose, (N, n_axes); `axes` jog unless the jog names its own.

        Raises
        ------
        ExperimentError
            The line is not one of the period, or the turns' share is none.
        """
        if not (np.isfinite(self.amplitude_rad) and self.amplitude_rad > 0.0):
            raise ExperimentError(f"jog: amplitude_rad = {self.amplitude_rad:g}: must be positive")
        try:
            line = self.on_line(machine, period_samples)
            sine = jog(self.amplitude_rad, line, period_samples, settle_periods, periods, self.turn_share)
        except DesignError as error:
            raise ExperimentError(str(error)) from None
        deviation = np.zeros((len(sine), len(machine.axes)))
        deviation[:, axis_indices(machine, self.axes or axes)] = sine[:, None]
        return deviation

    def described(self, machine: Machine, axes: tuple[str, ...], period_samples: int) -> dict[str, object]:
        """Return the table for a recording's metadata."""
        line = self.on_line(machine, period_samples)
        return {
            "axes": [machine.axes[i] for i in axis_indices(machine, self.axes or axes)],
            "amplitude_rad": float(self.amplitude_rad),
            "line": line,
            "frequency_Hz": line * machine.sample_rate_Hz / period_samples,
            **({} if self.turn_share == 1.0 else {"turn_share": float(self.turn_share)}),
        }


@dataclass(frozen=True)
class JogOnly:
    """An experiment with the jog alone, for friction and backlash.

    Parameters
    ----------
    pose : mapping
        Start position by axis name [rad or m]; axes left out stand at zero.
    axes : tuple of str
        Axes that jog; empty: all.
    jog : Jog
    period_s : float
    periods, settle_periods : int
        Periods kept, and periods before them for settling.
    """

    pose: Mapping[str, float] = field(default_factory=dict)
    axes: tuple[str, ...] = ()
    jog: Jog = field(default_factory=Jog)
    period_s: float = 20.0
    periods: int = 3
    settle_periods: int = 1

    def plans(self, machine: Machine) -> list[Plan]:
        """Make the one plan of this experiment."""
        check_periods(self.settle_periods, self.periods)
        pose = pose_array(machine, self.pose)
        period_samples = period_in_samples(machine, self.period_s)
        repeats = self.settle_periods + self.periods
        check_duration("jog", repeats * self.period_s, f"{repeats} periods of {self.period_s:g} s")
        deviation = self.jog.motion(machine, self.axes, period_samples, self.settle_periods, self.periods)
        reference = pose + deviation
        safety = Safety(machine, pose)
        safety.check_reference("jog", reference, "" if self.settle_periods else "; with settle_periods = 1 the jog grows in slowly")
        peaks = safety.check_periodic("jog", deviation[-period_samples:], [np.zeros((period_samples, len(pose)))])
        metadata = experiment_metadata(
            "jog",
            period_samples=period_samples,
            settle_periods=self.settle_periods,
            periods=self.periods,
            start_pose=pose,
            jog=self.jog.described(machine, self.axes, period_samples),
            odd_even_split=self.jog.on_line(machine, period_samples) % 2 == 1,
        )
        return [safety.plan(reference, np.zeros_like(reference), pose, metadata, tuple(peaks))]
