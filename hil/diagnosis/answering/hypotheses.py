"""What is said of hypotheses and of what is read off: what they gain and take, and what the next experiment is to separate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.held_out import NOT_FOLLOWED
from hil.diagnosis.judging.judgement import Contender
from hil.diagnosis.ranking.naming import CAP_ASSUMED, Weighed, not_told_apart
from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.result import READ_OFF, EffectAt, Finding, Fit, Hypothesis, PredictedSeparation
from hil.diagnosis.separating.next_experiment import Proposal

MOST_RIVALS = 3
"""Hypotheses that one experiment is asked to separate."""


def hypothesis_of(weighed: Weighed, contenders: Sequence[Contender], read_off: Sequence[EffectAt], has_held_out: bool) -> Hypothesis:
    """What is said of a weighed set.

    Parameters
    ----------
    weighed : Weighed
    contenders : sequence of Contender
        With the set among them, if it has effects.
    read_off : sequence of EffectAt
        What recordings show by themselves, which is part of every set.
    has_held_out : bool
    """
    fitted = weighed.fitted
    contender = next((one for one in contenders if fitted is not None and one.fitted is fitted), None)
    gained, gained_held_out = (0.0, 0.0) if contender is None else contender.uncharged
    return Hypothesis(
        (*(() if fitted is None else fitted.effects), *read_off),
        weighed.confidence,
        gained=gained,
        gained_held_out=gained_held_out if has_held_out and abs(gained_held_out) < 0.5 * NOT_FOLLOWED else None,
        parameters=0 if fitted is None else fitted.freedom,
        is_confirmed=bool(read_off) if fitted is None else weighed.passed,
    )


def read_off_findings(found: Mismatch) -> tuple[Finding, ...]:
    """What training recordings show by themselves, no surer than anything is where their noise is assumed."""
    most = CAP_ASSUMED if found.noise.kind == "assumed" else READ_OFF
    findings = (what.finding(channel) for channel, what in found.read_off)
    return tuple(replace(finding, confidence=min(finding.confidence, most)) for finding in findings)


def rivals_of(hypotheses: tuple[Weighed, ...]) -> list[Weighed]:
    """The likeliest set and those that the next experiment is to separate it from."""
    return list(not_told_apart(hypotheses)[:MOST_RIVALS])


def predicted(proposal: Proposal, sets: Sequence[Fitted | None]) -> tuple[PredictedSeparation, ...]:
    """Separations of the likeliest of the sets from the others, of which the proposal is."""
    others = [fitted.effects for fitted in sets if fitted is not None][1:]
    return tuple(
        PredictedSeparation(effects, float(if_first), float(if_other))
        for effects, (if_first, if_other) in zip(others, proposal.separations, strict=True)
    )


def against_held_out(fit: Fit) -> list[str]:
    """Evidence against a set with which the held-out simulation, its numbers as training left them, is no closer."""
    judged = fit.held_out
    if judged is None or judged.retuned is None or judged.extended is None or judged.extended < judged.retuned:
        return []
    return [f"with training's numbers held-out E does not fall: {judged.retuned:.4g} re-tuned, {judged.extended:.4g} with all effects"]
