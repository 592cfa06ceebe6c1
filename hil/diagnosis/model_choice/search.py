"""The search for sets of effects: the library proposes, fits decide."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.ndimage

from hil.diagnosis.candidates.columns import Column
from hil.diagnosis.candidates.entries import Entry, columns_of, entries
from hil.diagnosis.free_runs.runs import FreeRuns
from hil.diagnosis.model_choice.covariance import away_from
from hil.diagnosis.model_choice.fitting import Fitted, fit
from hil.diagnosis.model_choice.form_error import FORM
from hil.diagnosis.model_choice.free_run_fit import fit_to, tried
from hil.diagnosis.residuals.narrow_band import DRAWS
from hil.diagnosis.residuals.trajectory import Motion, Signals, Trajectory
from hil.diagnosis.retuning.bounded import bounded_least_squares
from hil.diagnosis.retuning.linear_model import LinearModel, LinearRecord
from virtual_bus.effects.law import SMOOTHED
from virtual_bus.effects.registry import effects

OWN = 1e-6
"""Share of a column's square that must be its own, and not that of numbers and effects that are fitted already: columns are kept in single
precision."""
LAW_ERROR = 0.01
"""Relative error of a law beside what is smooth in it, which is fitted where noise is known: motions are read off sensors, and equations
are linear about them."""
NOT_TOLD_APART = 20.0
"""In twice the log of the evidence: ten units of log likelihood."""
ROWS, AT_ONCE = 8192, 64
"""Of columns that are in double precision at once, and laws that are filtered at once."""
DEPTH = 3
"""Effects in a set at most, everyday ones aside."""
PROPOSED = 6
"""Effects that the library proposes beside a set, the most promising law of each."""
KEPT = 3
"""Sets of each size that further effects are sought beside."""


@dataclass(frozen=True, eq=False)
class Ranked:
    """A fitted set and what it costs, price included, in twice the log of its evidence."""

    fitted: Fitted
    price: float
    dispersion: float = 1.0

    @property
    def cost(self) -> float:
        """Squared innovations in units of what scatters, and price."""
        return self.fitted.cost(self.dispersion) + self.price


@dataclass(frozen=True, eq=False)
class Library:
    """The laws of all effects at all places beside what was recorded.

    Attributes
    ----------
    linear : LinearModel or FreeRuns
    laws : tuple of Entry
    columns : tuple of (N m, L) arrays
        Whitened, one array a recording, in single precision: they are the most that a diagnosis holds in memory.
    squares : tuple of (w, w) arrays
        Of each law's own columns.
    """

    linear: LinearModel | FreeRuns
    laws: tuple[Entry, ...]
    columns: tuple[np.ndarray, ...]
    squares: tuple[np.ndarray, ...]

    @property
    def places(self) -> int:
        """Number of effects and places."""
        return len({(law.effect.name, law.at) for law in self.laws})

    @property
    def parts(self) -> list[slice]:
        """Which columns are each law's."""
        ends = np.cumsum([law.width for law in self.laws]).tolist()
        return [slice(end - law.width, end) for law, end in zip(self.laws, ends, strict=True)]


def library(linear: LinearModel | FreeRuns, fitted: Fitted | None = None, nearby: Library | None = None) -> Library:
    """Return the laws of all effects at all places, for these recordings; orders and lines are sought in what a fit leaves.

    Columns that another library of the same machine has, `nearby`, are taken from there; of free runs, about whichever fit, all but those
    of orders and lines: each takes a run, and columns propose, fits decide.
    """
    if isinstance(linear, FreeRuns):
        assert fitted is not None
        return _free_run_library(linear, fitted, nearby)
    trajectories, motions, signals = _motions(linear)
    every = _every_law(linear, [one.innovations for one in linear.records] if fitted is None else fitted.innovations)
    known = _known(linear, nearby)
    most = sum(law.width for law in every)
    columns = [np.empty((one.innovations.size, most), dtype=np.float32) for one in linear.records]
    laws: list[Entry] = []
    squares: list[np.ndarray] = []
    waiting: list[tuple[slice, np.ndarray, list[list[Column]]]] = []
    width = 0
    for law in every:
        part = slice(width, width + law.width)
        if nearby is not None and law.key in known:
            its, square = known[law.key]
            for own, others in zip(columns, nearby.columns, strict=True):
                own[:, part] = others[:, its]
        elif changes := columns_of(law, trajectories, motions, signals, linear.values, linear.changes):
            square = np.zeros((law.width, law.width))
            waiting.append((part, square, changes))
        else:
            continue
        width = part.stop
        laws.append(law)
        squares.append(square)
        if len(waiting) == AT_ONCE:
            _whiten(linear, waiting, columns)
            waiting.clear()
    if waiting:
        _whiten(linear, waiting, columns)
    return Library(linear, tuple(laws), tuple(own[:, :width] for own in columns), tuple(squares))


def _motions(linear: LinearModel) -> tuple[list[Trajectory], list[Motion], list[Signals]]:
    """Return what the machine did along every recording."""
    records = linear.records
    return (
        [one.equations.trajectory for one in records],
        [one.motion for one in records],
        [one.signals for one in records],
    )


def _every_law(linear: LinearModel, left: Sequence[np.ndarray], *, everywhere: bool = False) -> list[Entry]:
    """Return the laws of all effects at all places; orders and lines are sought in what is left (N m,) of every recording."""
    trajectories, motions, signals = _motions(linear)
    short = [_asked(one, rest, linear.levels.are_assumed) for one, rest in zip(linear.records, left, strict=True)]
    inertias = linear.plant.inertias(linear.records[0].equations.model, motions[0].position[0])
    return list(entries(trajectories, motions, signals, linear.values, short, inertias, everywhere=everywhere))


def _known(linear: LinearModel, nearby: Library | None) -> dict[object, tuple[slice, np.ndarray]]:
    """Return where another library of the same machine has each law's columns, and their squares."""
    if nearby is None or nearby.linear is not linear:
        return {}
    return {law.key: (part, square) for law, part, square in zip(nearby.laws, nearby.parts, nearby.squares, strict=True)}


def _free_run_library(free: FreeRuns, fitted: Fitted, nearby: Library | None) -> Library:
    """Return the laws in free runs about a fit."""
    linear = free.linear
    trajectories, motions, signals = _motions(linear)
    here = fit(linear, fitted.settings, fitted.offset, longest=0.0)
    every = _every_law(linear, [one.innovations for one in linear.records] if here is None else here.innovations, everywhere=True)
    old = () if nearby is None else tuple(law for law in nearby.laws if not law.effect.several)
    new = []
    for law in every:
        if (nearby is None or law.effect.several) and (
            changes := columns_of(law, trajectories, motions, signals, linear.values, linear.changes)
        ):
            new.append((law, changes))
    columns = tried(free, fitted, new)
    if old:
        assert nearby is not None
        parts = [part for law, part in zip(nearby.laws, nearby.parts, strict=True) if not law.effect.several]
        taken = np.concatenate([np.arange(part.start, part.stop) for part in parts])
        columns = [np.hstack([own, others[:, taken]]) for own, others in zip(columns, nearby.columns, strict=True)]
    laws = [*(law for law, _ in new), *old]
    ends = np.cumsum([law.width for law in laws])
    each_law = [[own[:, end - law.width : end].astype(float) for own in columns] for law, end in zip(laws, ends, strict=True)]
    squares = tuple(np.sum([each.T @ each for each in own], axis=0) for own in each_law)
    return Library(free, tuple(laws), tuple(columns), squares)


def _whiten(linear: LinearModel, laws: Sequence[tuple[slice, np.ndarray, list[list[Column]]]], columns: Sequence[np.ndarray]) -> None:
    """Write the columns of some laws behind every recording's filter, and add to each law's squares."""
    for g, (one, whole) in enumerate(zip(linear.records, columns, strict=True)):
        filtered = one.whiten([column for _, _, changes in laws for column in changes[g]])
        first = 0
        for part, square, changes in laws:
            own = filtered[:, first : first + len(changes[g])]
            first += len(changes[g])
            square += own.T @ own
            whole[:, part] = own


def _asked(one: LinearRecord, left: np.ndarray, is_noise_assumed: bool) -> np.ndarray:
    """Return how much (1 + D, N, n) innovations ask for further efforts, then white ones of D draws.

    Where noise is assumed, there are no draws, and the first is in units of what is left beside single lines at each frequency.
    """
    shape = one.equations.left.shape
    asked = one.whitening.scores(left.reshape(shape))
    if not is_noise_assumed:
        rng = np.random.default_rng(0)
        return np.stack([asked, *(one.whitening.scores(rng.normal(size=shape)) for _ in range(DRAWS))])
    spectra = np.fft.rfft(asked, axis=0)
    power = scipy.ndimage.uniform_filter1d(np.abs(spectra) ** 2, SMOOTHED, axis=0, mode="nearest")
    evened: np.ndarray = np.fft.irfft(spectra / np.sqrt(np.maximum(power, 1e-300)), len(asked), axis=0)
    return evened[None]


def reduced_by(fitted: Fitted, of: Library, dispersion: float) -> Iterator[tuple[Entry, np.ndarray, np.ndarray]]:
    """Yield every law with the squares (w, w) and the slopes (w,) that a fitted set's numbers and parameters leave of its columns."""
    free = np.append(~fitted.is_pressed, np.ones(len(fitted.prior) - len(fitted.is_pressed), dtype=bool))
    kept = [each[:, free] for each in fitted.with_form]
    own = np.sum([each.T @ each for each in kept], axis=0) + dispersion * np.diag(fitted.prior[free])
    scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
    root = np.linalg.inv(np.linalg.cholesky(own / scale[:, None] / scale + 1e-10 * np.eye(len(own))))
    slopes = sum(each.T @ rest for each, rest in zip(kept, fitted.innovations, strict=True))
    offset = fitted.offset[~fitted.is_pressed]
    slopes[: len(offset)] -= dispersion * offset
    slopes[len(slopes) - fitted.form.count :] = 0.0  # form errors are at their likeliest
    across = (sum(_products(c, d) for c, d in zip(of.columns, kept, strict=True)) / scale) @ root.T
    taken = root @ (slopes / scale)
    pulls = np.sum([_products(c, rest) for c, rest in zip(of.columns, fitted.innovations, strict=True)], axis=0)
    for law, part, plain in zip(of.laws, of.parts, of.squares, strict=True):
        yield law, plain - across[part] @ across[part].T + OWN * np.diag(np.diag(plain)), pulls[part] - across[part] @ taken


def _products(columns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return columns' products with values, in double precision, a part of the rows after the other."""
    parts = [columns[k : k + ROWS].astype(float).T @ values[k : k + ROWS] for k in range(0, len(columns), ROWS)]
    return np.asarray(np.sum(parts, axis=0))


def proposed(fitted: Fitted, of: Library, readings: int, dispersion: float) -> list[tuple[Entry, np.ndarray]]:
    """Return the laws that would explain most beside a fitted set, one an effect and place, with their weights."""
    best: dict[tuple[str, str], tuple[float, Entry, np.ndarray]] = {}
    for law, reduced, pull in reduced_by(fitted, of, dispersion):
        name = (law.effect.name, law.at)
        if name in fitted.names and not law.effect.several:
            continue
        low, high = np.full(law.width, law.law.lowest), np.full(law.width, law.law.highest)
        try:
            weights = bounded_least_squares(reduced, pull, low, high)
        except np.linalg.LinAlgError:
            continue
        gain = float(2.0 * pull @ weights - weights @ reduced @ weights) / dispersion - law.width * math.log(readings)
        if name not in best or gain > best[name][0]:
            best[name] = (gain, law, weights)
    ordered = sorted(best.values(), key=lambda each: -each[0])
    return [(law, weights) for gain, law, weights in ordered[:PROPOSED] if gain > 0.0]


def search(linear: LinearModel | FreeRuns, laws: Library, baseline: Fitted, materiality: float = 1.0) -> list[Ranked]:
    """Return fitted sets, the answer first, then the likeliest; the empty set is among them.

    The answer is the likeliest set. Where noise is known, effects without which it is not sure to be less likely are left out, the least
    useful first.

    Sets are sought from nothing on, one effect after the other, and from the engineer's first fit, whose effects are left out one after the
    other, in free runs the least sure first: two effects may show only together. Effects that are not everyday have to leave less by the
    factor `materiality` each.
    """
    dispersion = scatter = baseline.dispersion
    start = fit_to(linear, (), None, scatter)
    assert start is not None

    def ranked(fitted: Fitted) -> Ranked:
        sure = found.get(frozenset((one.name, one.at) for one in fitted.settings if effects()[one.name].is_exact))
        unsure = sure.fitted if sure is not None and fitted.is_noise_known else start
        bought = _price(fitted, unsure.cost(dispersion), dispersion, linear.readings, laws.places)
        return Ranked(fitted, bought + (materiality ** _special(fitted) - 1.0) * fitted.squares / dispersion, dispersion)

    def whole(of: Ranked) -> Ranked:
        again = of.fitted if of.fitted.columns else fit_to(linear, of.fitted.settings, of.fitted.offset, scatter)
        return of if again is None else ranked(again)

    found: dict[frozenset[tuple[str, str]], Ranked] = {}
    for each in (start, baseline):
        found[each.names] = ranked(each.without_columns())
    beam = [start]
    shorter: Fitted | None = baseline
    while shorter is not None and shorter.settings:
        least = None
        if isinstance(linear, FreeRuns):  # where a fit takes as long as many along a motion, the effect whose strength is least sure goes
            least = int(np.argmin([away_from(shorter, number) for number in range(len(shorter.settings))]))
        kept, shorter, cheapest = _without_one(linear, shorter, scatter, least), None, math.inf
        for each in kept:
            if each.names not in found:
                found[each.names] = ranked(each.without_columns())
                if found[each.names].cost < cheapest:
                    shorter, cheapest = each, found[each.names].cost
    best = whole(min(found.values(), key=lambda each: each.cost)).fitted
    beam += [best] if best.names != start.names else []
    for _ in range(DEPTH):
        further: list[Ranked] = []
        for fitted in beam:
            if _special(fitted) >= DEPTH:
                continue
            for law, weights in proposed(fitted, laws, linear.readings, dispersion):
                names = fitted.names | {(law.effect.name, law.at)}
                if names in found:
                    continue
                enough = further[-1].cost * dispersion if len(further) == KEPT else math.inf
                longer = fit_to(linear, (*fitted.settings, law.setting(weights)), fitted.offset, scatter, fitted, enough)
                if longer is None or not longer.is_sensible:
                    continue
                found[names] = ranked(longer.without_columns())
                further = sorted([*further, ranked(longer)], key=lambda each: each.cost)[:KEPT]
        if not further or further[0].cost > min(found[fitted.names].cost for fitted in beam):
            break
        beam = [each.fitted for each in further]
        dispersion = min(dispersion, beam[0].dispersion)
        found = {names: ranked(each.fitted) for names, each in found.items()}
    chosen = whole(min(found.values(), key=lambda each: each.cost))
    while chosen.fitted.is_noise_known and chosen.fitted.settings:
        sparer = min(map(ranked, _without_one(linear, chosen.fitted, scatter)), key=lambda each: each.cost)
        if sparer.cost > chosen.cost + NOT_TOLD_APART:
            break
        chosen = sparer
    others = (each for names, each in found.items() if names != chosen.fitted.names)
    return [chosen, *sorted(others, key=lambda each: each.cost)]


def _without_one(linear: LinearModel | FreeRuns, fitted: Fitted, dispersion: float, only: int | None = None) -> Iterator[Fitted]:
    """Yield the fits without each effect in turn, or one of them: the columns of all of them together would fill the memory."""
    for k in range(len(fitted.settings)) if only is None else (only,):
        one = fit_to(linear, (*fitted.settings[:k], *fitted.settings[k + 1 :]), fitted.offset, dispersion, fitted)
        if one is not None:
            yield one


def _price(fitted: Fitted, cost_of_exact: float, dispersion: float, readings: int, places: int) -> float:
    """Return the price of a set of effects, of which those whose form is known alone cost `cost_of_exact`.

    It is the Bayesian information criterion, extended by the number of sets that there are (Chen and Chen 2008). An effect beside others
    must explain more than what their laws may be wrong by, all laws where noise is assumed; only the everyday ones are free of that there
    beside each other.
    """
    size = len(fitted.settings)
    bought = len(fitted.parameters) * math.log(readings) + 2.0 * math.log(math.comb(max(places, size), size))
    special = _special(fitted)
    others = size - 1 if special == size or fitted.is_noise_known else special
    wrong = LAW_ERROR if fitted.is_noise_known else FORM
    return bought + max(others, 0) * wrong**2 * max(cost_of_exact - fitted.cost(dispersion), 0.0)


def _special(fitted: Fitted) -> int:
    """Return the number of effects that are not everyday."""
    return sum(not effects()[setting.name].everyday for setting in fitted.settings)
