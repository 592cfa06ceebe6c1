"""Frequencies of base motions by the matched filter: what every frequency would do to the recordings, beside what they show.

The strongest lines of what is missing at a joint are those of the noise where that is slow or narrow: of a base motion 31 deviations long
beside a delay, none of them may be its own. Here every frequency acts on its joint, goes through the linear closed loop and counts in units
of noise, as the orders of waves do (`filtered_orders.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.ndimage
import scipy.signal

from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.shape_limits import SLOWEST_BASE_MOTION_Hz
from hil.diagnosis.starting.start_frequencies import LINES_AROUND
from hil.diagnosis.starting.through_the_loop import ThroughTheLoop, from_rest
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.places import joint_at
from virtual_bus.effects.registry import effects

FINER = 4
"""Frequencies per line of all records together: between two of them a sine keeps 0.95 of its energy."""

HIGHEST_SHARE = 0.25
"""Of the sample rate, up to which frequencies are looked at."""

ASKED = 6
"""Frequencies that stand out most, which are asked with re-tuning taken out."""

STARTS = 2
"""Of the largest energy, that fits may start from."""


@dataclass(frozen=True, eq=False)
class _Record:
    """Of one group: when its rows are, and when the repeats that it is the mean of began, which a sine of this clock tells apart."""

    time_s: np.ndarray
    starts_s: np.ndarray

    def mean_of(self, wave: Callable[[np.ndarray], np.ndarray], frequency_Hz: float) -> np.ndarray:
        """(N,) of a wave of 2 pi f t over the repeats, begun from rest."""
        each = [wave(2.0 * np.pi * frequency_Hz * (self.time_s + start)) for start in self.starts_s]
        return from_rest(np.mean(each, axis=0))


def line_starts(
    loop: ThroughTheLoop, tuning: Tuning, candidate: Candidate, motions: Sequence[Motion], behind: Sequence[np.ndarray], left: np.ndarray
) -> list[np.ndarray]:
    """(parameters,) of base motions at the frequencies of the largest energy, the largest first.

    Parameters
    ----------
    loop : ThroughTheLoop
    tuning : Tuning
        Without effects.
    candidate : Candidate
        A base motion.
    motions : sequence of Motion
        Of every training group, beside what was found.
    behind : sequence of (N, joints + axes) arrays
        The residual taken back through the loop (`ThroughTheLoop.efforts_behind`).
    left : (M + F,) array
        The residual with re-tuning taken out.
    """
    machine = motions[0].machine
    rate_Hz, joints = machine.sample_rate_Hz, [joint.name for joint in machine.plant.tree.joints]
    joint = joints.index(joint_at(candidate.effect.at, machine.plant))
    records = [_record(motion) for motion in motions]
    ends = [one.starts_s.max() + one.time_s[-1] for one in records]
    step_Hz = 1.0 / (max(ends) - min(one.starts_s.min() for one in records)) / FINER
    frequencies = np.arange(SLOWEST_BASE_MOTION_Hz, HIGHEST_SHARE * rate_Hz, step_Hz)
    if len(frequencies) < 2:
        return []
    power = np.abs(_products(records, [own[:, joint] for own in behind], frequencies)) ** 2
    around = scipy.ndimage.median_filter(power, FINER * LINES_AROUND, mode="nearest")
    asked: list[float] = []
    for k in np.argsort(-power / np.maximum(around, 1e-300)):
        if all(abs(frequencies[k] - other) > FINER * step_Hz for other in asked):
            asked.append(float(frequencies[k]))
        if len(asked) == ASKED:
            break
    scored = [_filtered(loop, tuning, joint, records, frequency, left) for frequency in asked]
    return [_values(candidate, *line) for _, *line in sorted(scored, key=lambda one: -one[0])[:STARTS]]


def _record(motion: Motion) -> _Record:
    rate_Hz, windows = motion.machine.sample_rate_Hz, motion.group.windows
    return _Record(np.arange(len(motion.group.time_s)) / rate_Hz, np.array([window.start / rate_Hz for window in windows]))


def _products(records: Sequence[_Record], efforts: Sequence[np.ndarray], frequencies: np.ndarray) -> np.ndarray:
    """(K,) complex, of efforts (N,) with exp(-2 pi i f t) of every frequency; frequencies in equal steps.

    Not of the first row, which in an effort taken back stands for what acted before the record.
    """
    total = np.zeros(len(frequencies), dtype=complex)
    ends = [float(frequencies[0]), float(frequencies[-1])]
    for record, effort in zip(records, efforts, strict=True):
        rate_Hz = 1.0 / record.time_s[1]
        lines = scipy.signal.zoom_fft(from_rest(effort), ends, len(frequencies), fs=rate_Hz, endpoint=True)
        total += lines * np.exp(-2j * np.pi * np.outer(record.starts_s, frequencies)).mean(axis=0)
    return total


def _filtered(
    loop: ThroughTheLoop, tuning: Tuning, joint: int, records: Sequence[_Record], frequency_Hz: float, left: np.ndarray
) -> tuple[float, float, float, float]:
    """The residual's energy along a sine of this frequency, that frequency, and the amplitude and the phase of A sin(2 pi f t + phi)."""
    waves = [[(joint, record.mean_of(wave, frequency_Hz)) for wave in (np.sin, np.cos)] for record in records]
    responses = Projection.of(tuning).left(loop.responses(waves))
    products = responses @ left
    sine, cosine = np.linalg.lstsq(responses @ responses.T, products, rcond=None)[0]
    return float(np.dot((sine, cosine), products)), frequency_Hz, float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))


def _values(candidate: Candidate, frequency_Hz: float, amplitude: float, phase: float) -> np.ndarray:
    named = {"A": amplitude, "f": frequency_Hz, "phi": phase}
    return np.array([np.clip(named[p.name], p.low, p.high) for p in effects()[candidate.effect.effect].parameters])
