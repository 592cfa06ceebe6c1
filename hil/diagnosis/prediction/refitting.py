"""Numbers and parameters of the answer fitted to free runs: what is a little wrong adds up there, as in any use of the simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.candidates.entries import free_parameters, moved
from hil.diagnosis.model_choice.choose import Choice
from hil.diagnosis.model_choice.fitting import HALVINGS, ITERATIONS, STEP, difference, reach
from hil.diagnosis.prediction.open_runs import AS_LARGE, HORIZONS_s, Machine, Runs
from hil.diagnosis.retuning.bounded import bounded_least_squares
from hil.diagnosis.retuning.numbers import Numbers
from virtual_bus.effects.effect import Parameter
from virtual_bus.settings import EffectSetting

CONVERGED = 0.01
"""Share by which a step must lower the cost, or the fit has ended."""
LONGEST = 1.0
"""Step of a number, in the same."""
FEWEST = 20
"""Windows of all recordings: half of them are fitted to, and the other half tells whether that helped."""


@dataclass(frozen=True, eq=False)
class _Point:
    offset: np.ndarray  # (P,) of the numbers
    settings: tuple[EffectSetting, ...]

    def moved(self, parameters: Sequence[tuple[int, Parameter]], step: np.ndarray) -> _Point:
        return _Point(self.offset + step[: len(self.offset)], moved(self.settings, parameters, step[len(self.offset) :]))


def refitted(choice: Choice) -> Choice:
    """Return the set that predicts windows best, in free runs, that it was not fitted to; its numbers and parameters fitted to all windows.

    Where noise is known from repeats, the answer is the likeliest one, and stays. Each window counts as one reading, since its errors
    go together. Where it begins is known as well as the smoother knows it. A fit that does not predict better is not kept.
    """
    if choice.is_noise_known:
        return choice
    runs = [Runs(trajectory) for trajectory in choice.residuals.trajectories]
    numbers = choice.linear.numbers
    count = len(numbers.indices)
    spread = np.sqrt(np.nanmean(np.concatenate([(run.recorded - np.nanmean(run.recorded, axis=0)) ** 2 for run in runs]), axis=0))
    spread = np.where(spread > 0.0, spread, np.inf)
    points = [_Point(fitted.offset[:count].copy(), fitted.settings) for _, fitted in choice.sets]
    horizon = max((_horizon(runs, numbers, point, spread) or 0.0 for point in points), default=0.0)
    if horizon == 0.0:
        return choice
    tried = [_closer(runs, numbers, point, horizon, spread) for point in points]
    best = min(range(len(tried)), key=lambda k: tried[k][1])
    linear, fitted = choice.sets[best]
    here = tried[best][0]
    further = _horizon(runs, numbers, here, spread)  # once the fit is closer, longer windows stay near the recording
    if further is not None and further > horizon:
        here, _ = _closer(runs, numbers, here, further, spread)
    offset = fitted.offset.copy()
    offset[:count] = here.offset
    return replace(choice, linear=linear, best=replace(fitted, settings=here.settings, offset=offset))


def _closer(runs: Sequence[Runs], numbers: Numbers, here: _Point, horizon: float, spread: np.ndarray) -> tuple[_Point, float]:
    """Return the fit to all windows, and the squares of windows that were left out; the point itself where it predicts better."""
    counts = np.array([len(run.windows(horizon)) for run in runs])
    order = np.split(np.arange(counts.sum()), np.cumsum(counts)[:-1])
    halves = [[(2 * windows < counts.sum()) == half for windows in order] for half in (True, False)]  # neighbours would know of each other
    before = after = 0.0
    for fitted_to, left_out in (halves, halves[::-1]):
        there = _fit(runs, numbers, here, horizon, spread, fitted_to)
        before += _squares(runs, numbers, here, horizon, spread, left_out)
        after += _squares(runs, numbers, there, horizon, spread, left_out)
    if not after < before:
        return here, before
    return _fit(runs, numbers, here, horizon, spread, [windows >= 0 for windows in order]), after


def _machine(numbers: Numbers, point: _Point) -> Machine:
    return numbers.values(point.offset), point.settings


def _horizon(runs: Sequence[Runs], numbers: Numbers, point: _Point, spread: np.ndarray) -> float | None:
    """Return the longest horizon of windows that stay near the recording; None where there is none, or too few windows."""
    for horizon in HORIZONS_s:
        if sum(len(run.windows(horizon)) for run in runs) < FEWEST:
            continue
        off = [run.off(horizon, _machine(numbers, point)) for run in runs]
        if any(each is None for each in off):
            continue
        errors = np.concatenate([np.concatenate(each) for each in off if each is not None])
        if np.isfinite(errors).any() and float(np.max(np.sqrt(np.nanmean(errors**2, axis=0)) / spread)) < AS_LARGE:
            return horizon
    return None


def _squares(
    runs: Sequence[Runs], numbers: Numbers, point: _Point, horizon: float, spread: np.ndarray, used: Sequence[np.ndarray]
) -> float:
    """Return the windows' mean squares, summed; of the windows that are used."""
    total = 0.0
    for run, some in zip(runs, used, strict=True):
        off = run.off(horizon, _machine(numbers, point))
        if off is None:
            return np.inf
        squares = [(off[k] / spread) ** 2 for k in np.flatnonzero(some)]
        total += sum(float(np.nanmean(each)) for each in squares if not np.isnan(each).all())  # a gap may be longer than a window
    return total if np.isfinite(total) else np.inf


def _fit(runs: Sequence[Runs], numbers: Numbers, point: _Point, horizon: float, spread: np.ndarray, used: Sequence[np.ndarray]) -> _Point:
    begin = _squares(runs, numbers, point, horizon, spread, used)
    if not 0.0 < begin < np.inf:
        return point
    unit = begin / max(sum(int(np.sum(some)) for some in used), 1)  # of a window's mean square: its error at first
    cost = begin / unit + float(point.offset @ point.offset)
    for _ in range(ITERATIONS):
        parameters = free_parameters(point.settings)
        system = _normal_equations(runs, numbers, point, parameters, horizon, spread, used)
        if system is None:
            break
        squares, slopes = (each / unit for each in system)
        count = len(point.offset)
        squares[range(count), range(count)] += 1.0
        slopes[:count] -= point.offset
        low = np.maximum(numbers.low - point.offset, -LONGEST)
        high = np.minimum(numbers.high - point.offset, LONGEST)
        values = [(k, one, point.settings[k].parameters[one.name]) for k, one in parameters]
        around = np.array([reach(one, at, difference(point.settings, k, one)) for k, one, at in values]).reshape(-1, 2)
        step = bounded_least_squares(squares, slopes, np.append(low, around[:, 0]), np.append(high, around[:, 1]))
        for halving in range(HALVINGS):
            further = point.moved(parameters, 0.5**halving * step)
            there = _squares(runs, numbers, further, horizon, spread, used) / unit + float(further.offset @ further.offset)
            if there < cost:
                break
        else:
            break
        point, gained, cost = further, cost - there, there
        if gained < CONVERGED * cost:
            break
    return point


def _normal_equations(
    runs: Sequence[Runs], numbers: Numbers, point: _Point, parameters: Sequence[tuple[int, Parameter]], horizon: float, spread: np.ndarray,
    used: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray] | None:  # fmt: skip
    """Return squares and slopes of the windows' mean squares, without what other first positions and speeds would make of them."""
    count = len(point.offset)
    steps = np.append(np.full(count, STEP), [difference(point.settings, *each) for each in parameters])
    moved_ones = [point.moved(parameters, np.where(np.arange(len(steps)) == number, step, 0.0)) for number, step in enumerate(steps)]
    squares, slopes = np.zeros((len(steps), len(steps))), np.zeros(len(steps))
    for run, some in zip(runs, used, strict=True):
        here = run.off(horizon, _machine(numbers, point))
        if here is None:
            return None
        columns = []
        for one in moved_ones:
            there = run.off(horizon, _machine(numbers, one))
            columns.append(here if there is None else there)
        starts = _starts(run, horizon, _machine(numbers, point), here)
        for k in np.flatnonzero(some):
            rest = (here[k] / spread).reshape(-1)
            finite = np.isfinite(rest)
            if not finite.any():
                continue
            changes = [((each[k] - here[k]) / spread).reshape(-1) for each in columns]
            jacobian = np.column_stack(changes) / steps
            begun = np.column_stack([(each[k] / spread).reshape(-1) for each in starts])
            weight = 1.0 / int(finite.sum())
            jacobian, begun, rest = jacobian[finite], begun[finite], rest[finite]
            inner = np.linalg.solve(weight * begun.T @ begun + np.eye(begun.shape[1]) * float(np.mean(rest**2)), weight * begun.T)
            left, without = rest - begun @ (inner @ rest), jacobian - begun @ (inner @ jacobian)
            squares += weight * without.T @ without
            slopes -= weight * without.T @ left
    return squares, slopes


def _starts(run: Runs, horizon: float, machine: Machine, here: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    """Return what one standard deviation of every axis' first position and speed changes, window by window."""
    begins = [begin for begin, _ in run.windows(horizon)]
    axes = run.position.shape[1]
    found = []
    for axis in range(axes):
        for which in range(2):
            shift = (np.zeros((len(begins), axes)), np.zeros((len(begins), axes)))
            deviation = np.full(len(begins), run.position_deviation[axis]) if which == 0 else run.speed_deviation[begins, axis]
            shift[which][:, axis] = deviation
            there = run.off(horizon, machine, shift)
            found.append([np.zeros_like(each) for each in here] if there is None else [b - a for a, b in zip(here, there, strict=True)])
    return found
