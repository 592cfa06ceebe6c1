"""Answers that take no search: nothing moves, the recordings are not what they say, play is seen; and the first answer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from hil.diagnosis.audit.audit import Audit
from hil.diagnosis.audit.sensors import SensorAudit
from hil.diagnosis.model_choice.fitting import Fitted
from hil.diagnosis.residuals.residuals import Residuals
from hil.diagnosis.result import Diagnosis, EffectAt, Finding, Hypothesis, Location, ParameterEstimate
from hil.diagnosis.verdict.values import WITHIN_95, Outcome, baseline_of, known_effects, names_of, unit_of, with_confidence
from hil.machine import Machine
from hil.recording import Recording
from virtual_bus.effects.registry import effects
from virtual_bus.plant.parameters import plant_parameters


def nothing_moves(machine: Machine, audit: Audit, residuals: Residuals, seconds: float) -> Outcome:
    """Return the answer to recordings in which nothing moves."""
    still = residuals.still
    diagnosis = Diagnosis(
        verdict="inconclusive",
        reason=f"{', '.join(still)} {'does' if len(still) == 1 else 'do'} not move in these recordings: excite every axis",
        noise=residuals.noise, unexplained_share=0.0, seconds=seconds, audit=audit.document(), known=known_effects(machine.plant),
    )  # fmt: skip
    return Outcome(machine, with_confidence(diagnosis), names_of(residuals), None, residuals.trajectories[0].plant.nominal, ())


def wrong_recordings(machine: Machine, audit: Audit, recordings: Mapping[str, Recording], seconds: float) -> Outcome:
    """Return the answer to recordings that are not what they say: nothing is explained by them."""
    lacks = all(fault.is_lack for fault in audit.faults)
    counts = Counter(fault.channel for fault in audit.faults)
    diagnosis = Diagnosis(
        verdict="inconclusive" if lacks else "misconfigured",
        reason="; ".join(fault.said for fault in audit.faults),
        noise="assumed", location=Location(channels={channel: count / counts.total() for channel, count in counts.items()}),
        seconds=seconds, audit=audit.document(),
    )  # fmt: skip
    values = np.array([parameter.value for parameter in plant_parameters(machine.plant)])
    return Outcome(machine, diagnosis, tuple(recordings), None, values, ())


def play_measured(machine: Machine, audit: Audit, residuals: Residuals, seconds: float) -> Outcome:
    """Return the answer where two encoders show play between them: what else is missing shows once it is modelled."""
    noise = residuals.noise
    found = tuple(_play(machine, each) for each in audit.sensors if each.gap > 0.0)
    names = " and ".join(str(finding.effect) for finding in found)
    said = "; ".join(each.said for each in audit.sensors if each.gap > 0.0)
    diagnosis = Diagnosis(
        verdict="misconfigured" if audit.wrong else "explained",
        reason=f"{'; '.join([*audit.wrong, ''])}{names}: {said}. What else is missing shows once the machine file has this play",
        findings=found, hypotheses=(Hypothesis(tuple(one.effect for one in found), 1.0, is_confirmed=True),),
        noise=noise, location=Location(channels={each.second: 1.0 / len(found) for each in audit.sensors if each.gap > 0.0}),
        seconds=seconds, audit=audit.document(), known=known_effects(machine.plant),
    )  # fmt: skip
    return Outcome(machine, with_confidence(diagnosis), names_of(residuals), None, residuals.trajectories[0].plant.nominal, ())


def _play(machine: Machine, one: SensorAudit) -> Finding:
    """Return what two encoders show by themselves."""
    axis = one.first.removeprefix("position_")
    effect = next(effect for effect in effects().values() if effect.play)
    gap = next(parameter for parameter in effect.parameters if parameter.name == effect.play)
    reach = WITHIN_95 * one.scatter
    half = 0.5 * one.gap
    table = {gap.name: ParameterEstimate(half, unit_of(gap, axis, machine.plant), (half - reach, half + reach))}
    return Finding(EffectAt(effect.name, axis), 1.0, table, evidence_for=(one.said,), family=effect.family)


def first_answer(machine: Machine, audit: Audit, residuals: Residuals, baseline: Fitted, seconds: float) -> Diagnosis:
    """Return what can be said once the engineer's fit is there: it is marked provisional."""
    fitted = baseline_of(machine, baseline)
    diagnosis = Diagnosis(
        verdict="misconfigured" if audit.wrong else "ambiguous",
        reason="; ".join(audit.wrong) or "first answer: friction of every driven joint, fitted as an engineer would; the search goes on",
        findings=tuple(one for one in fitted if _is_sure(one)), noise=residuals.noise, seconds=seconds, audit=audit.document(),
        baseline=fitted, provisional=True, known=known_effects(machine.plant),
    )  # fmt: skip
    return with_confidence(diagnosis)


def _is_sure(finding: Finding) -> bool:
    return all(estimate.ci95[0] * estimate.ci95[1] > 0.0 for estimate in finding.parameters.values())
