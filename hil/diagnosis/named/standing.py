"""How an answer stands: what else would explain as much, how sure its numbers are, and what the recordings could not show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.diagnosis.candidates.entries import Entry
from hil.diagnosis.free_runs.runs import FreeRuns
from hil.diagnosis.named.covariance import scattered
from hil.diagnosis.named.fitting import BLOCKS, LEVEL, Fitted
from hil.diagnosis.named.freely import fit_to
from hil.diagnosis.named.naming import Named
from hil.diagnosis.named.proving import SURE, left_out, neighbours
from hil.diagnosis.named.search import EXACT, NOT_TOLD_APART, Library, beside_fit
from hil.diagnosis.named.settling import settled
from hil.diagnosis.tuned.retuning import Tuned, nominal_offset, tuned_at
from virtual_bus.effects.effect import Parameter
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

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
        How far laws that are wrong by EXACT may put it behind.
    without : tuple of int
        Which effects of the answer it has not.
    has_another : bool
        Whether its last effect stands in their place.
    gained : float
        By how much it lowers what no effect leaves, in units of what scatters.
    parameters : int
    """

    settings: tuple[EffectSetting, ...]
    behind: float
    without: tuple[int, ...]
    has_another: bool
    gained: float
    parameters: int
    allowed: float = 0.0

    @property
    def told_apart(self) -> float:
        """How far it is behind beyond what is allowed; negative where it is likelier."""
        return self.behind if self.behind <= 0.0 else max(self.behind - self.allowed, 0.0)


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


def unexplained(named: Named) -> float:
    """Return the share that the answer leaves of what its numbers leave without effects."""
    best = named.best
    empty = fit_to(named.tuned, (), best.offset, best.dispersion)
    return 1.0 if empty is None else min(1.0, best.squares / max(empty.squares, 1e-300))


def is_spanned(named: Named) -> bool:
    """Return whether the answer leaves no more than noise, as far as that and its laws are known; where noise is assumed it always does.

    It leaves more where most stretches of the recordings do: a few loud disturbances are no physics.
    """
    best = named.best
    if not named.is_noise_known:
        return True
    empty = fit_to(named.tuned, (), best.offset, best.dispersion)
    explained = 0.0 if empty is None else max(empty.squares - best.squares, 0.0)
    stretches = np.array([float(np.mean(part**2)) for rest in best.innovations for part in np.array_split(rest, BLOCKS)])
    sure = float(stretches.mean() - SURE * stretches.std(ddof=1) / math.sqrt(len(stretches)))
    share = best.squares / max(float(sum(rest @ rest for rest in best.innovations)), 1e-300)
    readings = sum(len(rest) for rest in best.innovations)
    return share * sure * readings <= (1.0 + LEVEL) * named.tuned.readings + EXACT**2 * explained


def times_noise(named: Named) -> float:
    """Return what the answer leaves over what noise leaves, as squares."""
    return named.best.squares / named.tuned.readings


def gained_by(named: Named) -> float:
    """Return by how much the answer's effects lower the squares, in units of what scatters."""
    best = named.best
    empty = fit_to(named.tuned, (), best.offset, best.dispersion)
    return 0.0 if empty is None else empty.cost(best.dispersion) - best.cost(best.dispersion)


def numbers_help(named: Named) -> bool:
    """Return whether other numbers in the machine file, and no effect, explain what the file's do not."""
    nominal = nominal_offset(named.seen.alongs)
    left: Sequence[np.ndarray] | None
    if isinstance(named.tuned, FreeRuns):
        (left,) = named.tuned.left([(nominal, ())])
    else:
        left = tuned_at(named.seen.alongs, named.view, nominal).without_offsets()
    before = math.inf if left is None else sum(float(rest @ rest) for rest in left)
    moved = int(np.sum(np.abs(named.best.offset[: len(named.tuned.numbers.indices)]) > MOVED))
    gained = (before - named.best.squares) / named.best.dispersion - float(named.best.offset @ named.best.offset)
    return gained > max(moved, 1) * math.log(named.tuned.readings)


def alternatives(named: Named, of: Library) -> list[Alternative]:
    """Return what might stand in place of effects of the answer, and the answer without one; the least far behind first.

    Where noise is assumed, sets are weighed by how well they predict stretches left out, else by the Bayesian information criterion, and
    laws are then allowed to be wrong by EXACT.
    """
    tuned, best = named.tuned, named.best
    unit = best.dispersion
    empty = fit_to(tuned, (), best.offset, unit)
    nothing = math.inf if empty is None else empty.cost(unit)

    def evidence(fitted: Fitted) -> float:
        if isinstance(tuned, Tuned) and not named.is_noise_known:
            return float(left_out(tuned, fitted).sum()) / unit
        return fitted.cost(unit) + len(fitted.parameters) * math.log(tuned.readings)

    own = evidence(best)
    wrong = EXACT**2 * max(nothing - best.cost(unit), 0.0) if named.is_noise_known and math.isfinite(nothing) else 0.0
    found = []
    for each in neighbours(tuned, best, of):
        one = each.fitted
        gained, behind = nothing - one.cost(unit), evidence(one) - own
        allowed = wrong if each.has_another else 0.0
        found.append(Alternative(one.settings, behind, each.without, each.has_another, gained, len(one.parameters), allowed))
    return sorted(found, key=lambda each: each.behind)


def deviations(named: Named, other: Fitted) -> np.ndarray:
    """Return standard deviations (P + Q,) of nuisances [of their prior] and of the answer's parameters.

    Where noise is assumed, no equation is quite right: what another view of the same recordings, in which fast misfits count more, gives
    for the same effects belongs to what is unsure, and so does what `other`, a fit to free runs, gives.
    """
    best = named.best
    scatter = scattered(best)
    if named.is_noise_known or not best.settings:
        return scatter
    _, fast = settled(named.seen.alongs, named.levels, best.offset, best.settings)
    views = [_coordinates(each) for each in (best, fast, other)]
    views = [each for each in views if len(each) == len(scatter)]
    return np.sqrt(scatter**2 + np.var(views, axis=0, ddof=1)) if len(views) > 1 else scatter


def detection_limits(named: Named, of: Library) -> list[Limit]:
    """Return the least strength of every effect at every place that would have been named beside the answer.

    It is the strength whose expected gain is what the search asks of an effect. Of laws with several weights the one that shows least
    counts. Families that were found at a place are left out there.
    """
    tuned, best = named.tuned, named.best
    taken = {(effects()[one.name].family, one.at) for one in best.settings}
    found = []
    for law, reduced, _ in beside_fit(best, of, best.dispersion):
        strengths = sum(parameter.is_strength for parameter in law.effect.parameters)
        asked = strengths * math.log(tuned.readings) + 2.0 * math.log(of.places)
        if named.is_noise_known:
            asked += NOT_TOLD_APART
        if not law.effect.everyday:
            asked += (named.materiality - 1.0) * best.squares / best.dispersion
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
            and all(_is_within(each, setting.parameters[each.name]) for each in strengths)
        }
        by = min(shown, default=math.inf)
        if by > off:
            off, least = by, shown.get(by)
    value = math.inf if least is None else least.parameters[first.name]
    return Limit(law.effect.name, law.at, first, value if first.neutral else abs(value), least)


def _beyond(limit: Limit) -> float:
    return abs(limit.strength - limit.parameter.neutral)


def _is_within(parameter: Parameter, value: float) -> bool:
    return value == parameter.neutral or parameter.low < value < parameter.high


def _coordinates(fitted: Fitted) -> np.ndarray:
    return np.append(fitted.offset, [fitted.settings[k].parameters[parameter.name] for k, parameter in fitted.parameters])
