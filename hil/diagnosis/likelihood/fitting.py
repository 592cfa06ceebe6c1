"""The machine that predicts recordings best: damped Gauss-Newton steps of the mean logarithm of errors (Levenberg 1944, Marquardt 1963)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.likelihood.judge import CELLS, FOLDS, PARTS, Judge, Left
from hil.diagnosis.retuning.bounded import bounded_least_squares
from hil.diagnosis.simulation.windows import Starts
from hil.diagnosis.unknowns.unknowns import Kind, Point, Unknowns
from virtual_bus.errors import EffectError

DAMPINGS = (0.0, 1e-2, 0.3, 10.0, 1e3)
"""Tried at once, in the lanes of one simulation, in units of the normal equations' diagonal."""
ITERATIONS = 25
CHORDS = 8
"""Steps from the whole fit to one of some folds, by the whole fit's columns, at most."""
PASSES = 2
"""In which errors and what they are weighed by settle."""
CONVERGED = 0.05
"""Gain of log likelihood below which a fit has ended."""
CONVERGED_FOLD = 0.3
"""The same of a fit to some folds: a tenth of what a parameter must be worth."""
NEARBY = 0.01
"""Of a difference, in standard deviations of a window's first state: what falls grows a hundredfold in seconds."""
OWN = 1e-4
"""Share of a column's square that must be its own."""
REACH = 0.5
"""Share of a shape that a step may change it by."""


@dataclass(frozen=True, eq=False)
class Slopes:
    """What errors change by about a point, without what other first states of windows would make of it.

    Attributes
    ----------
    squares : (CELLS, P, P) array
        Normal equations of each cell's windows.
    slopes : (CELLS, P) array
    """

    squares: np.ndarray
    slopes: np.ndarray


@dataclass(frozen=True, eq=False)
class Fit:
    """A machine at its best.

    Attributes
    ----------
    point : Point
    cost : float
        Negative log likelihood up to a constant, with the unknowns' prior.
    left : Left
        Its errors.
    begun : tuple of (S, W, l, C) arrays
        What one standard deviation of each first state changes of them.
    reduced : tuple of (W, l, C) arrays
        Errors without what the likeliest first states make of them.
    mean_squares : (H, C) array
        Of those.
    slopes : Slopes or None
    columns : tuple of (P, W, l, C) arrays
        What errors change by per unit of each unknown and parameter, in single precision.
    """

    point: Point
    cost: float
    left: Left
    begun: tuple[np.ndarray, ...]
    reduced: tuple[np.ndarray, ...]
    mean_squares: np.ndarray
    slopes: Slopes | None = None
    columns: tuple[np.ndarray, ...] = ()


class Fitting:
    """Fits of machines to recordings.

    Parameters
    ----------
    judge : Judge
    unknowns : Unknowns
    weights : (H, C) array
        How many independent readings the errors of each horizon and channel are.
    """

    def __init__(self, judge: Judge, unknowns: Unknowns, weights: np.ndarray) -> None:
        self.judge, self.unknowns, self.weights = judge, unknowns, weights

    def with_weights(self, weights: np.ndarray) -> Fitting:
        """Return the same with other weights."""
        return Fitting(self.judge, self.unknowns, weights)

    def at(self, points: Sequence[Point]) -> list[Fit | None]:
        """Return machines at some points, unfitted; None where one does not run."""
        states = self.judge.runs[0].starts
        nearby = [Starts(NEARBY * state.position, NEARBY * state.speed) for state in states]
        machines = [self.unknowns.machine(point) for point in points]
        found = self.judge.left([machine for machine in machines for _ in range(1 + len(states))], [*(None, *nearby)] * len(points))
        fits: list[Fit | None] = []
        for k, point in enumerate(points):
            here, *others = found[k * (1 + len(states)) : (k + 1) * (1 + len(states))]
            if here is None or any(one is None for one in others):
                fits.append(None)
                continue
            begun = tuple(
                np.array([(one.errors[b] - errors) / NEARBY for one in others if one is not None]) for b, errors in enumerate(here.errors)
            )
            mean_squares = self.judge.mean_squares(here.errors)
            for _ in range(PASSES):
                reduced = self._reduced(here.errors, begun, mean_squares)
                mean_squares = self.judge.mean_squares(reduced)
            fits.append(Fit(point, self._cost(mean_squares, point), here, begun, reduced, mean_squares))
        return fits

    def based(self, point: Point) -> Point:
        """Return the point with those numbers held that others stand in for."""
        (here,) = self.at([replace(point, held=frozenset())])
        return point if here is None else self.with_base_numbers(here).point

    def fit(self, start: Point, iterations: int = ITERATIONS) -> Fit | None:
        """Return the best machine near a point; None where that does not run."""
        (here,) = self.at([start])
        if here is None:
            return None
        for _ in range(iterations):
            here = self.with_slopes(here)
            assert here.slopes is not None
            squares, down = here.slopes.squares.sum(axis=0), here.slopes.slopes.sum(axis=0)
            steps = [self._step(here.point, squares, down, damping) for damping in DAMPINGS]
            found = [one for one in self.at([here.point.moved(step) for step in steps]) if one is not None]
            best = min(found, key=lambda one: one.cost, default=here)
            if not best.cost < here.cost - CONVERGED:
                converged = here if not best.cost < here.cost else replace(best, slopes=here.slopes, columns=here.columns)
                if not (freed := self._freed(converged)):
                    return converged
                best = replace(converged, point=replace(converged.point, held=converged.point.held - freed))
            here = best
        return self.with_slopes(here)

    def _freed(self, fitted: Fit) -> frozenset[int]:
        """Return the held unknowns that nothing stands in for any more, since an effect came to its bound."""
        if not fitted.point.held or all(one.low < at < one.high for at, one in fitted.point.bounded):
            return frozenset()
        return fitted.point.held - self.with_base_numbers(replace(fitted, point=replace(fitted.point, held=frozenset()))).point.held

    def with_base_numbers(self, fitted: Fit) -> Fit:
        """Return a fit at which those unknowns are held that recordings say no more of than others do: pivots of the normal equations.

        Of numbers that do the same, such as a mass and its lever, one is left free. Effects' parameters come first, numbers that the file
        leaves out last. A parameter on its bound stands in for nothing: no viscous friction makes up for too large a damping.
        """
        fitted = self.with_slopes(fitted)
        assert fitted.slopes is not None
        squares = fitted.slopes.squares.sum(axis=0)
        free = fitted.point.free
        rest = squares.copy()
        inside = np.array([parameter.low < at < parameter.high for at, parameter in fitted.point.bounded], dtype=bool)
        laws = [len(free) + k for k in np.flatnonzero(inside).tolist()]
        scale = np.maximum(np.diag(squares), 1e-300)
        for k in laws:
            if rest[k, k] > OWN * scale[k]:
                rest = rest - np.outer(rest[k], rest[k]) / rest[k, k]
        kept: list[int] = []
        kept += [k for k in range(len(free)) if self.unknowns.each[free[k]].kind is not Kind.NUMBER]
        among = [k for k in range(len(free)) if k not in kept]
        while among:
            best = max(among, key=lambda k: (not self.unknowns.each[free[k]].is_left_out, rest[k, k]))
            among.remove(best)
            if rest[best, best] < OWN * scale[best]:
                continue
            rest = rest - np.outer(rest[best], rest[best]) / rest[best, best]
            kept.append(best)
        held = frozenset(free[k] for k in range(len(free)) if k not in kept) | fitted.point.held
        return replace(fitted, point=replace(fitted.point, held=held))

    def folded(self, fitted: Fit) -> list[Fit]:
        """Return, from the whole fit on, the fits without the windows of each fold."""
        fitted = fitted if fitted.slopes is not None else self.with_slopes(fitted)
        assert fitted.slopes is not None
        there: list[Fit] = [fitted] * len(FOLDS)
        costs = [self._cost_but(fitted, fold) for fold in range(len(FOLDS))]
        moving = list(range(len(FOLDS)))
        for _ in range(CHORDS):
            steps = {fold: self._without(fitted, there[fold], fold) for fold in moving}
            ended, moving = moving, []
            for dampings in (DAMPINGS[:1], DAMPINGS[1:]):  # more of them where the first ends nowhere
                tried = [(fold, damping) for fold in ended for damping in dampings]
                found = self.at([there[fold].point.moved(self._step(there[fold].point, *steps[fold], damping)) for fold, damping in tried])
                begun = {fold: (there[fold], costs[fold]) for fold in ended}
                for (fold, _), one in zip(tried, found, strict=True):
                    if one is not None and (cost := self._cost_but(one, fold)) < costs[fold]:
                        there[fold], costs[fold] = one, cost
                moving += [fold for fold in ended if costs[fold] < begun[fold][1] - CONVERGED_FOLD]
                ended = [fold for fold in ended if not costs[fold] < begun[fold][1]]
            if not moving:
                break
        return there

    def variances(self, fitted: Fit, folded: Sequence[Fit]) -> tuple[np.ndarray, np.ndarray]:
        """Return variances (P,) of the free unknowns and parameters: as likelihood bends, and as stretches or places differ (jackknife)."""
        fitted = fitted if fitted.slopes is not None else self.with_slopes(fitted)
        assert fitted.slopes is not None
        squares = fitted.slopes.squares.sum(axis=0) + np.diag(prior(fitted.point)[1])
        scale = np.sqrt(np.maximum(np.diag(squares), 1e-300))
        bent = np.diag(np.linalg.pinv(squares / np.outer(scale, scale), rcond=1e-9, hermitian=True)) / scale**2
        points = np.array([one.point.coordinates for one in folded]).reshape(-1, PARTS, len(bent))
        return bent, (PARTS - 1.0) * np.var(points, axis=1).max(axis=0)

    def _without(self, fitted: Fit, one: Fit, fold: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the normal equations of all folds but one, by the columns of the whole fit."""
        assert fitted.slopes is not None
        slopes = fitted.slopes if one is fitted else self.slopes_of(one, fitted.columns)
        kept = ~FOLDS[fold]
        return fitted.slopes.squares[kept].sum(axis=0), slopes.slopes[kept].sum(axis=0)

    def scores(self, folded: Sequence[Fit]) -> np.ndarray:
        """Return the negative log likelihood (folds,) of the windows that each leaves out, by machines that were fitted to the others."""
        mean = self.judge.mean_squares_of_folds([one.reduced for one in folded])
        shares = self.judge.counts_of_folds / self.judge.counts
        found: np.ndarray = 0.5 * np.sum(self.weights * shares * np.log(mean), axis=(1, 2))
        return found

    def _cost_but(self, fit: Fit, fold: int) -> float:
        """Return the cost of all windows but those of a fold."""
        kept = self.judge.squares(fit.reduced) - self.judge.squares(fit.reduced, fold)
        return self._cost(kept / self.judge.counts + self.judge.noise**2, fit.point)

    def _cost(self, mean_squares: np.ndarray, point: Point) -> float:
        return float(0.5 * np.sum(self.weights * np.log(mean_squares))) + float(np.sum(np.log1p(point.numbers**2)))

    def with_slopes(self, here: Fit) -> Fit:
        """Return the same with what errors change by per unit of each unknown and parameter."""
        steps = here.point.steps()
        machines, kept = [], []
        for k, step in enumerate(steps):
            try:
                machines.append(self.unknowns.machine(here.point.moved(np.where(np.arange(len(steps)) == k, step, 0.0))))
                kept.append(k)
            except EffectError:
                continue
        columns = [np.zeros((len(steps), *errors.shape), dtype=np.float32) for errors in here.left.errors]
        for k, one in zip(kept, self.judge.left(machines), strict=True):
            if one is not None:
                for own, before, after in zip(columns, here.left.errors, one.errors, strict=True):
                    own[k] = (after - before) / steps[k]
        return replace(here, slopes=self.slopes_of(here, columns), columns=tuple(columns))

    def _precision(self, mean_squares: np.ndarray) -> np.ndarray:
        return np.asarray(self.weights / self.judge.counts / mean_squares)

    def _reduced(self, errors: Sequence[np.ndarray], begun: Sequence[np.ndarray], mean_squares: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return errors less what the likeliest first states of their windows make of them."""
        precision = self._precision(mean_squares)
        found = []
        for block, own, states in zip(self.judge.blocks, errors, begun, strict=True):
            if not len(states):
                found.append(own)
                continue
            weighted = states * precision[block.horizon]
            inner = np.einsum("swlc,twlc->wst", weighted, states, optimize=True) + np.eye(len(states))
            size = np.linalg.solve(inner, np.einsum("swlc,wlc->ws", weighted, own, optimize=True)[..., None])[..., 0]
            found.append(own - np.einsum("ws,swlc->wlc", size, states, optimize=True))
        return tuple(found)

    def slopes_of(self, here: Fit, columns: Sequence[np.ndarray]) -> Slopes:
        """Return the normal equations of columns (P, W, l, C) of every block."""
        precision = self._precision(here.mean_squares)
        count = len(columns[0])
        squares, slopes = np.zeros((CELLS, count, count)), np.zeros((CELLS, count))
        for block, own, errors, states in zip(self.judge.blocks, columns, here.left.errors, here.begun, strict=True):
            for cell in np.unique(block.cell):
                inside = block.cell == cell
                each, rest = own[:, inside], errors[inside]
                weighted = each * precision[block.horizon]
                squares[cell] += np.einsum("pwlc,qwlc->pq", weighted, each, optimize=True)
                slopes[cell] -= np.einsum("pwlc,wlc->p", weighted, rest, optimize=True)
                if len(states):
                    first = states[:, inside]
                    inner = np.einsum("swlc,twlc->wst", first * precision[block.horizon], first, optimize=True) + np.eye(len(first))
                    across = np.einsum("pwlc,swlc->wsp", weighted, first, optimize=True)
                    projected = np.einsum("swlc,wlc->ws", first * precision[block.horizon], rest, optimize=True)
                    solved = np.linalg.solve(inner, across)
                    squares[cell] -= np.einsum("wsp,wsq->pq", across, solved, optimize=True)
                    slopes[cell] += np.einsum("wsp,ws->p", solved, projected, optimize=True)
        return Slopes(squares, slopes)

    def _step(self, point: Point, squares: np.ndarray, slopes: np.ndarray, damping: float) -> np.ndarray:
        pull, stiffness = prior(point)
        whole = squares + np.diag(stiffness)
        whole = whole + damping * np.diag(np.diag(whole))
        return bounded_least_squares(whole, slopes - pull, *point.room(self.unknowns, REACH))


def prior(point: Point) -> tuple[np.ndarray, np.ndarray]:
    """Return slopes and curvatures (P,) of the prior's cost: Cauchy's, for a number that is wrong may be anything."""
    at = point.numbers[point.free]
    none = np.zeros(len(point.parameters))
    return np.append(2.0 * at / (1.0 + at**2), none), np.append(2.0 / (1.0 + at**2), none)
