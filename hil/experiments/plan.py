"""A plan: every row of one recording, known before the loop starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from controllers.edge_units import at_the_edge
from hil.errors import ExperimentError
from hil.machine import Machine

LONGEST_S = 86400.0
"""Of all recordings of a jog, multisine, scan or tour together: a plan holds every row in memory. `Static` has a wider bound of its own."""


@dataclass(frozen=True)
class Plan:
    """The reference, excitation and feedforward of one recording.

    Attributes
    ----------
    axes : tuple of str
        The machine's axes; columns of all arrays.
    reference, reference_raw : (N, n_axes) arrays
        After and before any shaper [rad or m].
    excitation : (N, n_axes) array
        w, in the drives' units.
    feedforward : (N, n_axes) array or None
        None where no axis asks for gravity feedforward.
    start_pose : (n_axes,) array
        Position of the machine at standstill before row 0.
    metadata : dict
        Metadata of the experiment for the recording; plain values that TOML can hold.
    notes : tuple of str
        Notes for the operator: predicted peaks, a forfeited odd/even split.
    """

    axes: tuple[str, ...]
    reference: np.ndarray
    reference_raw: np.ndarray
    excitation: np.ndarray
    feedforward: np.ndarray | None
    start_pose: np.ndarray
    metadata: dict[str, Any]
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        """Check that the arrays fit each other."""
        shape = (len(self.reference), len(self.axes))
        for name in ("reference", "reference_raw", "excitation", "feedforward", "start_pose"):
            values = getattr(self, name)
            if values is None:
                continue
            expected = (len(self.axes),) if name == "start_pose" else shape
            if values.shape != expected or not np.isfinite(values).all():
                raise ExperimentError(f"plan: {name} must be finite and of shape {expected}, has {values.shape}")
            values.setflags(write=False)

    @property
    def rows(self) -> int:
        """Number of ticks."""
        return len(self.reference)


class Experiment(Protocol):
    """An experiment that can be planned on a machine."""

    def plans(self, machine: Machine) -> list[Plan]:
        """Make one plan per recording.

        Raises
        ------
        ExperimentError
            The experiment cannot or must not be run on this machine; the message says what would be right.
        """


def pose_array(machine: Machine, pose: Mapping[str, float]) -> np.ndarray:
    """Return positions (n_axes,) from a table by axis name; axes left out stand at zero."""
    _known_axes(machine, pose, "pose")
    values = np.array([float(pose.get(axis, 0.0)) for axis in machine.axes])
    for position, limit in zip(values, machine.limits, strict=True):
        if not limit.lower <= position <= limit.upper:
            allowed = f"{at_the_edge(limit.lower, limit.unit)} to {at_the_edge(limit.upper, limit.unit)}"
            raise ExperimentError(f"pose: {limit.axis} = {at_the_edge(position, limit.unit)} is outside {allowed}")
    return values


def axis_indices(machine: Machine, axes: tuple[str, ...]) -> np.ndarray:
    """Return the columns of the named axes in machine order; all of them when none is named."""
    _known_axes(machine, axes, "axes")
    return np.array([index for index, axis in enumerate(machine.axes) if not axes or axis in axes])


def period_in_samples(machine: Machine, period_s: float) -> int:
    """Return the base period in samples.

    Raises
    ------
    ExperimentError
        It is not a whole number of samples; the message names the nearest one.
    """
    samples = period_s * machine.sample_rate_Hz
    if not 4.0 <= samples < np.inf:
        raise ExperimentError(f"period_s = {period_s:g}: must hold at least 4 samples at {machine.sample_rate_Hz:g} Hz")
    if abs(samples - round(samples)) > 1e-6:
        nearest = round(samples) / machine.sample_rate_Hz
        raise ExperimentError(
            f"period_s = {period_s:.10g}: {samples:.6g} samples at {machine.sample_rate_Hz:g} Hz; {nearest:.10g} s holds whole ones"
        )
    return round(samples)


def check_periods(settle_periods: int, periods: int) -> None:
    """Require at least one period to keep and no negative number of settling periods."""
    if periods < 1:
        raise ExperimentError(f"periods = {periods}: must be at least 1")
    if settle_periods < 0:
        raise ExperimentError(f"settle_periods = {settle_periods}: must not be negative")


def check_duration(experiment: str, least_s: float, settings: str) -> None:
    """Require that an experiment takes a day at most, before its rows are made.

    Parameters
    ----------
    experiment : str
        Its kind.
    least_s : float
        What all of its recordings take at least [s].
    settings : str
        What makes it as long, in words.

    Raises
    ------
    ExperimentError
        It takes longer.
    """
    if not least_s <= LONGEST_S:
        raise ExperimentError(f"{experiment}: takes {least_s:.3g} s at least with {settings}: a day at most")


def _known_axes(machine: Machine, names: Mapping[str, Any] | tuple[str, ...], what: str) -> None:
    for name in names:
        if name not in machine.axes:
            raise ExperimentError(f"{what}: {machine.name} has no axis {name!r}; it has {', '.join(machine.axes)}")
