"""How sure a name is: the evidence of every set of effects that was fitted, against each other, against nothing and against the unknown.

log evidence = -1/2 |residual|^2 / T on training and on held-out recordings - 1/2 sum over parameters of log(1 + information / T): a
parameter that the recordings narrow to one part in m of itself costs log m, one that they do not see nothing (MacKay 2003, ch. 28). A real
effect never has exactly the catalogue's equation: T > 1 (`errors_of_laws.py`) grows with what even the best set leaves and with a fixed
share of what it removes, so that two names are told apart only where they differ by more than an equation's form usually errs. Training and
held-out recordings have each its own T: an equation errs in one motion by a share of what it does in that motion. What a set leaves more
than the best one counts in units of what its own equations may err by, where that is less (`own_tempers`). The unknown is charged with
`unknown_freedom` parameters, each known as well as the energy that the best set removes would let it be, and leaves nothing above noise. It
is taken to be one law: as far as sets of several known effects are likely, it is charged with how seldom one law does what they do
(`rarity.py`); such a set pays, where noise is known, for how many there are of its size (`_evidence`). Two laws without a name at once are
not among what is weighed, and the concealed benchmark hides none. An order or frequency that was searched costs the logarithm of how many
were (`searched`).

Whether equations err is not known: sets are weighed with T and as sets that hold exactly, and both count (`exactness.py`), so that a name
stands alone only where both agree. What the best exact equation leaves is noise: training and held-out recordings count in units of the
level that it leaves in each, where that is above the noise model's (a disturbance is not the same in another motion). What even the best
set leaves above noise for certain, as a share of what there was to explain, is the weight of something without a name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special
import scipy.stats

from hil.diagnosis.fitting.information import Narrowed
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.errors_of_laws import WEIGHTS, Removing, Weights, likely_of, numbers_err_by, temperature, temperature_of
from hil.diagnosis.ranking.compared import Compared
from hil.diagnosis.ranking.exactness import Part, exactness, level_left
from hil.diagnosis.residuals.excess import certain_excess
from hil.diagnosis.result import EffectAt

LIKELIER = 0.5
"""Confidence of nothing from which no effect is named although one passed the gate, and share of sets without their form from which no name
stands alone."""

CONFIDENT = 0.9
"""Share of what has a name, with nothing and the unknown counted, from which one name stands alone. How often a name that stands alone is
wrong is in `outside`, which no experiment on the same machine tells: confidences carry it, the verdict `explained` does not wait for it."""

CAP_ASSUMED = 0.9
"""Largest share that a confidence speaks for without repeats: the noise, and with it every scale here, is assumed. Whether a name stands
alone is decided before."""

STANDS_ALONE = 0.78
"""Confidence of all that has a name, in place of what `outside` leaves it, where a name stands alone: of 244 answers in the concealed
benchmark that were `explained` by fits, 189 named all that is hidden and nothing else; their shares sum to 241."""

BY_CHANCE = 0.01
"""Probability with which further parameters gain by chance what a set of few may leave more than one of many."""

CAP_UNCONFIRMED = 0.5
"""Largest confidence of a set that did not pass the gate."""

HELD_OUT_COMMON = 0.012
"""Over x, the share of machines that hide nothing whose held-out misfit is above noise by more than the share x of it: of 31 such machines
seven are by more than 0.05, three by more than 0.1, one by 0.57."""

PLAUSIBLE = 0.02
"""A set at least this likely belongs to what cannot be told apart from the first."""

PLAUSIBLE_TOGETHER = 0.98
"""Share of the probability of all known sets that plausible ones have together at the least: less likely ones join them until they do. Of
them intervals are mixed, and from them the next experiment is to separate the likeliest."""

LISTED = 0.999
"""The same of those that are listed beside a name. Shares are surer than they are right: of 301 `ambiguous` answers in the concealed
benchmark where effects of the catalogue are hidden, sets of 0.98 held the truth in 237 and had 2.3 effects, of 0.999 in 243 with 2.8, of
0.99999 in 247 with 3.2. Of most others an effect that is hidden beside another hardly shows and is in no set."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """One hypothesis with its misfit on both parts. `fitted` None: nothing but the machine file's numbers."""

    fitted: Fitted | None
    train: float  # |residual|^2 + |offset|^2, of a set with effects plus what chance gains more where their strengths scatter (gate.py)
    held_out: float  # |residual|^2; 0 without held-out recordings
    information: tuple[float, ...] = ()  # of its parameters, see refit.py
    confidence: float = 0.0
    searched: float = 0.0  # logarithm of the number of shapes that were searched for its effects
    passed: bool = True  # the gate
    share: float = 0.0  # of what has a name, before any cap: what `explained` rests on
    by_numbers: tuple[float, float] = (0.0, 0.0)  # as in `Removing`, in training and held out
    by_signs: tuple[float, float] = (0.0, 0.0)  # so much of it those that are whole signs, which err by nothing
    of_the_file: bool = True  # whether these are all numbers of the machine file
    rarity: float = 0.0  # see rarity.py
    simpler: tuple[tuple[float, tuple[float, ...]], ...] = ()  # energy lost and information without some of its laws' terms
    narrowed: Narrowed | None = None  # what parameters that held-out recordings moved cost more
    compared: Compared | None = None  # with the set that gains most, of as many effects; None of others and of itself

    @property
    def misfit(self) -> float:
        return self.train + self.held_out

    def price(self, temper: float = 1.0) -> float:
        """What its parameters and its search cost in log evidence.

        Which of its laws' terms are there is not known: the evidence is the mean over all choices, so that a term that was fitted to
        nothing costs no more than the choice. A form without a term pays for what it loses in training only: held out, it counts with the
        misfit of the whole law.
        """
        each = [(0.0, self.information), *self.simpler]
        costs = [0.5 * (loss / temper + float(np.sum(np.log1p(np.array(seen) / temper)))) for loss, seen in each]
        moved = 0.0 if self.narrowed is None else self.narrowed.cost(temper, temper)
        return self.searched + moved - float(np.logaddexp.reduce([-cost for cost in costs])) + float(np.log(len(costs)))

    def priced_as(self, fitted: Fitted) -> Weighed:
        """With the information of a fit."""
        simpler = tuple((form.loss, tuple(form.information.tolist())) for form in fitted.simpler)
        return replace(self, fitted=fitted, information=tuple(fitted.information.tolist()), simpler=simpler)

    def in_units(self, train: float, held_out: float, form_error: float = 0.0) -> Weighed:
        """With misfits and information in units of these levels, in which is `form_error` of what effects removed."""
        information = tuple(i / train for i in self.information)
        simpler = tuple((loss / train, tuple(i / train for i in seen)) for loss, seen in self.simpler)
        narrowed = None if self.narrowed is None else self.narrowed.in_units(train, held_out)
        misfits = self.train / train, self.held_out / held_out
        if self.compared is not None:
            misfits = self.compared.in_units(0, train, form_error), self.compared.in_units(1, held_out, form_error)
        in_units = replace(self, train=misfits[0], held_out=misfits[1], compared=None)
        return replace(in_units, information=information, simpler=simpler, narrowed=narrowed)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Everything a ranking rests on.

    Attributes
    ----------
    sets : tuple of Weighed
        Every set that passed its own fit.
    base : Weighed
        Without effects.
    entries_train, entries_held_out : float
        Expected |residual|^2 of a perfect simulation.
    tried : int
        Candidates that were screened.
    found : bool
        Whether a set passed the gate.
    cap : float
        Largest share of what has a name.
    formless : tuple of Weighed
        Sets that would have passed but for their form (`form.py`): they are no names.
    is_noise_known : bool
        From repeats; else it is taken to be what the closest fit leaves in training.
    """

    sets: tuple[Weighed, ...]
    base: Weighed
    entries_train: float
    entries_held_out: float
    tried: int
    found: bool
    cap: float = 1.0
    formless: tuple[Weighed, ...] = ()
    is_noise_known: bool = True

    @property
    def entries(self) -> tuple[float, float]:
        return self.entries_train, self.entries_held_out


def ranking(evidence: Evidence, weights: Weights = WEIGHTS) -> tuple[Weighed, ...]:
    """Hypotheses with their confidence, the likeliest first.

    Nothing is among them where no set passed the gate, and where it is likelier than all that did together.
    """
    if not evidence.sets:
        return ()
    ranked, nothing = _weighed_with(evidence, evidence.sets, weights)
    if not evidence.found or nothing.confidence > LIKELIER:
        ranked.append(nothing)
    else:
        named = 1.0 - unnamed_share(evidence.base.train, ranked[0].train, evidence.entries_train)
        ranked = [replace(h, confidence=named * h.confidence, share=named * h.share) for h in ranked]
    ranked = [h if h.passed else replace(h, confidence=min(h.confidence, CAP_UNCONFIRMED)) for h in ranked]
    return tuple(sorted(ranked, key=lambda h: (-h.confidence, -h.share)))


def imitated(evidence: Evidence, weights: Weights = WEIGHTS) -> tuple[float, Weighed | None]:
    """Share that sets which lost their form would have beside the known ones, were they names, and the likeliest of them.

    What such a set fits better than every name does is there, and none of the names is it. Of sets of which one holds the other, or that
    were fitted twice, the likeliest counts: they are one another's imitations, and their shares together would be of one set.
    """
    if not evidence.formless or not evidence.sets:
        return 0.0, None

    def beside_names(formless: Sequence[Weighed]) -> list[Weighed]:
        """With their shares, the likeliest first."""
        ranked, _ = _weighed_with(evidence, (*evidence.sets, *formless), weights)
        own = {id(h.fitted) for h in formless}
        return [h for h in ranked if id(h.fitted) in own]

    formless = beside_names(_not_nested(beside_names(evidence.formless)))
    return sum(h.share for h in formless), formless[0]


def _not_nested(hypotheses: Sequence[Weighed]) -> list[Weighed]:
    """Those that neither hold nor are part of one before them."""
    kept: list[tuple[Weighed, set[EffectAt]]] = []
    for h in hypotheses:
        own = set() if h.fitted is None else set(h.fitted.effects)
        if not any(own <= other or other <= own for _, other in kept):
            kept.append((h, own))
    return [h for h, _ in kept]


def _weighed_with(evidence: Evidence, sets: Sequence[Weighed], weights: Weights) -> tuple[list[Weighed], Weighed]:
    return weighed(sets, evidence.base, evidence.entries, evidence.tried, evidence.cap, weights, is_noise_known=evidence.is_noise_known)


def weighed(
    hypotheses: Sequence[Weighed],
    base: Weighed,
    entries: tuple[float, float],
    tried: int,
    cap: float = 1.0,
    weights: Weights = WEIGHTS,
    *,
    is_noise_known: bool = True,
) -> tuple[list[Weighed], Weighed]:
    """Sets with their confidence, the likeliest first, and nothing with its own.

    Beforehand nothing is as likely as all sets together; each set is one of so many that were tried, in one of the shapes that were
    searched for it: the best of many gains by chance what one alone does not.

    Parameters
    ----------
    hypotheses : sequence of Weighed
    base : Weighed
        Without effects.
    entries : pair of float
        Expected |residual|^2 of a perfect simulation, training and held-out.
    tried : int
        Candidates.
    cap : float
        Largest share of what has a name.
    weights : Weights
    is_noise_known : bool
        See `Evidence`.
    """
    *shares, nothing = _shares(hypotheses, base, entries, tried, weights, is_noise_known)
    each = zip(hypotheses, shares, strict=True)
    sets = [replace(h, confidence=confidence_of(min(share, cap), weights), share=share) for h, share in each]
    return sorted(sets, key=lambda h: (-h.confidence, -h.share)), replace(base, confidence=min(nothing, cap), share=nothing)


def _shares(
    hypotheses: Sequence[Weighed], base: Weighed, entries: tuple[float, float], tried: int, weights: Weights, is_noise_known: bool
) -> list[float]:
    """Of every set and, last, of nothing."""
    train, held_out = tempers_of(hypotheses, base, entries, weights)
    best = min(hypotheses, key=lambda h: h.misfit)
    *tempered, nothing = (h.in_units(train, held_out, weights.form_error) for h in (*hypotheses, base))
    closest = tempered[hypotheses.index(best)]
    own = [own_tempers(h, best, base, entries, (train, held_out), weights) for h in hypotheses]
    each = zip(hypotheses, tempered, own, strict=True)
    tempered = [beside_the_best(h, as_all, best, closest, (train, held_out), levels, weights) for h, as_all, levels in each]
    left = best.in_units(train, held_out, weights.form_error).misfit
    evidence = _evidence(tempered, nothing, tried, is_noise_known)
    as_often = float(_normalised(evidence[:-1]) @ np.exp([-h.rarity for h in tempered]))  # as one law does what is there, mean over sets
    price = price_of_a_parameter(nothing.misfit - left, 1.0) * weights.unknown_freedom - float(np.log(as_often))
    of_signs = tempers_of(hypotheses, base, entries, weights, signs_err=True)
    unknown = -0.5 * left + for_the_unknown(best, entries, of_signs) - price
    shares = _normalised([*evidence, unknown])[:-1]
    *exact, nothing = in_units_of_what_is_left([*hypotheses, base], entries)
    removing = _removing(hypotheses, base, entries, signs_err=False)
    likely = [[one.by_numbers for one in likely_of(*each, weights) if one.of_the_file] for each in removing]
    by_numbers = [max([own, *others]) for own, others in zip(best.by_numbers, likely, strict=True)]
    parts = [Part(*each) for each in zip((best.train, best.held_out), (base.train, base.held_out), entries, by_numbers, strict=True)]
    parts[0] = parts[0]._replace(is_known=is_noise_known)
    share = exactness(parts, weights.exact, weights.form_error)
    return [float(s) for s in (1.0 - share) * shares + share * _normalised(_evidence(exact, nothing, tried, is_noise_known))]


def tempers_of(
    hypotheses: Sequence[Weighed], base: Weighed, entries: tuple[float, float], weights: Weights = WEIGHTS, *, signs_err: bool = False
) -> tuple[float, float]:
    """T of training and of held-out recordings; what is left within what repeats cannot tell from noise needs no name.

    Sets are told apart where whole signs err by nothing. What the best of them leaves is no evidence of something without a name where they
    err as other numbers do (`signs_err`): of 1.3e11 that a lost sign removes 2.5e-8 may be left, which is more than noise.
    """
    train, held_out = (temperature_of(*each, weights) for each in _removing(hypotheses, base, entries, signs_err=signs_err))
    return train, held_out


def _removing(
    hypotheses: Sequence[Weighed], base: Weighed, entries: tuple[float, float], *, signs_err: bool
) -> list[tuple[list[Removing], float, float]]:
    """What sets remove, misfit without effects and noise, of training and of held-out recordings."""
    found = []
    for part, noise in enumerate(entries):
        sets = [
            Removing((h.train, h.held_out)[part], h.by_numbers[part], h.of_the_file, 0.0 if signs_err else h.by_signs[part])
            for h in hypotheses
        ]
        found.append((sets, (base.train, base.held_out)[part], noise + certain_excess(noise)))
    return found


def own_tempers(
    h: Weighed, best: Weighed, base: Weighed, entries: tuple[float, float], tempers: tuple[float, float], weights: Weights = WEIGHTS
) -> tuple[float, float]:
    """T of training and of held-out recordings with what a set's own equations may err by, where that is less than the T of all.

    The best set's equations may err by much; one that removed most by numbers alone has them to blame for nothing. Were it right, what it
    leaves more would have no other reason than errors of its own few equations.
    """

    def own(part: int) -> float:
        left, of_best, before = ((each.train, each.held_out)[part] for each in (h, best, base))
        by_numbers, by_signs = max(h.by_numbers[part], 0.0), max(h.by_signs[part], 0.0)
        noise = entries[part] + certain_excess(entries[part])
        own_errors = temperature(before - left - by_numbers, of_best - noise, weights) + numbers_err_by(by_numbers, by_signs)
        return min(tempers[part], own_errors)

    return own(0), own(1)


def beside_the_best(
    h: Weighed,
    in_units: Weighed,
    best: Weighed,
    best_in_units: Weighed,
    tempers: tuple[float, float],
    own: tuple[float, float],
    weights: Weights = WEIGHTS,
) -> Weighed:
    """A set in units of T; what it leaves more than the best one, both motions together, counts in units of its own T, but for what the
    best one's further parameters gain by chance: they are paid for in units of T.

    Parameters
    ----------
    h, in_units : Weighed
        The set, and in units of `tempers`.
    best, best_in_units : Weighed
        The closest set.
    tempers, own : pairs of float
    weights : Weights
    """
    apart = in_units.train - best_in_units.train, in_units.held_out - best_in_units.held_out
    more = [max(each, 0.0) for each in apart]
    further = max(len(best.information) - len(h.information), 1)
    left, chance = h.misfit - best.misfit, float(scipy.stats.chi2.isf(BY_CHANCE, further))
    if h.compared is not None:
        left = sum(h.compared.reference) - best.misfit + sum(h.compared.beside_errors(part) for part in (0, 1))
        chance *= h.compared.scatter
    if sum(apart) <= 0.0 or left <= chance or not all(np.isfinite(more)):
        return in_units

    def unit(part: int, level: float) -> float:
        return level if h.compared is None else h.compared.unit(part, level, weights.form_error)

    stricter = sum(each * unit(part, tempers[part]) / unit(part, own[part]) for part, each in enumerate(more)) / sum(more)
    return replace(in_units, train=in_units.train + (1.0 - chance / left) * sum(apart) * (stricter - 1.0))


def for_the_unknown(best: Weighed, entries: tuple[float, float], tempers: tuple[float, float]) -> float:
    """What something without a name, which leaves nothing above noise, gains in log evidence over the best set.

    The noise of training is known from its repeats. Held out there are none, and a disturbance is not the same in another motion: what is
    left there speaks for the unknown by no more than it is rare where nothing is hidden.
    """
    train, held_out = (max(left - n - certain_excess(n), 0.0) for left, n in zip((best.train, best.held_out), entries, strict=True))
    rare = float(np.log(max(held_out / (HELD_OUT_COMMON * max(entries[1], 1.0)), 1.0)))
    return 0.5 * train / tempers[0] + min(0.5 * held_out / tempers[1], rare)


def in_units_of_what_is_left(sets: Sequence[Weighed], entries: tuple[float, float]) -> list[Weighed]:
    """Sets, nothing the last of them, whose misfits count in units of the noise's level in training and in held-out recordings: what the
    best set leaves there, where that is more than the noise model says, and what equations err by however exact they are.
    """
    best, base = min(sets, key=lambda h: h.misfit), sets[-1]
    each = zip((best.train, best.held_out), (base.train, base.held_out), entries, best.by_signs, strict=True)
    train, held_out = (level_left(Part(left, before, noise, by_signs=by_signs)) for left, before, noise, by_signs in each)
    return [h.in_units(train, held_out) for h in sets]


def not_told_apart(hypotheses: Sequence[Weighed], share: float = PLAUSIBLE_TOGETHER) -> list[Weighed]:
    """The likeliest set of effects and those that belong beside it, this share of what all have together; hypotheses are the likeliest
    first.
    """
    sets = [h for h in hypotheses if h.fitted is not None]
    whole = sum(h.confidence for h in sets)
    found: list[Weighed] = []
    together = 0.0
    for h in sets:
        if found and h.confidence < PLAUSIBLE and together >= share * whole:
            break
        found.append(h)
        together += h.confidence
    return found


def confidence_of(share: float, weights: Weights = WEIGHTS) -> float:
    """Confidence of a name that has this share of what has one: what is in no catalogue may have been imitated."""
    return share * (1.0 - weights.outside)


def standing_alone(confidence: float) -> float:
    """Confidence of what stands alone, from what it has as one of all names."""
    return confidence * STANDS_ALONE / confidence_of(1.0)


def _evidence(hypotheses: Sequence[Weighed], base: Weighed, tried: int, is_noise_known: bool) -> list[float]:
    """Of every set and, last, of nothing.

    Where noise is known, among themselves sets of k effects are as likely beforehand as there are fewer of them: one in N over k of N
    candidates. Together they are what they were, whatever their sizes: beside nothing and the unknown the gate has asked for every effect.
    An assumed noise is a bound from above, so that what a further effect gains counts too little already: there sets of any size are as
    likely.
    """
    nothing = -0.5 * base.misfit + float(np.log(max(tried, 1)))
    alone = np.array([-0.5 * h.misfit - h.price() for h in hypotheses])
    if not is_noise_known:
        return [*alone.tolist(), nothing]
    sizes = np.array([1 if h.fitted is None else max(len(h.fitted.effects), 1) for h in hypotheses])
    of_size = alone - np.log(scipy.special.binom(max(tried, int(sizes.max(initial=1))), sizes))
    among_sets = of_size + np.logaddexp.reduce(alone) - np.logaddexp.reduce(of_size)
    return [*among_sets.tolist(), nothing]


def _normalised(evidence: Sequence[float]) -> np.ndarray:
    shares = np.exp(np.array(evidence) - max(evidence))
    return shares / shares.sum()


def unnamed_share(before: float, after: float, noise: float) -> float:
    """What a set of effects leaves above noise for certain, as a share of what was above noise before."""
    return float(np.clip((after - noise - certain_excess(noise)) / max(before - noise, 1e-9), 0.0, 1.0))


def price_of_a_parameter(removed: float, temper: float) -> float:
    """What a parameter costs in log evidence that is known as well as this energy lets it be."""
    return 0.5 * float(np.log1p(max(removed, 0.0) / temper))
