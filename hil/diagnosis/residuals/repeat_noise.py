"""Noise of a set of recordings, from what repeats of an experiment differ by: no physics is left in it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.observed.groups import Group
from hil.diagnosis.residuals.equation_errors import EquationErrors, Levels, default_levels, equation_errors
from hil.diagnosis.residuals.narrow_band import tones_in
from hil.diagnosis.residuals.noise_likelihood import levels_from
from hil.diagnosis.residuals.noise_spectrum import colour_of, loudness_of
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.residuals.whitening import Whitening

CORNERS_Hz = (0.04, 0.2, 1.0, 5.0, 30.0)
"""Of the disturbances' spectrum; the likeliest one is taken."""
FINEST = 0.05
"""Share of a sensor's noise by the machine file that its own noise is at least: less would be a share of one step of its lattice."""
HIDDEN = 0.5
"""Share of an innovation's precision that a lattice leaves, below which it hides the noise."""
BEGUN = 0.002
"""Share of what a drive can give at most, as the disturbances' first level."""


def repeat_levels(groups: Sequence[Group], trajectories: Sequence[Trajectory], values: np.ndarray | None = None) -> Levels | None:
    """Return the noise of the groups' means, from what repeats of a machine with these numbers differ by; None where there are none.

    Where an incremental encoder's zero differs from repeat to repeat, that is no noise.
    """
    parts = [
        part
        for group, trajectory in zip(groups, trajectories, strict=True)
        if len(group.repeats) > 1
        for part in _differences(group, trajectory, values)
    ]
    if not parts:
        return None
    begin = default_levels(trajectories[0])
    lowest = FINEST * begin.sensors
    first = np.full(len(begin.disturbance), BEGUN * max(_largest_effort(trajectories[0]), 1e-9))
    found, likely = max(
        (levels_from(parts, Levels(first, corner, begin.sensors), lowest) for corner in CORNERS_Hz), key=lambda each: each[1]
    )
    found = _with_tones(parts, found, likely, lowest, first)
    count = min(len(group.repeats) for group in groups)  # what was recorded once has all of a recording's noise
    variance, lattice = found.sensors**2, _lattices(trajectories[0]) ** 2
    hidden = _hidden(parts[0][0], found, replace(found, sensors=np.sqrt(np.maximum(variance, lattice))))
    loudness: dict[str, np.ndarray] = {}
    even = []
    for one, same in itertools.groupby(parts, key=lambda part: part[0]):
        filtered, name = one.whitening(found), one.trajectory.observed.name
        own = [_innovations(part, filtered) for part in same]
        loudness[name] = np.where(hidden, 1.0, loudness_of(own))  # repeats do not show what a lattice hides
        even += [each / loudness[name] for each in own]
    colour = colour_of(even)
    colour[hidden] = np.eye(1, colour.shape[1])
    single = replace(found, lattice=np.sqrt(lattice))
    return replace(found, colour=colour, loudness=loudness, single=single).of(count)


def _with_tones(
    parts: Sequence[tuple[EquationErrors, np.ndarray, np.ndarray, np.ndarray]],
    found: Levels,
    likely: float,
    lowest: np.ndarray,
    first: np.ndarray,
) -> Levels:
    """Return levels with tones of the driven joints, where they are likelier by more than their numbers (Akaike 1974)."""
    trajectory = parts[0][0].trajectory
    filters = {one: one.whitening(found) for one in {id(part[0]): part[0] for part in parts}.values()}
    own = [(filters[part[0]], _innovations(part, filters[part[0]])) for part in parts]
    driven = [trajectory.joints.index(drive.joint) for drive in trajectory.settings.drives]
    tones = tones_in(own, driven, first, trajectory.observed.period_s)
    if tones is None:
        return found
    other, likelier = levels_from(parts, replace(found, tones=tones), lowest)
    return other if likelier - likely > tones.numbers else found


def _hidden(one: EquationErrors, shown: Levels, with_lattices: Levels) -> np.ndarray:
    """Return whose innovations (m + axes,) lattices, which do not show in what repeats differ by, make larger by half or more."""
    without, those = (np.einsum("kcc->kc", one.whitening(levels).roots) ** 2 for levels in (shown, with_lattices))
    hidden: np.ndarray = those.mean(axis=0) < HIDDEN * without.mean(axis=0)
    return hidden


def _innovations(part: tuple[EquationErrors, np.ndarray, np.ndarray, np.ndarray], filtered: Whitening) -> np.ndarray:
    one, missing, ends, left = part
    return replace(one, missing=missing, missing_ends=ends, left=left).whitened(filtered)


def _differences(
    group: Group, trajectory: Trajectory, values: np.ndarray | None
) -> list[tuple[EquationErrors, np.ndarray, np.ndarray, np.ndarray]]:
    """Return what each repeat differs from the mean by, scaled to one recording's noise, beside the equations with these numbers."""
    own = deviations(group, trajectory, values)
    scale = np.sqrt(len(own) / (len(own) - 1.0))
    return [(each.equations, scale * each.given, scale * each.given, scale * each.left) for each in own[1:]]  # the first follows from them


@dataclass(frozen=True, eq=False)
class Deviation:
    """What a repeat differs from the mean of all by.

    Attributes
    ----------
    equations : EquationErrors
        The mean beside the equations.
    given : (N, n) array
        Efforts.
    left : (N, m + axes) array
        Readings and measured currents.
    """

    equations: EquationErrors
    given: np.ndarray
    left: np.ndarray

    def innovations(self, filtered: Whitening) -> np.ndarray:
        """Return its innovations (N (m + axes),)."""
        one = replace(self.equations, missing=self.given, missing_ends=self.given, left=self.left)
        return one.whitened(filtered).reshape(-1)


def deviations(group: Group, trajectory: Trajectory, values: np.ndarray | None = None) -> list[Deviation]:
    """Return what each repeat of a group differs from the mean by; none where there is one recording."""
    if len(group.repeats) < 2:
        return []
    one = equation_errors(trajectory, values)
    own = []
    for repeat in group.repeats:
        signals = trajectory.of(repeat).signals(one.base, one.model, (), one.imus)
        own.append((signals.given, np.hstack([repeat.readings, trajectory.of(repeat).measured_currents - signals.currents])))
    zeros = {encoder.channel for encoder in trajectory.settings.encoders if not encoder.absolute}
    for c, channel in enumerate(trajectory.observed.channels):
        if channel in zeros:
            for _, readings in own:
                readings[:, c] -= np.nanmean(readings[:, c])
    given, left = (np.mean([each[k] for each in own], axis=0) for k in range(2))
    return [Deviation(one, g - given, r - left) for g, r in own]


def _largest_effort(trajectory: Trajectory) -> float:
    return max(
        (drive.limit * drive.ratio * drive.constant for drive in trajectory.settings.drives if np.isfinite(drive.limit)), default=0.0
    )


def _lattices(trajectory: Trajectory) -> np.ndarray:
    """Return the standard deviations of rounding (m + axes,) of encoders and speed sensors."""
    steps = {sensor.channel: sensor.resolution for sensor in trajectory.settings.joint_sensors}
    own = [steps.get(channel, 0.0) for channel in trajectory.observed.channels] + [0.0] * len(trajectory.settings.drives)
    steps_each = np.array(own)
    return steps_each / float(np.sqrt(12.0))
