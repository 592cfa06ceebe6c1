"""Laws that a machine may lack, and what each would explain beside what it has: simulated, one small trial a column."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage

from hil.diagnosis.candidates.columns import Column
from hil.diagnosis.candidates.entries import Entry, columns_of, entries
from hil.diagnosis.likelihood.fitting import Fit, Fitting, prior
from hil.diagnosis.likelihood.inverse import Inverse
from hil.diagnosis.likelihood.judge import FOLDS, PARTS
from hil.diagnosis.retuning.bounded import bounded_least_squares
from hil.diagnosis.unknowns.unknowns import Machine
from virtual_bus.effects.law import SMOOTHED
from virtual_bus.errors import EffectError

SMALL = 0.02
"""Of an effort, or of a reading's scatter, that a law is tried at: equations are linear nearby only."""
OWN = 1e-6
"""Share of a column's square that must be its own."""


def library(inverse: Inverse, machine: Machine) -> list[tuple[Entry, np.ndarray]]:
    """Return the laws of all effects at all places beside a machine, with weights at which each is small."""
    trajectories, motions = inverse.trajectories, inverse.motions
    signals = [
        trajectory.signals(motion, trajectory.model(machine.values, machine.effects), machine.effects)
        for trajectory, motion in zip(trajectories, motions, strict=True)
    ]
    asked = [_evened(each.given - each.needed)[None] for each in signals]
    inertias = trajectories[0].plant.inertias(trajectories[0].model(machine.values), motions[0].position[0])
    plain = [trajectory.signals(motion, trajectory.model(machine.values)) for trajectory, motion in zip(trajectories, motions, strict=True)]
    found = []
    for law in entries(trajectories, motions, plain, machine.values, asked, inertias, is_whole=True):
        columns = columns_of(law, trajectories, motions, plain, machine.values)
        if columns:
            efforts = [np.sqrt(np.mean(each.needed**2, axis=0)) + 1e-12 for each in plain]
            readings = [np.nanstd(np.hstack([a.observed.readings, a.observed.currents]), axis=0) for a in trajectories]
            found.append((law, _small(columns, efforts, readings)))
    return found


@dataclass(frozen=True, eq=False)
class EquationErrors:
    """A fitted machine with laws beside it, as far as equations are linear.

    Attributes
    ----------
    fit : Fit
    laws : tuple of Entry
    parts : tuple of slice
        Which unknowns are each law's weights.
    sizes : (Q,) array
        Units of those.
    squares, slopes : (CELLS, P + Q, P + Q), (CELLS, P + Q) arrays
        Normal equations of each cell's windows, of the machine's own unknowns and parameters and then of the laws'.
    readings, left : (folds,) arrays
        Independent readings that each fold leaves out, and the sum of their squared errors as normal equations weigh them.
    """

    fit: Fit
    laws: tuple[Entry, ...]
    parts: tuple[slice, ...]
    sizes: np.ndarray
    squares: np.ndarray
    slopes: np.ndarray
    readings: np.ndarray
    left: np.ndarray

    @property
    def own(self) -> int:
        """Number of the machine's own unknowns and parameters."""
        return len(self.fit.point.steps())

    def bounds(self, room: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return how far down and up all unknowns may go, the machine's own by their room."""
        low, high = (np.concatenate([side, np.zeros(len(self.sizes))]) for side in room)
        for law, part in zip(self.laws, self.parts, strict=True):
            own = self.sizes[part.start - self.own : part.stop - self.own]
            low[part], high[part] = law.law.lowest / own, law.law.highest / own
        return low, high

    def weights(self, step: np.ndarray, number: int) -> np.ndarray:
        """Return the weights of one law in a step of all unknowns."""
        part = self.parts[number]
        own: np.ndarray = step[part] * self.sizes[part.start - self.own : part.stop - self.own]
        return own


def equation_errors(fitting: Fitting, here: Fit, laws: Sequence[tuple[Entry, np.ndarray]]) -> EquationErrors:
    """Simulate what each law changes beside a fitted machine."""
    here = here if here.slopes is not None else fitting.with_slopes(here)
    base = fitting.unknowns.machine(here.point)
    machines: list[Machine] = []
    sizes: list[float] = []
    parts: list[slice] = []
    used: list[Entry] = []
    own = len(here.columns[0])
    for law, weights in laws:
        if (law.effect.name, law.at) in here.point.names and not law.effect.several:
            continue
        trials = _with(base, law, weights)
        parts.append(slice(own + len(machines), own + len(machines) + len(trials)))
        machines += trials
        sizes += weights.tolist()
        used.append(law)
    columns = [np.zeros((own + len(machines), *errors.shape), dtype=np.float32) for errors in here.left.errors]
    for whole, known in zip(columns, here.columns, strict=True):
        whole[:own] = known
    largest = float(np.sqrt(fitting.judge.moved.max()))
    for begin in range(0, len(machines), AT_ONCE):
        try:
            found = fitting.judge.left(machines[begin : begin + AT_ONCE])
        except EffectError:
            continue
        for k, one in enumerate(found, begin):
            if one is not None and max(float(np.abs(each).max(initial=0.0)) for each in one.errors) < AWAY * largest:
                for whole, before, after in zip(columns, here.left.errors, one.errors, strict=True):
                    whole[own + k] = after - before
    slopes = fitting.slopes_of(here, columns)
    readings = fitting.weights * fitting.judge.counts_of_folds / fitting.judge.counts
    left = readings * fitting.judge.mean_squares_of_folds([here.reduced] * len(FOLDS)) / here.mean_squares
    of_folds = (each.sum(axis=(1, 2)) for each in (readings, left))
    return EquationErrors(here, tuple(used), tuple(parts), np.array(sizes), slopes.squares, slopes.slopes, *of_folds)


def _with(machine: Machine, law: Entry, weights: np.ndarray) -> list[Machine]:
    """Return a machine with each column of a law."""
    trials = [law.setting(np.where(np.arange(len(weights)) == k, weight, 0.0)) for k, weight in enumerate(weights)]
    return [replace(machine, effects=(*machine.effects, trial)) for trial in trials]


def gain_left_out(of: EquationErrors, kept: np.ndarray, held: np.ndarray, room: tuple[np.ndarray, np.ndarray]) -> float:
    """Return what log likelihood of left-out windows gains by fitting some unknowns, as far as equations are linear.

    Of stretches and places that are left out, it is what gains less. Errors count by their logarithm, as where machines are simulated:
    what is foretold badly costs no more than such an error. Unknowns `kept` (K,) are fitted, the others change by `held` (M,).
    """
    squares, slopes, own = of.squares, of.slopes, of.own
    pull, stiffness = prior(of.fit.point)
    pulls, stiff = np.zeros(len(held)), np.zeros(len(held))
    pulls[:own], stiff[:own] = pull, stiffness
    whole_squares, whole_slopes = squares.sum(axis=0), slopes.sum(axis=0)
    gained = []
    for fold, readings, left in zip(FOLDS, of.readings.tolist(), of.left.tolist(), strict=True):
        own_squares, own_slopes = squares[fold].sum(axis=0), slopes[fold].sum(axis=0)
        others_squares = whole_squares - own_squares + np.diag(stiff)
        others_slopes = whole_slopes - own_slopes - pulls - others_squares @ held
        inner = others_squares[np.ix_(kept, kept)]
        inner = inner + OWN * np.diag(np.diag(inner)) + 1e-300 * np.eye(len(kept))
        step = held.copy()
        try:
            step[kept] += bounded_least_squares(inner, others_slopes[kept], room[0][kept], room[1][kept])
        except np.linalg.LinAlgError:  # columns that are each other's, to single precision
            return -np.inf
        less = float(2.0 * own_slopes @ step - step @ own_squares @ step)
        gained.append(-0.5 * readings * math.log(max(1.0 - less / left, LEAST)) if left > 0.0 else 0.0)
    return min(sum(gained[:PARTS]), sum(gained[PARTS:]))


def added(of: EquationErrors, room: tuple[np.ndarray, np.ndarray], worth: float, most: int) -> list[tuple[Entry, np.ndarray, float]]:
    """Return laws that would predict better what is left out, one after the other, with their weights and what each gains."""
    own, size = of.own, of.squares.shape[1]
    low, high = of.bounds(room)
    none = np.zeros(size)
    kept = np.arange(own)
    best = gain_left_out(of, kept, none, (low, high))
    chosen: list[tuple[int, float]] = []
    promising = list(range(len(of.laws)))
    while len(chosen) < most and promising:
        gains = {}
        for number in promising:
            columns = np.arange(of.parts[number].start, of.parts[number].stop)
            gains[number] = gain_left_out(of, np.append(kept, columns), none, (low, high)) - best
        number = max(gains, key=lambda each: gains[each])
        if gains[number] < worth:
            break
        chosen.append((number, gains[number]))
        best += gains[number]
        kept = np.append(kept, np.arange(of.parts[number].start, of.parts[number].stop))
        name = (of.laws[number].effect.name, of.laws[number].at)
        promising = [
            other
            for other in promising
            if gains[other] > 0.0
            and other != number
            and ((of.laws[other].effect.name, of.laws[other].at) != name or of.laws[other].effect.several)
        ]
    step = _weights(of, kept, (low, high))
    return [(of.laws[number], of.weights(step, number), gain) for number, gain in chosen]


def alone_laws(of: EquationErrors, room: tuple[np.ndarray, np.ndarray], worth: float, most: int) -> list[tuple[Entry, np.ndarray]]:
    """Return the laws that alone would predict best what is left out, one an effect and place, with their weights."""
    own, size = of.own, of.squares.shape[1]
    low, high = of.bounds(room)
    none, kept = np.zeros(size), np.arange(own)
    before = gain_left_out(of, kept, none, (low, high))
    best: dict[tuple[str, str], tuple[float, int]] = {}
    for number, (law, part) in enumerate(zip(of.laws, of.parts, strict=True)):
        columns = np.append(kept, np.arange(part.start, part.stop))
        gain = gain_left_out(of, columns, none, (low, high)) - before
        name = (law.effect.name, law.at)
        if gain > worth and (name not in best or gain > best[name][0]):
            best[name] = gain, number
    found = []
    for _, number in sorted(best.values(), reverse=True)[:most]:
        part = of.parts[number]
        step = _weights(of, np.append(kept, np.arange(part.start, part.stop)), (low, high))
        found.append((of.laws[number], of.weights(step, number)))
    return found


def _weights(of: EquationErrors, kept: np.ndarray, room: tuple[np.ndarray, np.ndarray], held: np.ndarray | None = None) -> np.ndarray:
    """Return the step (M,) of some unknowns that fits all windows best, the others changed by `held`, as far as equations are linear."""
    own = of.own
    pull, stiffness = prior(of.fit.point)
    squares, slopes = of.squares.sum(axis=0), of.slopes.sum(axis=0)
    squares[range(own), range(own)] += stiffness
    slopes[:own] -= pull
    inner = squares[np.ix_(kept, kept)]
    step = np.zeros(len(slopes)) if held is None else held.copy()
    slopes -= squares @ step
    step[kept] = bounded_least_squares(
        inner + OWN * np.diag(np.diag(inner)) + 1e-300 * np.eye(len(kept)), slopes[kept], room[0][kept], room[1][kept]
    )
    return step


class Neighbours:
    """What log likelihood of left-out windows loses without an effect, and with a law in its place, as far as equations are linear.

    Parameters
    ----------
    of : EquationErrors
    room : pair of (P,) arrays
        Of the machine's own unknowns and parameters.
    """

    def __init__(self, of: EquationErrors, room: tuple[np.ndarray, np.ndarray]) -> None:
        self.of, self._room, self._none = of, of.bounds(room), np.zeros(of.squares.shape[1])
        self._everything = self._gain(np.arange(of.own), self._none)

    def _gain(self, kept: np.ndarray, held: np.ndarray) -> float:
        return gain_left_out(self.of, kept, held, self._room)

    def _without(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        point, held = self.of.fit.point, self._none.copy()
        kept = list(range(len(point.free)))
        for k, (which, parameter) in enumerate(point.parameters, len(point.free)):
            if which != number:
                kept.append(k)
            elif parameter.is_strength:
                held[k] = parameter.neutral - point.settings[which].parameters[parameter.name]
        return np.array(kept, dtype=np.int64), held

    def lost(self, number: int) -> float:
        """Return what is lost without an effect."""
        return self._everything - self._gain(*self._without(number))

    def others(self, number: int) -> list[tuple[Entry, np.ndarray, float]]:
        """Return laws in place of an effect, one an effect and place, with their weights and what is lost, the best first."""
        of = self.of
        kept, held = self._without(number)
        best: dict[tuple[str, str], tuple[float, int]] = {}
        for k, (law, part) in enumerate(zip(of.laws, of.parts, strict=True)):
            lost = self._everything - self._gain(np.append(kept, np.arange(part.start, part.stop)), held)
            name = (law.effect.name, law.at)
            if name not in best or lost < best[name][0]:
                best[name] = lost, k
        found = []
        for lost, k in sorted(best.values()):
            step = _weights(of, np.append(kept, np.arange(of.parts[k].start, of.parts[k].stop)), self._room, held)
            found.append((of.laws[k], of.weights(step, k), lost))
        return found


AWAY = 1e6
"""Times what was read that a small trial may err by: beyond it a simulation ran away, and single precision has no squares."""
LEAST = 1e-4
"""Share of the squares that an effect may be foretold to leave: equations are not linear as far as that."""
AT_ONCE = 64
"""Machines whose errors are in memory together."""


def _small(columns: Sequence[Sequence[Column]], efforts: Sequence[np.ndarray], readings: Sequence[np.ndarray]) -> np.ndarray:
    """Return the weights (w,) at which a law changes SMALL of an effort, or of a reading's scatter, at most."""
    most = np.zeros(len(columns[0]))
    for own, effort, reading in zip(columns, efforts, readings, strict=True):
        for k, column in enumerate(own):
            shares = [float(np.sqrt(np.mean(np.square(at, dtype=float)))) / effort[joint] for joint, (at, _) in column.efforts.items()]
            shares += [
                float(np.sqrt(np.mean(np.square(change, dtype=float)))) / reading[c]
                for c, change in column.readings.items()
                if reading[c] > 0.0
            ]
            most[k] = max([most[k], *shares])
    return np.asarray(SMALL / np.maximum(most, 1e-12))


def _evened(missing: np.ndarray) -> np.ndarray:
    """Return missing efforts (N, n) in units of what is missing beside single lines at each frequency."""
    spectra = np.fft.rfft(missing, axis=0)
    power = scipy.ndimage.uniform_filter1d(np.abs(spectra) ** 2, SMOOTHED, axis=0, mode="nearest")
    evened: np.ndarray = np.fft.irfft(spectra / np.sqrt(np.maximum(power, 1e-300)), len(missing), axis=0)
    return evened
