"""Random-phase multisines under jog, the experiment for identifying frequency responses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from controllers.errors import DesignError
from controllers.excitation_lines import Band, checked_lines
from controllers.hadamard_experiments import Mixing
from controllers.jog import odd_even_split
from controllers.multisine import Phases, multisine
from hil.errors import ExperimentError
from hil.experiments.jog import Jog
from hil.experiments.metadata import experiment_metadata
from hil.experiments.plan import Plan, axis_indices, check_duration, check_periods, period_in_samples, pose_array
from hil.experiments.safety import Safety
from hil.machine import Machine


@dataclass(frozen=True)
class Multisine:
    """Periodic excitation of one or several axes around one pose. Thesis Sec. 3.3.

    Parameters
    ----------
    pose : mapping
        Start position by axis name [rad or m]; axes left out stand at zero.
    axes : tuple of str
        Excited axes; empty: all.
    experiments : "orthogonal" or "single"
        As many experiments as axes: all axes at once, mixed orthogonally, or one axis at a time.
    lines : tuple of int, or Band
        Harmonics of the base period. A band leaves the jog's line out; explicit lines must not name it.
    weights : tuple of float, optional
        Relative amplitude per line of an explicit choice; flat when left out.
    amplitude_A : float or mapping
        Rms of the excitation of an axis while it is excited, one for all or by axis, in the drive's unit (A, unless it is V, Nm or N).
    period_s : float
        Base period; the lines are 1/period_s apart.
    periods, settle_periods : int
        Periods kept, and periods before them in which transients die out.
    realisations : int
        Draws of the phases.
    phases : "random" or "optimised"
        "optimised" lowers the crest factor to about 1.6, for single realisations; see `controllers.multisine`.
    jog : Jog or None
    seed : int

    Examples
    --------
    The C-arm has two axes, so that a realisation has two experiments; a period of 20 s at 256 Hz has 5120 rows.

    >>> import hil
    >>> plans = hil.Multisine(period_s=20.0, periods=2, settle_periods=1).plans(hil.open_machine("carm"))
    >>> len(plans), plans[0].rows == 3 * 5120
    (2, True)
    """

    pose: Mapping[str, float] = field(default_factory=dict)
    axes: tuple[str, ...] = ()
    experiments: Mixing = "orthogonal"
    lines: tuple[int, ...] | Band = field(default_factory=Band)
    weights: tuple[float, ...] | None = None
    amplitude_A: float | Mapping[str, float] = 0.8
    period_s: float = 20.0
    periods: int = 10
    settle_periods: int = 1
    realisations: int = 1
    phases: Phases = "random"
    jog: Jog | None = field(default_factory=Jog)
    seed: int = 0

    def plans(self, machine: Machine) -> list[Plan]:
        """Make one plan per realisation and experiment, experiments first."""
        try:
            return self._plans(machine)
        except DesignError as error:
            raise ExperimentError(f"multisine: {error}") from None

    def _plans(self, machine: Machine) -> list[Plan]:
        check_periods(self.settle_periods, self.periods)
        if self.realisations < 1:
            raise ExperimentError(f"multisine: realisations = {self.realisations}: must be at least 1")
        pose = pose_array(machine, self.pose)
        excited = axis_indices(machine, self.axes)
        rms = self._rms(machine, excited)
        period_samples = period_in_samples(machine, self.period_s)
        repeats = self.settle_periods + self.periods
        recordings = self.realisations * len(excited)
        check_duration(
            "multisine",
            recordings * repeats * self.period_s,
            f"{recordings} recordings of {repeats} periods of {self.period_s:g} s",
        )
        jog_on_line = None if self.jog is None else self.jog.on_line(machine, period_samples)
        lines = self._lines(machine, period_samples, jog_on_line)
        split, reason = odd_even_split(lines, jog_on_line)
        why_not = (reason,) if reason else ()
        deviation = np.zeros((repeats * period_samples, len(pose)))
        jog_table = {}
        if self.jog is not None:
            deviation = self.jog.motion(machine, self.axes, period_samples, self.settle_periods, self.periods)
            jog_table = self.jog.described(machine, self.axes, period_samples)
        reference = pose + deviation
        safety = Safety(machine, pose)
        safety.check_reference("multisine", reference, "" if self.settle_periods else "; with settle_periods = 1 the jog grows in slowly")
        drawn = [
            multisine(
                lines,
                rms,
                period_samples,
                mixing=self.experiments,
                weights=None if self.weights is None else np.array(self.weights),
                seed=self.seed,
                realisation=realisation,
                phases=self.phases,
            )
            for realisation in range(self.realisations)
        ]
        periods = np.zeros((self.realisations, len(excited), period_samples, len(pose)))
        periods[..., excited] = [each.signals.transpose(0, 2, 1) for each in drawn]
        asked = None if isinstance(self.amplitude_A, Mapping) else float(self.amplitude_A)
        peaks = safety.check_periodic("multisine", deviation[-period_samples:], list(periods.reshape(-1, *periods.shape[2:])), asked)
        plans: list[Plan] = []
        for realisation, experiment in np.ndindex(periods.shape[:2]):
            crest, amplitude = np.zeros(len(pose)), np.zeros(len(pose))
            crest[excited] = drawn[realisation].crest_factor[experiment]
            amplitude[excited] = np.where(crest[excited] > 0.0, rms, 0.0)
            metadata = experiment_metadata(
                "multisine",
                period_samples=period_samples,
                settle_periods=self.settle_periods,
                periods=self.periods,
                start_pose=pose,
                realisation=realisation,
                realisations=self.realisations,
                experiment=experiment,
                experiments=len(excited),
                excited_lines=lines,
                seed=self.seed,
                amplitude=amplitude,
                crest_factor=crest,
                jog=jog_table,
                odd_even_split=split,
            )
            excitation = np.tile(periods[realisation, experiment], (repeats, 1))
            plans.append(safety.plan(reference, excitation, pose, metadata, (peaks[len(plans)], *why_not)))
        return plans

    def _rms(self, machine: Machine, excited: np.ndarray) -> np.ndarray:
        """Return the amplitude per excited axis."""
        names = [machine.axes[index] for index in excited]
        if not isinstance(self.amplitude_A, Mapping):
            return np.full(len(names), float(self.amplitude_A))
        if set(self.amplitude_A) != set(names):
            raise ExperimentError(f"multisine: amplitudes are given for {', '.join(self.amplitude_A)}; excited are {', '.join(names)}")
        return np.array([float(self.amplitude_A[name]) for name in names])

    def _lines(self, machine: Machine, period_samples: int, jog_on_line: int | None) -> np.ndarray:
        if isinstance(self.lines, Band):
            if self.weights is not None:
                raise ExperimentError("multisine: weights go with explicit lines, not with a band")
            lines = self.lines.lines(period_samples, machine.sample_rate_Hz, self.seed)
            return lines if jog_on_line is None else lines[lines != jog_on_line]
        lines = checked_lines(self.lines, period_samples)
        if jog_on_line is not None and jog_on_line in lines:
            raise ExperimentError(f"multisine: line {jog_on_line} carries the jog; leave it out of the excited lines")
        return lines
