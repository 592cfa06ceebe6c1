"""Automatic tuning: the disturbances, and the strays of a model without its highest modes, that make a recording's innovations most likely.

What sensors hiss is measured; tuning only adds to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.models.modal import ModalModel
from controllers.observers.consistency import share_in_band
from controllers.observers.modal_observer import FilterKind, ModalObserver
from controllers.observers.settings import ObserverNoise
from hil.errors import RecordingError
from hil.recording import Recording

LARGEST_FACTOR = 1e4
"""How far a disturbance may be tuned away from where it started."""

FIRST_STEP, LAST_STEP = 1.0, 0.05
"""Of the logarithms of the tuned numbers: a factor of e at first, five per cent at the end."""

LARGEST_EXCESS = 100.0
"""How much a channel may stray beyond its sensor's noise, because the model left modes out."""

TIME_s = (0.004, 20.0)
"""Correlation times that a filter at some hundred Hz can tell apart from white noise and from a random walk."""

DRIVES_TIME_s = 1.0
"""Least correlation time of what drives do beside their command: friction is slow, and at rest a command's rounding stands as long."""

ROWS = 1280
"""Of each recording that tuning looks at: five seconds at 256 Hz."""

SETTLED_ROWS = 128
"""Rows after a start that consistency does not count."""


@dataclass(frozen=True)
class Tuning:
    """What the tuning found.

    Attributes
    ----------
    noise : ObserverNoise
    mean_nis : mean of NIS per measurement; 1 where the filter is consistent.
    share_in_band : share of samples in the 95 % band.
    """

    noise: ObserverNoise
    mean_nis: float
    share_in_band: float


def _compass(cost: Callable[[np.ndarray], float], start: np.ndarray, low: np.ndarray, high: np.ndarray, evaluations: int) -> np.ndarray:
    """Minimum by steps along one parameter at a time, each with a step of its own that grows with success and shrinks without.

    Slower near the end than a gradient method, but it never jumps into a far corner where the likelihood is flat.
    """
    best, best_cost = start.copy(), cost(start)
    steps = np.full(len(start), FIRST_STEP)
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
    """Measurements (N, measurements) and commands (N, n_axes) of a recording; channels it lacks are missing.

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
    """Maximum likelihood of the innovations over the disturbances' strengths and correlation times and the command's noise.

    Parameters
    ----------
    model, start
    recordings : sequence of Recording
        Ordinary operation: the first `ROWS` rows of each count.
    kind : filter to tune with; EKF and UKF agree so closely here that one serves the other.
    evaluations : how often the filter may run over the recordings.
    """
    n, others, sensors = len(model.axes), model.disturbances - len(model.axes), len(model.sensors)
    data = [tuple(part[:ROWS] for part in rows_of(recording, model)) for recording in recordings]
    # command; strengths; times of the drives' disturbances and of the others; excess of motor sides, link sides, forces, rates
    sizes = (1, n + others, 2, 4)

    def noise(p: np.ndarray) -> ObserverNoise:
        command, strength, time, excess = np.split(np.exp(p), np.cumsum(sizes)[:-1])
        factor = np.repeat(time, (n, others))
        per_channel = np.concatenate((np.repeat(excess[:2], n), np.tile(np.repeat(excess[2:], 3), sensors)))
        disturbance = start.disturbance * strength * np.sqrt(factor)  # at one strength the times share their high frequencies
        times = np.clip(start.disturbance_time_s * factor, *TIME_s)
        disturbance[:n], times[:n] = np.maximum(disturbance[:n], start.command), np.maximum(times[:n], DRIVES_TIME_s)
        return replace(
            start,
            command=start.command * command,
            disturbance=disturbance,
            disturbance_time_s=times,
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
    low[0] = 0.0  # a drive's rounding is known, whatever a recording makes of it
    first = np.concatenate((np.zeros(size - sizes[-1]), np.full(sizes[-1], np.log(2.0))))
    found = _compass(cost, first, low, high, evaluations)
    tuned = noise(found)
    observer = ModalObserver(model, tuned, kind)
    summaries = [observer.likelihood(measured, commands)[1][SETTLED_ROWS:] for measured, commands in data]
    together = np.concatenate(summaries)
    return Tuning(tuned, float(together[:, 0].sum() / together[:, 1].sum()), share_in_band(together[:, 0], together[:, 1]))
