"""How an answer stands: what else would explain as much, how sure its numbers are, and what the recordings could not show."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.diagnosis.candidates.entries import Entry
from hil.diagnosis.free_runs.runs import FreeRuns
from hil.diagnosis.model_choice.choose import Choice
from hil.diagnosis.model_choice.convergence import converged
from hil.diagnosis.model_choice.covariance import away_from, scattered
from hil.diagnosis.model_choice.cross_validation import (
    STANDARD_ERRORS,
    STEADY,
    Neighbour,
    agreement_in,
    differences,
    left_out,
    neighbours,
    steady,
)
from hil.diagnosis.model_choice.fitting import NOISE_MARGIN, STRETCHES, Fitted
from hil.diagnosis.model_choice.free_run_fit import fit_to
from hil.diagnosis.model_choice.search import LAW_ERROR, NOT_TOLD_APART, Library, reduced_by
from hil.diagnosis.residuals.trajectory import Motion, Signals
from hil.diagnosis.retuning.linear_model import LinearModel, LinearRecord, linear_at, nominal_offset
from virtual_bus.effects.effect import Parameter
from virtual_bus.effects.registry import effects
from virtual_bus.errors import EffectError
from virtual_bus.settings import EffectSetting

SPEEDS = (-1.0, 0.1, 1.0)
"""Times the recorded one, at which two laws are compared that differ in how they depend on it."""
MOVED = 1e-3
"""Of a number's prior: a number that moved by less stayed."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """A set of effects that might act instead.

    Attributes
    ----------
    settings : tuple of EffectSetting
    behind : float
        How far it is behind the answer, in twice the log of its evidence; negative where it is likelier.
    allowed : float
        How far laws that are wrong by LAW_ERROR may put it behind.
    without : tuple of int
        Which effects of the answer it has not.
    has_another : bool
        Whether its last effect stands in their place.
    gained : float
        By how much it lowers what no effect leaves, in units of what scatters.
    parameters : int
    leaves : float
        Squared innovations that it leaves beyond the answer, in units of what scatters.
    agreement : float
        Of repeats and stretches in that, in standard deviations by which they differ.
    offset : (P,) array
        Its nuisances.
    held_out : float
        How far it is behind in recordings that were held out.
    """

    settings: tuple[EffectSetting, ...]
    behind: float
    without: tuple[int, ...]
    has_another: bool
    gained: float
    parameters: int
    allowed: float = 0.0
    leaves: float = 0.0
    agreement: float = math.inf
    offset: np.ndarray = field(default_factory=lambda: np.zeros(0))
    held_out: float = 0.0

    @property
    def told_apart(self) -> float:
        """How far it is behind beyond what is allowed, as far as repeats agree in that; negative where it is likelier.

        Recordings that were held out may bring it nearer, and take it no farther.
        """
        behind = self.behind + min(self.held_out, 0.0)
        if self.agreement < STEADY:
            most = self.agreement**2
            behind += min(max(self.leaves, -most), most) - self.leaves
        return behind if behind <= 0.0 else max(behind - self.allowed, 0.0)


@dataclass(frozen=True)
class Limit:
    """The least strength of an effect that the recordings would have shown.

    Attributes
    ----------
    effect, at, parameter : str
    strength : float
        Of that parameter; infinite where no strength that it may have would show. It is a size where the parameter's neutral value is zero.
    setting : EffectSetting or None
        The effect as strong as that; None where no strength would show.
    """

    effect: str
    at: str
    parameter: Parameter
    strength: float
    setting: EffectSetting | None = None


def unexplained(choice: Choice) -> float:
    """Return the share that the answer leaves of what its numbers leave without effects."""
    empty = choice.without_effects
    return 1.0 if empty is None else min(1.0, choice.best.squares / max(empty.squares, 1e-300))


def is_spanned(choice: Choice) -> bool:
    """Return whether the answer leaves no more than noise, as far as that and its laws are known; where noise is assumed it always does.

    It leaves more where most stretches of the recordings do: a few loud disturbances are no physics.
    """
    best = choice.best
    if not choice.is_noise_known:
        return True
    empty = choice.without_effects
    explained = 0.0 if empty is None else max(empty.squares - best.squares, 0.0)
    stretches = np.array([float(np.mean(part**2)) for rest in best.innovations for part in np.array_split(rest, STRETCHES)])
    sure = float(stretches.mean() - STANDARD_ERRORS * stretches.std(ddof=1) / math.sqrt(len(stretches)))
    share = best.squares / max(float(sum(rest @ rest for rest in best.innovations)), 1e-300)
    readings = sum(len(rest) for rest in best.innovations)
    return share * sure * readings <= (1.0 + NOISE_MARGIN) * choice.linear.readings + LAW_ERROR**2 * explained


def times_noise(choice: Choice) -> float:
    """Return what the answer leaves over what noise leaves, as squares."""
    return choice.best.squares / choice.linear.readings


def gained_by(choice: Choice) -> float:
    """Return by how much the answer's effects lower the squares, in units of what scatters."""
    empty, unit = choice.without_effects, choice.best.dispersion
    return 0.0 if empty is None else empty.cost(unit) - choice.best.cost(unit)


def numbers_help(choice: Choice) -> bool:
    """Return whether other numbers in the machine file, and no effect, explain what the file's do not."""
    nominal = nominal_offset(choice.residuals.trajectories)
    left: Sequence[np.ndarray] | None
    if isinstance(choice.linear, FreeRuns):
        (left,) = choice.linear.left([(nominal, ())])
    else:
        left = linear_at(choice.residuals.trajectories, choice.view, nominal).without_offsets()
    before = math.inf if left is None else sum(float(rest @ rest) for rest in left)
    moved = int(np.sum(np.abs(choice.best.offset[: len(choice.linear.numbers.indices)]) > MOVED))
    gained = (before - choice.best.squares) / choice.best.dispersion - float(choice.best.offset @ choice.best.offset)
    return gained > max(moved, 1) * math.log(choice.linear.readings)


def alternatives(choice: Choice, of: Library) -> list[Alternative]:
    """Return what might stand in place of effects of the answer, and the answer without one; the least far behind first.

    Where noise is assumed, sets are weighed by how well they predict stretches left out, else by the Bayesian information criterion, and
    laws are then allowed to be wrong by LAW_ERROR.
    """
    linear, best = choice.linear, choice.best
    unit = best.dispersion
    nothing = math.inf if choice.without_effects is None else choice.without_effects.cost(unit)

    def evidence(fitted: Fitted) -> float:
        if isinstance(linear, LinearModel) and not choice.is_noise_known:
            return float(left_out(linear, fitted).sum()) / unit
        return fitted.cost(unit) + len(fitted.parameters) * math.log(linear.readings)

    own = evidence(best)
    wrong = LAW_ERROR**2 * max(nothing - best.cost(unit), 0.0) if choice.is_noise_known and math.isfinite(nothing) else 0.0
    repeats = differences(choice.residuals, linear) if choice.is_noise_known else []
    found = []
    for each in (*neighbours(linear, best, of), *_engineers(choice)):
        one = each.fitted
        is_one = each.has_another and len(each.without) == 1 and len(one.settings) == len(best.settings)
        if is_one and isinstance(linear, LinearModel) and is_same_law(linear, best, one, *each.without):
            continue
        gained, behind = nothing - one.cost(unit), evidence(one) - own
        allowed = wrong if each.has_another else 0.0
        agreed = agreement_in(one.innovations, best.innovations, repeats) if repeats and each.has_another else math.inf
        counts = gained, len(one.parameters), allowed, (one.squares - best.squares) / unit, agreed
        found.append(Alternative(one.settings, behind, each.without, each.has_another, *counts, one.offset))
    return sorted(found, key=lambda each: each.behind)


def _engineers(choice: Choice) -> Iterator[Neighbour]:
    """Yield the everyday effects that the engineer's fit shows, where they are neither part of the answer nor hold it."""
    linear, best, fitted = choice.linear, choice.best, choice.baseline
    if not choice.is_noise_known:
        return
    least = math.log(linear.readings)
    settings = tuple(one for number, one in enumerate(fitted.settings) if away_from(fitted, number) > least)
    names = {(one.name, one.at) for one in settings}
    if best.names <= names or names <= best.names:
        return
    without = tuple(k for k, one in enumerate(best.settings) if (one.name, one.at) not in names)
    other = fit_to(linear, settings, best.offset, best.dispersion)
    if other is not None and other.is_sensible:
        yield Neighbour(other, without, has_another=True)


def simpler_choice(choice: Choice, others: Sequence[Alternative]) -> Choice | None:
    """Return the same with the set of fewer parameters that is likelier, as far as repeats agree in that; None where none is."""
    count = len(choice.best.parameters)
    fewer = [other for other in others if other.has_another and other.told_apart < 0.0 and other.parameters < count]
    if not fewer or not choice.is_noise_known:
        return None
    least = min(fewer, key=lambda other: other.told_apart)
    judge, free = choice.linear, choice.linear if isinstance(choice.linear, FreeRuns) else None
    fitted = fit_to(judge, least.settings, least.offset, choice.best.dispersion) if free is not None else None
    if free is None:
        judge, fitted = converged(choice.residuals.trajectories, choice.levels, least.offset, least.settings)
    if fitted is None or not fitted.is_sensible or len(fitted.parameters) >= count or steady(choice.residuals, fitted, free) is not None:
        return None
    return replace(choice, linear=judge, best=fitted, sets=((judge, fitted),), of=None)


def is_same_law(linear: LinearModel, best: Fitted, other: Fitted, number: int) -> bool:
    """Return whether another set's last effect, with no fewer parameters, is an effect of a set but for LAW_ERROR, at other speeds, too.

    A wider law may be fitted such that nothing is left of what it has beyond the narrower one. Strengths may differ, since no motion shows
    the scale of all efforts.
    """
    own, its = best.settings[number], other.settings[-1]
    if own.at != its.at or len(other.parameters) < len(best.parameters):
        return False
    one, sums = linear.records[0], np.zeros(3)
    for share in SPEEDS:
        motion = replace(one.motion, speed=share * one.motion.speed, acceleration=share**2 * one.motion.acceleration)
        try:
            signals = [_signals(linear, one, motion, settings) for settings in ((), (own,), (its,))]
        except EffectError:
            return False
        efforts = [(each.given - each.needed, each.readings) for each in signals]
        for plain, with_own, with_its in zip(*efforts, strict=True):
            a, b = with_own - plain, with_its - plain
            sums += np.sum(a * b), np.sum(a * a), np.sum(b * b)
    across, squares, its_squares = sums
    return bool(across > 0.0 and squares * its_squares - across**2 <= LAW_ERROR**2 * squares * its_squares)


def _signals(linear: LinearModel, one: LinearRecord, motion: Motion, settings: tuple[EffectSetting, ...]) -> Signals:
    trajectory = one.equations.trajectory
    return trajectory.signals(motion, trajectory.model(linear.values, settings), settings)


def deviations(choice: Choice, other: Fitted) -> np.ndarray:
    """Return standard deviations (P + Q,) of nuisances [of their prior] and of the answer's parameters.

    Where noise is assumed, no equation is quite right: what another view of the same recordings, in which fast misfits count more, gives
    for the same effects belongs to what is unsure, and so does what `other`, a fit to free runs, gives.
    """
    best = choice.best
    scatter = scattered(best)
    if choice.is_noise_known or not best.settings:
        return scatter
    _, fast = converged(choice.residuals.trajectories, choice.levels, best.offset, best.settings)
    views = [np.append(one.offset, [one.settings[k].parameters[p.name] for k, p in one.parameters]) for one in (best, fast, other)]
    views = [each for each in views if len(each) == len(scatter)]
    return np.sqrt(scatter**2 + np.var(views, axis=0, ddof=1)) if len(views) > 1 else scatter


def detection_limits(choice: Choice, of: Library) -> list[Limit]:
    """Return the least strength of every effect at every place that would have been named beside the answer.

    It is the strength whose expected gain is what the search asks of an effect. Of laws with several weights the one that shows least
    counts. Families that were found at a place are left out there.
    """
    linear, best = choice.linear, choice.best
    taken = {(effects()[one.name].family, one.at) for one in best.settings}
    found = []
    for law, reduced, _ in reduced_by(best, of, best.dispersion):
        strengths = sum(parameter.is_strength for parameter in law.effect.parameters)
        asked = strengths * math.log(linear.readings) + 2.0 * math.log(of.places)
        if choice.is_noise_known:
            asked += NOT_TOLD_APART
        if not law.effect.everyday:
            asked += (choice.materiality - 1.0) * best.squares / best.dispersion
        if (law.effect.family, law.at) not in taken:
            found.append((law, reduced, asked * best.dispersion))
    return least_shown(found)


def least_shown(laws: Sequence[tuple[Entry, np.ndarray, float]]) -> list[Limit]:
    """Return, of laws with the squares (w, w) of their weights and what is asked of them, the least strengths of every effect and place."""
    least: dict[tuple[str, str], Limit] = {}
    for law, squares, asked in laws:
        strengths = [parameter for parameter in law.effect.parameters if parameter.is_strength]
        if strengths:
            limit = _limit(law, strengths, squares, asked)
            key = (limit.effect, limit.at)
            if key not in least or _beyond(limit) < _beyond(least[key]):
                least[key] = limit
    return sorted(least.values(), key=lambda each: (each.effect, each.at))


def _limit(law: Entry, strengths: Sequence[Parameter], squares: np.ndarray, asked: float) -> Limit:
    """Return the least strength of a law that shows, whichever of its weights it has."""
    first = strengths[0]
    least: EffectSetting | None = None
    off = -1.0
    for number, square in enumerate(np.diag(squares)):
        weights = np.zeros(len(squares))
        weights[number] = math.sqrt(asked / max(float(square), 1e-300))
        settings = [law.setting(weights), law.setting(-weights)]
        shown = {
            abs(setting.parameters[first.name] - first.neutral): setting
            for setting in reversed(settings)
            if setting.parameters[first.name] != first.neutral
            and all(setting.parameters[p.name] == p.neutral or p.low < setting.parameters[p.name] < p.high for p in strengths)
        }
        by = min(shown, default=math.inf)
        if by > off:
            off, least = by, shown.get(by)
    value = math.inf if least is None else least.parameters[first.name]
    return Limit(law.effect.name, law.at, first, value if first.neutral else abs(value), least)


def _beyond(limit: Limit) -> float:
    return abs(limit.strength - limit.parameter.neutral)
