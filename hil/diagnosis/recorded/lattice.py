"""Lattices: an encoder whose readings lie on steps coarser than the machine file's, seen in the recordings themselves.

Readings may have any offset from the lattice; each is then rounded once more to the encoder's own step, so that it lies within half of
that of a lattice point. On any motion that has no lattice a distinct reading does so with a probability of at most the share of the
lattice's step that these windows cover. A lattice of whole counts of the encoder has no such windows: an encoder that lost its last bit
reads even counts alone; and where a lattice between counts was rounded to them, which counts are never read says so (`digital_line.py`).
Only readings that the two before them did not foretell count as such: those of a constant speed are equally
spaced, and the first few of them say where all others lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.recorded.digital_line import step_of
from hil.diagnosis.result import READ_OFF, EffectAt, Estimate, Finding
from hil.machine import Machine
from virtual_bus.effects.places import is_prismatic
from virtual_bus.settings import EffectSetting

COARSER = 3.0
"""Where readings are no whole counts, a lattice is looked for from this many of the machine file's steps on: below, most of them lie near
its points by chance."""

LEAST_STEPS = 20
"""Changes by one step, and distinct readings, without which nothing is said."""

CHANCE = 1e-6
"""Largest probability that all unforeseen readings lie on the lattice by chance, the lattices that were tried counted."""

MATTERS = 0.2
"""Share of what repeats differ by, rms, that a lattice's rounding error has where it is named: digits of a file are lattices, too."""

WRITTEN = 1e-8
"""Share of a reading that it may be off for having been written with nine digits."""

REFINED = 8
"""Times that a lattice's step is fitted, to readings further and further out."""

NEAREST = 3.0
"""Steps to either side of the middle that the first of them looks at, at least."""


@dataclass(frozen=True)
class Lattice:
    """A channel's lattice: its step [rad or m] with its 95 % interval, and how many distinct readings lie on it."""

    step: float
    ci95: tuple[float, float]
    readings: int
    unit: str = "rad"

    def setting(self, channel: str) -> EffectSetting:
        return EffectSetting("encoder_quantization", channel, {"q": self.step})

    def finding(self, channel: str) -> Finding:
        seen = f"all {self.readings} distinct readings lie on steps of {self.step:.4g} {self.unit}"
        parameters = {"q": Estimate(self.step, self.unit, self.ci95)}
        return Finding(EffectAt("encoder_quantization", channel), READ_OFF, parameters, evidence_for=(seen,))

    def says(self, channel: str) -> str:
        return f"{channel} reads in steps of {self.step:.4g} {self.unit}"


def coarser_lattice(measured: Sequence[np.ndarray], own_step: float) -> Lattice | None:
    """The lattice of a channel.

    Parameters
    ----------
    measured : sequence of (R, N) arrays
        Repeats of every experiment; NaN where a sample is missing.
    own_step : float
        The machine file's; 0 where it has none.

    Returns
    -------
    Lattice or None
        None where readings lie neither on two counts of `own_step` or more nor, where they are no whole counts, on steps that are COARSER
        than it, or where the rounding is small against what repeats differ by.
    """
    rows = [row[np.isfinite(row)] for repeats in measured for row in repeats]
    readings = np.unique(np.concatenate(rows)) if rows else np.empty(0)
    if len(readings) < LEAST_STEPS:
        return None
    written = WRITTEN * float(np.abs(readings).max())
    numbers = np.rint((readings - readings[0]) / own_step) if own_step > 4.0 * written else np.empty(0)
    if numbers.size and np.all(np.abs(readings - readings[0] - own_step * numbers) <= 2.0 * written):
        counts = _of_counts(measured, np.unique(numbers), own_step, written)
        return counts if counts is not None and counts.step / np.sqrt(12.0) > MATTERS * _fast_spread(measured) else None
    off = 0.5 * own_step + WRITTEN * float(np.abs(readings).max())
    changes = np.concatenate([np.abs(np.diff(row)) for row in rows])
    changes = changes[changes > 2.0 * off]
    if not changes.size:
        return None
    smallest = float(changes.min())
    single = changes[changes <= smallest + 4.0 * off]  # two readings, each rounded to the encoder's own step
    step = float(single.mean())
    if step < COARSER * own_step or 2.0 * off >= 0.4 * step:
        return None
    if len(single) < LEAST_STEPS:
        return None
    fitted = _fitted(readings, step, 2.0 * off / np.sqrt(len(single)), off)
    if fitted is None:
        return None
    step, error = fitted
    windows = (4.0 * off + own_step) / step  # `_fitted` allows 2 off to either side; both ends are points of the encoder's own step
    tries = float(np.ptp(readings)) / step
    if windows > 0.0 and _unforeseen(measured, off) * np.log(windows) + np.log(max(tries, 1.0)) > np.log(CHANCE):
        return None
    differences = [repeats - np.nanmean(repeats, axis=0) for repeats in measured if len(repeats) > 1]
    if not differences:
        return None
    free = np.sqrt(np.mean([len(repeats) / (len(repeats) - 1.0) for repeats in measured if len(repeats) > 1]))
    spread = free * float(np.sqrt(np.nanmean(np.concatenate([d.ravel() for d in differences]) ** 2)))
    if step / np.sqrt(12.0) < MATTERS * spread:
        return None
    return Lattice(step, (step - 1.96 * error, step + 1.96 * error), len(readings))


def _of_counts(measured: Sequence[np.ndarray], numbers: np.ndarray, own_step: float, written: float) -> Lattice | None:
    """The lattice, of several of the encoder's own counts or rounded to them, that distinct numbers of counts lie on; None where there is
    none.
    """
    several, unforeseen = int(np.gcd.reduce(numbers.astype(np.int64))), _unforeseen(measured, written, own_step)
    if several < 2:
        return _between_counts(numbers, unforeseen, own_step)
    if (unforeseen - 1) * np.log(several) < -np.log(CHANCE):
        return None
    step = several * own_step
    error = 2.0 * written * several / float(np.ptp(numbers))
    return Lattice(step, (step - 1.96 * error, step + 1.96 * error), len(numbers))


def _between_counts(numbers: np.ndarray, unforeseen: int, own_step: float) -> Lattice | None:
    """The lattice that whole counts were rounded from: of a step of two or more, that is no whole one.

    Without one a reading lies on it with a probability of one over its step. As many lattices are tried as there are digital lines of that
    length, fewer than its cube (Mignosi 1991, Theoret. Comput. Sci. 82, 71-84).
    """
    steps = step_of(numbers)
    if steps is None or unforeseen * np.log(steps[0]) < 3.0 * np.log(np.ptp(numbers)) - np.log(CHANCE):
        return None
    low, high = own_step * steps[0], own_step * steps[1]
    return Lattice(0.5 * (low + high), (low, high), len(numbers))


def _unforeseen(measured: Sequence[np.ndarray], off: float, own_step: float = 0.0) -> int:
    """How many distinct readings, each within `off` of what was meant, were not reached at the speed of the two samples before them. Counts
    are distinct as such.
    """
    came = [(row[2:], np.abs(np.diff(row, 2)) > 4.0 * off) for repeats in measured for row in repeats]
    readings = np.concatenate([reading[is_new] for reading, is_new in came])
    return len(np.unique(np.rint((readings - readings[:1]) / own_step) if own_step else readings))


def _fast_spread(measured: Sequence[np.ndarray]) -> float:
    """What repeats differ by from sample to sample, rms, as white noise of that size would: infinite where there is none.

    A slow disturbance moves what an encoder reads, and every other sensor with it, and hides no rounding.
    """
    noise = [(repeats - repeats.mean(axis=0)) * np.sqrt(len(repeats) / (len(repeats) - 1.0)) for repeats in measured if len(repeats) > 1]
    second = [np.diff(rows, 2, axis=1) for rows in noise]
    squares = [rows[np.isfinite(rows)] ** 2 for rows in second]
    return float(np.sqrt(np.mean(np.concatenate(squares)) / 6.0)) if any(len(one) for one in squares) else np.inf


def _fitted(readings: np.ndarray, step: float, error: float, off: float) -> tuple[float, float] | None:
    """The step, and its standard error, of the lattice that all readings lie on; None where one does not.

    From the readings nearest to the middle one outwards, as far as the step is known well enough to number them.
    """
    middle = readings[len(readings) // 2]
    centred = readings - middle
    for _ in range(REFINED):
        reach = max(0.2 * step / error, NEAREST) * step
        near = centred[np.abs(centred) <= reach]
        numbers = np.rint(near / step)
        design = np.column_stack([numbers, np.ones(len(near))])
        (fitted, offset), *_ = np.linalg.lstsq(design, near, rcond=None)
        spread = np.sqrt(np.sum((numbers - numbers.mean()) ** 2))
        if spread == 0.0:
            return None
        step = float(fitted)
        left = near - step * numbers - offset
        if float(np.abs(left).max()) > 2.0 * off + 1e-12:
            return None
        error = max(float(np.sqrt(np.mean(left**2))) / spread, off / float(np.ptp(numbers)))  # rounding may lean one way all along
        if len(near) == len(centred):
            break
    else:
        return None
    return step, error


def coarser_lattices(machine: Machine, channels: Sequence[str], measured: Sequence[np.ndarray]) -> dict[str, Lattice]:
    """Of all encoders among the channels, from (R, N, C) arrays."""
    found = {}
    for encoder in machine.plant.encoders:
        if encoder.channel in channels:
            column = channels.index(encoder.channel)
            lattice = coarser_lattice([rows[:, :, column] for rows in measured], encoder.resolution)
            if lattice is not None:
                unit = "m" if is_prismatic(encoder.channel, machine.plant) else "rad"
                found[encoder.channel] = replace(lattice, unit=unit)
    return found


def with_lattices(machine: Machine, lattices: dict[str, Lattice], repeats: int) -> Machine:
    """The machine with these lattices, as far as noise is asked.

    Repeats of one motion share their rounding errors, which their mean keeps.
    """
    encoders = tuple(
        replace(encoder, resolution=repeats**0.5 * lattices[encoder.channel].step) if encoder.channel in lattices else encoder
        for encoder in machine.plant.encoders
    )
    return replace(machine, plant=replace(machine.plant, encoders=encoders))
