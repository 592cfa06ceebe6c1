"""What an answer is worth, once the envelope is open."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from hil.diagnosis.result import Diagnosis, EffectAt
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

Worth = Literal["right", "listed", "in part", "silent", "wrong"]

Acting = tuple[str, str]
"""Family and place."""


@dataclass(frozen=True)
class Judged:
    """The worth of an answer, in a word and in a sentence.

    Attributes
    ----------
    worth : Worth
        `right`: what is named, `explained` or `ambiguous`, is of the hidden effects' families, at their places, no more and no less.
        `listed`: not so, but the answer calls itself ambiguous, and one of its sets is right. `in part`: it names some of what is hidden,
        and nothing else. `silent`: it names nothing.
    sentence : str
    """

    worth: Worth
    sentence: str


def judged(diagnosis: Diagnosis, hidden: tuple[EffectSetting, ...]) -> Judged:
    """Return what a diagnosis is worth beside what was hidden."""
    named = [finding.effect for finding in diagnosis.findings]
    truth, said = _acting((one.name, one.at) for one in hidden), _acting_at(named)
    was = " and ".join(in_words(one.name, one.at) for one in hidden) + (" was hidden" if len(hidden) == 1 else " were hidden")
    names = " and ".join(in_words(one.effect, one.at) for one in named)
    is_ambiguous = diagnosis.verdict == "ambiguous"
    if said == truth and (is_ambiguous or diagnosis.verdict == "explained"):
        doubt = ", and called it ambiguous" if is_ambiguous else ""
        is_law = {(one.name, one.at) for one in hidden} == {(one.effect, one.at) for one in named}
        law = "" if is_law else f"; {was}, of the same {'family' if len(hidden) == 1 else 'families'}"
        return Judged("right", f"Right: from the machine file and the recordings, the tool named {names}{doubt}{law}")
    if not named:
        return Judged("silent", f"Missed: the tool named nothing; {was}")
    if is_ambiguous and any(_acting_at(one) == truth for finding in diagnosis.findings for one in finding.ambiguous_sets):
        return Judged("listed", f"Not sure, and rightly so: the tool named {names}, and what was hidden among what else it may be; {was}")
    if said < truth:
        return Judged("in part", f"Half of it: the tool named {names}; {was}")
    return Judged("wrong", f"Wrong: the tool named {names}; {was}")


def in_words(effect: str, at: str) -> str:
    """Return an effect and its place as a reader says them."""
    return f"{effect.replace('_', ' ')} at {at.replace('_', ' ')}"


def _acting_at(named: Iterable[EffectAt]) -> Counter[Acting]:
    return _acting((one.effect, one.at) for one in named)


def _acting(named: Iterable[tuple[str, str]]) -> Counter[Acting]:
    return Counter((effects()[name].family, at) for name, at in named)
