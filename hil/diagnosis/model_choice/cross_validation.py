"""Which effects of a set predict stretches of the recordings that they were not fitted to.

Where noise is assumed, that is looked at in a view that slow misfits dominate. With weak disturbances a filter's innovations come close to
the errors of a free run along the recorded motion: what is wrong adds up. So fast misfits, which laws of friction are bent to where they
can be, count little. Numbers of right equations are the same in both views.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.stats

from hil.diagnosis.free_runs.runs import FreeRuns
from hil.diagnosis.model_choice.convergence import converged
from hil.diagnosis.model_choice.fitting import STRETCHES, Fitted, alone
from hil.diagnosis.model_choice.free_run_fit import alone_in_free_runs, fit_to
from hil.diagnosis.model_choice.search import Library, library, proposed
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.repeat_noise import deviations
from hil.diagnosis.residuals.residuals import Residuals
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.retuning.bounded import bounded_least_squares
from hil.diagnosis.retuning.linear_model import LinearModel, linear_at
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

SLOW = 0.03
"""Of the disturbances' level: motions are then followed a sixth as fast."""
FAST = 0.1
"""Share of a motion that is faster than what equations are linearised about."""
STANDARD_ERRORS, LARGE_SHARE = 2.0, 0.1
"""Standard errors, over stretches, by which an effect lowers the squares of stretches left out, and share of them: one of both keeps it.
Few stretches may show an effect, and then it shows much. What was not in the set before has to be both."""
STEADY = 3.0
"""Standard deviations, by stretches and by repeats, that what an effect explains must have where noise is known."""
EXCHANGES = 3
"""At most."""


def cross_validated(
    trajectories: Sequence[Trajectory],
    levels: Levels,
    offset: np.ndarray,
    settings: Sequence[EffectSetting],
    everyday: Sequence[EffectSetting],
) -> list[tuple[LinearModel, Fitted]]:
    """Return machines and fits, in the slow view, of effects that predict: what was named, the everyday set, and what is better than these.

    Parameters
    ----------
    trajectories : sequence of Trajectory
    levels : Levels
        Of the slow view.
    offset : (P,) array
    settings : sequence of EffectSetting
        What was named. Everyday effects are added, and those that do not predict are left out one by one, the least useful first. In a
        second set everyday effects stand in place of all laws of their families. In the better one, an effect or two are then exchanged
        for another law of the same family that predicts better. None is added: real machines have a little of everything, and many small
        effects bend to any misfit.
    everyday : sequence of EffectSetting
    """
    taken = {(one.name, one.at) for one in settings}
    usual = {(effects()[one.name].family, one.at) for one in everyday}
    special = [one for one in settings if (effects()[one.name].family, one.at) not in usual]
    sets = [[*settings, *(one for one in everyday if (one.name, one.at) not in taken)], [*everyday, *special]]
    found: list[tuple[LinearModel, Fitted]] = []
    for one in sets:
        linear, fitted = _eliminated(trajectories, levels, offset, one)
        if all(fitted.names != other.names for _, other in found):
            found.append((linear, fitted))
    linear, fitted = min(found, key=lambda pair: float(left_out(*pair).sum()))
    first = fitted
    for _ in range(EXCHANGES):
        left = left_out(linear, fitted)
        better = _better(linear, fitted, left)
        if better is None:
            break
        further = _eliminated(trajectories, levels, fitted.offset, better.settings)
        if further[1].names == fitted.names or not left_out(*further).sum() < left.sum():
            break
        linear, fitted = further
    if fitted is not first and all(fitted.names != other.names for _, other in found):
        found.append((linear, fitted))
    return sorted(found, key=lambda pair: float(left_out(*pair).sum()))


def left_out(linear: LinearModel, fitted: Fitted) -> np.ndarray:
    """Return the squares of every stretch, predicted from the others."""
    return _left_out(linear, fitted, _blocks(fitted), None)


@dataclass(frozen=True, eq=False)
class Neighbour:
    """A fitted set that differs from another one by an effect or two.

    Attributes
    ----------
    fitted : Fitted
    without : tuple of int
        Which effects of the other set it has not.
    has_another : bool
        Whether its last effect is none of the other set's.
    """

    fitted: Fitted
    without: tuple[int, ...]
    has_another: bool


def neighbours(linear: LinearModel | FreeRuns, best: Fitted, of: Library) -> Iterator[Neighbour]:
    """Yield what might stand in place of each effect of a set, and the set without it.

    Laws that would explain most beside what is kept are fitted with it: in place of one effect, or of two at one place. Two laws of one
    family at one place are one law, unless what was left out acts there instead.
    """
    count = len(best.settings)
    pairs = [(k, j) for k in range(count) for j in range(k) if best.settings[k].at == best.settings[j].at]
    for without in [*((k,) for k in range(count)), *pairs]:
        kept = tuple(setting for k, setting in enumerate(best.settings) if k not in without)
        rest = fit_to(linear, kept, best.offset, best.dispersion, best)
        if rest is None:
            continue
        if len(without) == 1:
            yield Neighbour(rest, without, has_another=False)
        taken = best.names | {(effects()[one.name].family, one.at) for one in kept}
        gone = {best.settings[k].name for k in without}
        waves = any(effects()[name].several for name in gone)
        laws = library(linear, rest, of) if waves else of  # orders and lines of what was left out
        for law, weights in proposed(rest, laws, linear.readings, best.dispersion):
            if (law.effect.name, law.at) in taken or ((law.effect.family, law.at) in taken and law.effect.name not in gone):
                continue
            other = fit_to(linear, (*kept, law.setting(weights)), rest.offset, best.dispersion, rest)
            if other is not None and other.is_sensible:
                yield Neighbour(other, without, has_another=True)


def _better(linear: LinearModel, best: Fitted, left: np.ndarray) -> Fitted | None:
    """Return the other law that predicts stretches left out best, where it is sure to, and by much; None where none is.

    Of several that are tried each has to be surer (Bonferroni).
    """
    found: tuple[float, Fitted] | None = None
    tried = [
        (left - left_out(linear, one.fitted), one.fitted.without_columns())
        for one in neighbours(linear, best, library(linear))
        if one.has_another and _is_refined(best, one)
    ]
    freedom = len(left) - 1
    sure = scipy.stats.t.isf(scipy.stats.t.sf(STANDARD_ERRORS, freedom) / max(len(tried), 1), freedom)
    for gained, fitted in tried:
        is_sure = gained.mean() > sure * gained.std(ddof=1) / np.sqrt(len(gained))
        if is_sure and gained.sum() > LARGE_SHARE * left.sum() and (found is None or gained.sum() > found[0]):
            found = (float(gained.sum()), fitted)
    return None if found is None else found[1]


def _is_refined(best: Fitted, one: Neighbour) -> bool:
    """Whether a neighbour's last effect is another law of the family and at the place of one that it has not."""
    law = one.fitted.settings[-1]
    gone = {(effects()[best.settings[k].name].family, best.settings[k].at) for k in one.without}
    return (effects()[law.name].family, law.at) in gone


def _eliminated(
    trajectories: Sequence[Trajectory], levels: Levels, offset: np.ndarray, settings: Sequence[EffectSetting]
) -> tuple[LinearModel, Fitted]:
    """Return the machine and the fit with the effects that are sure to predict stretches left out; others go, the least useful first."""
    left = list(settings)
    while True:
        linear, fitted = converged(trajectories, levels, offset, left)  # from where each began: what went had drawn the others its way
        worst = _least_useful(linear, fitted)
        if worst is None:
            return linear, fitted
        del left[worst]


def _least_useful(linear: LinearModel, fitted: Fitted) -> int | None:
    """Return the effect without which stretches left out are predicted best; None where every effect is sure to help."""
    for number, setting in enumerate(fitted.settings):
        strengths = [each for each in effects()[setting.name].parameters if each.is_strength]
        if all(setting.parameters[each.name] == each.neutral for each in strengths):
            return number
    blocks = _blocks(fitted)
    whole = _left_out(linear, fitted, blocks, None)
    found: tuple[float, int] | None = None
    for number in range(len(fitted.settings)):
        worse = _left_out(linear, fitted, blocks, number) - whole
        share = float(worse.sum() / whole.sum())
        is_sure = worse.mean() > STANDARD_ERRORS * worse.std(ddof=1) / np.sqrt(len(worse))
        if not is_sure and share < LARGE_SHARE and (found is None or share < found[0]):
            found = (share, number)
    return None if found is None else found[1]


def steady(residuals: Residuals, fitted: Fitted, free: FreeRuns | None = None) -> tuple[LinearModel | FreeRuns, Fitted] | None:
    """Return the machine and the fit with the effects that repeats and stretches of the recordings agree on; None where all do."""
    found: tuple[LinearModel | FreeRuns, Fitted] | None = None
    while fitted.settings:
        linear = free or (
            found[0] if found is not None else linear_at(residuals.trajectories, residuals.levels, fitted.offset, fitted.settings)
        )
        repeats = differences(residuals, linear)
        sizes = [_steadiness(linear, fitted, number, repeats) for number in range(len(fitted.settings))]
        worst = int(np.argmin(sizes))
        if sizes[worst] >= STEADY:
            break
        kept = (*fitted.settings[:worst], *fitted.settings[worst + 1 :])
        if isinstance(linear, FreeRuns):
            sparer = fit_to(linear, kept, fitted.offset, fitted.dispersion)
            if sparer is None:
                break
            found = linear, sparer
        else:
            found = converged(residuals.trajectories, residuals.levels, fitted.offset, kept)
        fitted = found[1]
    return found


def differences(residuals: Residuals, linear: LinearModel | FreeRuns) -> list[list[np.ndarray]]:
    """Return what each repeat's innovations (N m,) differ from those of the mean by, one list a group; none of a single recording."""
    if isinstance(linear, FreeRuns):
        return linear.repeats
    return [
        [each.innovations(one.whitening) for each in deviations(group, trajectory)]
        for group, trajectory, one in zip(residuals.groups, residuals.trajectories, linear.records, strict=True)
    ]


def _steadiness(linear: LinearModel | FreeRuns, fitted: Fitted, number: int, repeats: Sequence[Sequence[np.ndarray]]) -> float:
    """Return how steady what an effect alone explains is, beside all that numbers and the other effects may change instead.

    Parameters
    ----------
    linear : LinearModel or FreeRuns
    fitted : Fitted
    number : int
        Of the effect.
    repeats : sequence of sequence of (N m,) arrays
        As `agreement` takes them.
    """
    own = alone_in_free_runs(linear, fitted, number) if isinstance(linear, FreeRuns) else alone(linear, fitted, number)
    if own is None:
        return np.inf
    count = len(fitted.offset)
    others = [*range(count), *(count + k for k, (of, _) in enumerate(fitted.parameters) if of != number)]
    kept = [each[:, others] for each in fitted.columns]
    squares = np.sum([each.T @ each for each in kept], axis=0) + fitted.dispersion * np.diag(fitted.prior[others])
    pulls = np.sum([each.T @ change for each, change in zip(kept, own, strict=True)], axis=0)
    low, high = (each[others] for each in _room(linear, fitted))
    taken = bounded_least_squares(squares, pulls, low, high)
    return agreement([change - each @ taken for each, change in zip(kept, own, strict=True)], fitted.innovations, repeats)


def agreement(changes: Sequence[np.ndarray], left: Sequence[np.ndarray], repeats: Sequence[Sequence[np.ndarray]]) -> float:
    """Return how large a change is, in standard deviations by which repeats, and stretches of them, differ in it.

    A few loud disturbances speak in one repeat, and one at a steady frequency speaks in each of them otherwise: physics, even if it shows
    in one stretch only, says the same there in all. It is the jackknife's estimate (Efron 1982; MacKinnon and White 1985, HC3).

    Parameters
    ----------
    changes : sequence of (N m,) arrays
        What an answer takes of each group's innovations, beyond what something else takes.
    left : sequence of (N m,) arrays
        What the answer leaves.
    repeats : sequence of sequence of (N m,) arrays
        What each repeat's innovations differ from those of the mean by, one sequence a group; none where there was one recording.
    """
    size = float(sum(change @ change for change in changes))
    if size == 0.0:
        return 0.0
    rows = sum(len(change) for change in changes)
    scattered = np.zeros(2)  # over stretches of repeats, and over whole repeats
    for change, rest, differ in zip(changes, left, repeats, strict=True):
        count = max(1, round(STRETCHES * len(change) / rows))
        parts = differ or [np.zeros_like(rest)]
        stretches = np.array_split(np.arange(len(change)), count)
        scores = np.array([[change[inside] @ (rest[inside] + each[inside]) for inside in stretches] for each in parts]) / len(parts)
        weights = np.array([change[inside] @ change[inside] for inside in stretches]) / size / len(parts)
        of_repeats = np.sum((scores.sum(axis=1) / (1.0 - weights.sum())) ** 2) if differ else 0.0
        scattered += np.sum((scores / np.maximum(1.0 - weights, 1e-12)) ** 2), of_repeats
    return size / float(np.sqrt(max(scattered.max(), 1e-300)))


def agreement_in(one: Sequence[np.ndarray], other: Sequence[np.ndarray], repeats: Sequence[Sequence[np.ndarray]]) -> float:
    """Return how large the difference of what two sets leave (N m,) is, by `agreement`, whichever leaves less."""
    difference = [a - b for a, b in zip(one, other, strict=True)]
    least = min(one, other, key=lambda left: sum(float(each @ each) for each in left))  # the other has the difference in it
    return agreement(difference, least, repeats)


def _blocks(fitted: Fitted) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return innovations and columns of stretches, alike in length."""
    rows = sum(len(rest) for rest in fitted.innovations)
    blocks = []
    for rest, columns in zip(fitted.innovations, fitted.columns, strict=True):
        count = max(1, round(STRETCHES * len(rest) / rows))
        blocks += [(rest[inside], columns[inside]) for inside in np.array_split(np.arange(len(rest)), count)]
    return blocks


def _left_out(linear: LinearModel, fitted: Fitted, blocks: Sequence[tuple[np.ndarray, np.ndarray]], without: int | None) -> np.ndarray:
    """Return the squares of each stretch, predicted from the others; without one effect where that is given.

    Equations are linear about the fit.
    """
    count = len(fitted.offset)
    low, high = _room(linear, fitted)
    for k, (number, parameter) in enumerate(fitted.parameters, count):
        if number == without:
            value = fitted.settings[number].parameters[parameter.name]
            low[k] = high[k] = parameter.neutral - value if parameter.is_strength else 0.0
    prior = fitted.dispersion * np.append(np.ones(count), np.zeros(len(fitted.parameters)))
    pull = prior * np.append(fitted.offset, np.zeros(len(fitted.parameters)))
    squares = [columns.T @ columns for _, columns in blocks]
    slopes = [columns.T @ rest for rest, columns in blocks]
    all_squares, all_slopes = sum(squares) + np.diag(prior), sum(slopes) - pull
    left = []
    for own, slope, (rest, columns) in zip(squares, slopes, blocks, strict=True):
        step = bounded_least_squares(all_squares - own, all_slopes - slope, low, high)
        left.append(float(np.sum((rest - columns @ step) ** 2)))
    return np.array(left)


def _room(linear: LinearModel | FreeRuns, fitted: Fitted) -> tuple[np.ndarray, np.ndarray]:
    """Return how far down and up nuisances and parameters (P + Q,) may go."""
    low, high = (bound + linear.offset - fitted.offset for bound in linear.bounds)
    values = [(parameter, fitted.settings[number].parameters[parameter.name]) for number, parameter in fitted.parameters]
    return (
        np.append(low, [parameter.low - value for parameter, value in values]),
        np.append(high, [parameter.high - value for parameter, value in values]),
    )


def slow_view(trajectories: Sequence[Trajectory], levels: Levels) -> Levels:
    """Return assumed noise with weaker disturbances; the same, where motions are too fast for equations that are linear nearby."""
    for trajectory in trajectories:
        for motion in trajectory.smooth.values():
            if np.std(motion.position - motion.slow[:, 0]) > FAST * np.std(motion.position):
                return levels
    return replace(levels, disturbance=SLOW * levels.disturbance)
