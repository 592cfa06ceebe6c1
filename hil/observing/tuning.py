"""Automatic tuning: the disturbances that make a recording's innovations most likely.

They include the errors of a model without its highest modes. Sensor noise is measured; tuning only adds to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from controllers.models.modal import ModalModel
from controllers.observers.consistency import share_in_band
from controllers.observers.modal_observer import FilterKind, ModalObserver
from controllers.observers.settings import ObserverNoise
from hil.errors import RecordingError
from hil.observing.noise import LATTICE, SLOWEST_Hz, START_TIME_s
from hil.recording import Recording

LARGEST_FACTOR = 1e4
"""How far a disturbance may be tuned away from where it started."""

FIRST_STEP, LAST_STEP = 1.0, 0.05
"""Of the logarithms of the tuned numbers: a factor of e at first, five per cent at the end."""

LARGEST_EXCESS = 100.0
"""How much a channel may stray beyond its sensor's noise, because the model left modes out."""

TIME_s = (0.004, 20.0)
"""Correlation times that a filter at some hundred Hz can distinguish from white noise and from a random walk."""

DRIVES_TIME_s = 1.0
"""Least correlation time of the drives' disturbances: friction is slow, and at rest a command's rounding lasts as long."""

ROWS = 1280
"""Of each recording that tuning looks at: five seconds at 256 Hz."""

LOW_PASSED = ("mount", "shift")
"""Places whose disturbances may be low passes of second order, all with one corner and one damping ratio, where that is more likely. A turn
between link side and detector must leave nothing at rest: only that tells the tilt it makes from an accelerometer's bias. A gear keeps its
band: a slow push in a gear is its spring's slow bend, by which a mode's frequency is followed."""

TELLING = ("gear", *LOW_PASSED)
"""Places that are given low passes while these are tuned: gears, which encoders measure, show the corner better than the mount does."""

CORNERS_Hz, DAMPING_RATIOS, STRENGTHS = (6.0, 12.0), (0.8, 1.6), (0.6, 1.0)
"""Low passes to start from: corner, damping ratio, strength relative to the band's. The likelihood has more than one maximum."""

SHARED_Hz3 = 0.5 * 10.0**3
"""Damping ratio times the cube of the corner at which a strength is the standard deviation itself."""

CORNER_Hz, DAMPING_RATIO = (0.5, 50.0), (0.7, 5.0)
"""Limits of a low pass. They are well damped: a spectrum with a peak of its own beside a mode is hard to distinguish from the mode."""

TOLD_APART = 0.05
"""Least gain of the log-likelihood per measurement for low passes. Without disturbances the model's own errors gave 0.03 (the emulated
C-arm), with disturbances of 1 to 12 Hz the gain was 0.09."""

REFINED_STEP = 0.4
"""First step where what is tuned starts near."""

SETTLED_ROWS = 128
"""Rows after a start that are left out of the consistency."""


@dataclass(frozen=True)
class Tuning:
    """The result of the tuning.

    Attributes
    ----------
    noise : ObserverNoise
    mean_nis : mean of NIS per measurement; 1 where the filter is consistent.
    share_in_band : share of samples in the 95 % band.
    """

    noise: ObserverNoise
    mean_nis: float
    share_in_band: float


def _in_bands_but(at: np.ndarray, low_passes: ObserverNoise, bands: ObserverNoise) -> ObserverNoise:
    """Return noise with low passes, and with disturbances in bands except at these places (a mask)."""
    return replace(
        low_passes,
        disturbance=np.where(at, low_passes.disturbance, bands.disturbance),
        disturbance_time_s=np.where(at, low_passes.disturbance_time_s, bands.disturbance_time_s),
        disturbance_Hz=np.where(at, low_passes.disturbance_Hz, bands.disturbance_Hz),
        low_pass=at & low_passes.low_pass,
    )


def _compass(
    cost: Callable[[np.ndarray], float],
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    evaluations: int,
    first_step: float = FIRST_STEP,
) -> np.ndarray:
    """Minimise by steps along one parameter at a time, each with its own step that grows with success and shrinks without.

    This is slower near the end than a gradient method, but it never jumps into a far corner where the likelihood is flat.
    """
    best, best_cost = start.copy(), cost(start)
    steps = np.full(len(start), first_step)
    used = 1
    while used < evaluations and np.abs(steps).max() > LAST_STEP:
        for i in np.flatnonzero(np.abs(steps) > LAST_STEP):
            for _ in range(2):
                tried = best.copy()
                tried[i] = np.clip(best[i] + steps[i], low[i], high[i])
                used += 1
                tried_cost = cost(tried) if tried[i] != best[i] else np.inf
                if tried_cost < best_cost:
                    best, best_cost = tried, tried_cost
                    steps[i] *= 1.3
                    break
                steps[i] = -steps[i]
            else:
                steps[i] *= 0.5
    return best


def rows_of(recording: Recording, model: ModalModel) -> tuple[np.ndarray, np.ndarray]:
    """Return measurements (N, measurements) and commands (N, n_axes) of a recording; channels it lacks are missing.

    Raises
    ------
    RecordingError
        Another sample rate than the model's, no encoder and no inertial channel at all, or a hole in the commands.
    """
    if abs(recording.sample_rate_Hz / model.sample_rate_Hz - 1.0) > 1e-3:
        rate = recording.sample_rate_Hz
        raise RecordingError(f"the recording has {rate:g} rows a second; the observer runs at {model.sample_rate_Hz:g} Hz")
    channels = model.channels()
    if not any(name in recording for name in channels):
        raise RecordingError(f"the recording has none of the channels an observer looks at: {', '.join(channels)}")
    measured = np.column_stack([recording[name] if name in recording else np.full(recording.rows, np.nan) for name in channels])
    commands = recording.matrix([f"command_{axis}" for axis in model.axes])
    holes = np.flatnonzero(np.isnan(commands).any(axis=1))
    if holes.size:
        raise RecordingError(f"the command is missing in row {holes[0]}; an observer needs every one")
    return np.ascontiguousarray(measured), np.ascontiguousarray(commands)


def tune(
    model: ModalModel, start: ObserverNoise, recordings: Sequence[Recording], kind: FilterKind = "ekf", evaluations: int = 400
) -> Tuning:
    """Maximise the likelihood of the innovations over the disturbances' strengths and times and the command's noise.

    The times are correlation times. Then test whether low passes of second order are more likely at the places in `LOW_PASSED`; where they
    are, all is tuned again.

    Parameters
    ----------
    model, start
    recordings : sequence of Recording
        Ordinary operation: the first `ROWS` rows of each count.
    kind : filter to tune with; EKF and UKF agree so closely here that one serves for both.
    evaluations : how often the filter may run over the recordings, and half as often again once low passes are found.
    """
    if len(start.low_pass):  # tuned before: bands to begin with, as without
        start = replace(
            start,
            disturbance_Hz=np.where(start.low_pass, SLOWEST_Hz, start.disturbance_Hz),
            disturbance_time_s=np.where(start.low_pass, START_TIME_s, start.disturbance_time_s),
            low_pass=np.zeros(0, dtype=bool),
        )
    n, others, sensors = len(model.axes), model.disturbances - len(model.axes), len(model.sensors)
    data = [tuple(part[:ROWS] for part in rows_of(recording, model)) for recording in recordings]
    # at rest a motor side's own rounding stands as long as a command's: where the model rounds commands, as much is left to the drives
    least = np.minimum(start.command, model.effort_step * LATTICE) if len(model.effort_step) else start.command
    # command; strengths; times of the drives' disturbances and of the others; excess of motor sides, link sides, forces, rates
    sizes = (1, n + others, 2, 4)

    telling = [j for j, place in enumerate(model.places) if place in TELLING] if set(model.places) & set(LOW_PASSED) else []
    low_passed = np.array(telling, dtype=int)

    def noise(p: np.ndarray) -> ObserverNoise:
        command, strength, time, excess, low_pass = np.split(np.exp(p), np.cumsum(sizes))
        factor = np.repeat(time, (n, others))
        per_channel = np.concatenate((np.repeat(excess[:2], n), np.tile(np.repeat(excess[2:], 3), sensors)))
        disturbance = start.disturbance * strength * np.sqrt(factor)  # at one strength the times share their high frequencies
        times = np.clip(start.disturbance_time_s * factor, *TIME_s)
        disturbance[:n], times[:n] = np.maximum(disturbance[:n], least), np.maximum(times[:n], DRIVES_TIME_s)
        middle = start.disturbance_Hz.copy() if len(start.disturbance_Hz) else np.zeros(n + others)
        if len(low_pass):
            corner, damping = low_pass
            beyond = np.sqrt(SHARED_Hz3 / (damping * corner**3))  # at one strength low passes, too, share their high frequencies
            disturbance[low_passed], middle[low_passed] = (start.disturbance * strength)[low_passed] * beyond, corner
            times[low_passed] = 1.0 / (2.0 * np.pi * corner * damping)
        return replace(
            start,
            command=start.command * command,
            disturbance=disturbance,
            disturbance_time_s=times,
            disturbance_Hz=middle,
            low_pass=np.isin(np.arange(n + others), low_passed) & (len(low_pass) > 0),
            measurement=start.measurement * np.maximum(per_channel, 1.0),
        )

    def cost(p: np.ndarray) -> float:
        observer = ModalObserver(model, noise(p), kind)
        total = sum(observer.likelihood(measured, commands)[0] for measured, commands in data)
        return total if np.isfinite(total) else 1e12

    size = sum(sizes)
    edge = np.log(LARGEST_FACTOR)
    low = np.concatenate((np.full(size - sizes[-1], -edge), np.zeros(sizes[-1])))
    high = np.concatenate((np.full(size - sizes[-1], edge), np.full(sizes[-1], np.log(LARGEST_EXCESS))))
    share = np.max(least / np.maximum(start.command, 1e-12))
    low[0] = np.log(max(float(share), 1.0 / LARGEST_FACTOR))  # no less, whatever a recording makes of it
    first = np.concatenate((np.zeros(size - sizes[-1]), np.full(sizes[-1], np.log(2.0))))
    found = _compass(cost, first, low, high, evaluations)
    tuned = noise(found)
    if len(low_passed):
        in_band = np.log(noise(found).disturbance[low_passed] / start.disturbance[low_passed])
        tried = []
        for corner, damping, strength in product(CORNERS_Hz, DAMPING_RATIOS, STRENGTHS):
            tried.append(np.concatenate((found, np.log([corner, damping]))))
            tried[-1][1 + low_passed] = in_band + np.log(strength)
        costs = [cost(p) for p in tried]
        told = sum(int(np.isfinite(measured).sum()) for measured, _ in data)
        if min(costs) < cost(found) - TOLD_APART * told:
            limits = np.log([CORNER_Hz, DAMPING_RATIO])
            bounds = np.concatenate((low, limits[:, 0])), np.concatenate((high, limits[:, 1]))
            found = _compass(cost, tried[int(np.argmin(costs))], *bounds, evaluations // 2, REFINED_STEP)
            tuned = _in_bands_but(np.isin(model.places, LOW_PASSED), noise(found), tuned)
    tuned = replace(tuned, usual=np.zeros((0, 0)))  # that was of other innovations
    observer = ModalObserver(model, tuned, kind)
    summaries = [observer.likelihood(measured, commands)[1][SETTLED_ROWS:] for measured, commands in data]
    together = np.concatenate(summaries)
    return Tuning(tuned, float(together[:, 0].sum() / together[:, 1].sum()), share_in_band(together[:, 0], together[:, 1]))
