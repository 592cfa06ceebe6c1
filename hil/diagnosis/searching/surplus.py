"""Sets that have an effect too many: what they gain by it is no more than chance, or an error of the others' equations."""

from __future__ import annotations

from collections.abc import Sequence

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.errors_of_laws import Removing, numbers_of, share_of_numbers, temperature, temperature_of, whole_signs_of
from hil.diagnosis.judging.gate import needed_gain
from hil.diagnosis.judging.judgement import Contender, Stand
from hil.diagnosis.judging.tried import Tried


def needs_all(fit: Fitted, stand: Stand, singles: Sequence[Fitted], base: float | None, tried: Tried, entries: int) -> bool:
    """Whether a pair without the chosen set gains more over each of its own effects than chance and, with the cost of no effect at all as
    `base`, that one's equation allow.
    """
    if set(stand.effects) <= set(fit.effects) and (stand.effects or len(fit.effects) == 1):
        return True
    for single in singles:
        if single.effects[0] in fit.effects:
            added = [effect for effect in fit.effects if effect not in single.effects]
            temper = 1.0 if base is None else _temper(single, fit, base, entries)
            if single.cost - fit.cost < temper * needed_gain(tried.sets(added), fit.freedom - single.freedom, fit.cost, entries):
                return False
    return True


def _temper(single: Fitted, fit: Fitted, base: float, entries: int) -> float:
    """In which what a pair gains over one of its effects counts: by what that one's equation errs, and by what the pair leaves."""
    removed = base - single.cost
    by_numbers, by_signs = (removed if of(single) else 0.0 for of in (numbers_of, whole_signs_of))
    by_numbers *= share_of_numbers(numbers_of(single))
    errs = temperature_of([Removing(single.cost, by_numbers, by_signs=by_signs)], base, single.cost)
    return errs + temperature(0.0, fit.cost - entries) - 1.0


def leaves_as_little(part: Fitted, larger: Fitted, tried: Tried, entries: int) -> bool:
    """Whether a set leaves no more than chance beyond one that it is a part of: what that one has more is surplus beside the others."""
    more = [effect for effect in larger.effects if effect not in part.effects]
    return part.cost - larger.cost < needed_gain(tried.sets(more), max(larger.freedom - part.freedom, 1), larger.cost, entries)


def has_no_surplus(fit: Fitted, stand: Stand, smaller: Sequence[Fitted], tried: Tried, entries: int) -> bool:
    """Whether a set gains more than chance over every part of it that was fitted before, the stand apart, which the gate asks about: an
    effect that stood for others is surplus beside them.
    """
    for part in smaller:
        if set(part.effects) < set(fit.effects) and set(part.effects) != set(stand.effects) and leaves_as_little(part, fit, tried, entries):
            return False
    return True


def parts_that_passed(one: Contender, singles: Sequence[Contender]) -> list[Contender]:
    """Smaller sets that are there for certain. A pair is judged against nothing, and beside such a part of it the other effect must gain
    more than chance, too: along its response noise may be stronger than the model says, which a pair's whole response hides.
    """
    return [part for part in singles if part.passed and set(part.fitted.effects) < set(one.fitted.effects)]
