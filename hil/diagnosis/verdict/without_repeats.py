"""The answer of free runs where nothing repeats: what is accepted, which numbers left their tolerance, and how well it predicts."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.audit.audit import Audit
from hil.diagnosis.likelihood.judge import Judge
from hil.diagnosis.location.mismatch import where_it_is
from hil.diagnosis.model_choice.alternatives import Alternative, Limit, least_shown
from hil.diagnosis.model_choice.fitting import Fitted
from hil.diagnosis.model_choice.fitting import fit as fit_linear
from hil.diagnosis.model_choice.search import NOT_TOLD_APART
from hil.diagnosis.observed.shaken import what_may_hide
from hil.diagnosis.prediction.open_runs import Predicted
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.residuals import Residuals
from hil.diagnosis.result import Diagnosis, EffectAt, Finding, Location, ParameterEstimate, RetunedValue, Verdict
from hil.diagnosis.retuning.linear_model import LinearModel, linear_at, nominal_offset
from hil.diagnosis.selection.rivals import Rival, parameters_of, shown
from hil.diagnosis.selection.select import Selected, is_closed, runs_of
from hil.diagnosis.unknowns.unknowns import Kind, Unknown
from hil.diagnosis.verdict.answer import (
    LEFT,
    NEXT_EXPERIMENT,
    NO_HELP,
    NOTHING_MISSING,
    SHOWN,
    limit_of,
    never_shown,
    proposed,
    recordings_of,
    separations_of,
    shares_of,
    unseen_at,
    verdict_of_audit,
)
from hil.diagnosis.verdict.findings import hypotheses_of, rivals_of, told, words
from hil.diagnosis.verdict.fit import fit_of, helps
from hil.diagnosis.verdict.values import Outcome, acting, known_effects, names_of, number_finding, unit_of, with_confidence
from hil.machine import Machine
from hil.recording import Recording
from virtual_bus.effects.bounds import effect_at
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

WITHIN_95, WITHIN_95_OF_FEW = 1.96, 3.18
"""Half widths of an interval in standard deviations: of many readings, and of the four stretches that differ (Student's t)."""
UNITS = {Kind.GAIN: "", Kind.LATENESS: "s", Kind.EARLY: "rows", Kind.EFFORT_LAG: "s"}


def answer_of_runs(
    machine: Machine, audit: Audit, residuals: Residuals, levels: Levels, selected: Selected, held_out: Mapping[str, Recording],
    began: float, report: Callable[[str, float], None],
) -> Outcome:  # fmt: skip
    """Return the answer that free runs selected; held-out recordings are scored, and may take assurance away."""
    search, fit, point = selected.search, selected.fit, selected.fit.point
    report("finding what would not have shown", 0.7)
    accepted = selected.accepted
    settings = tuple(point.settings[k] for k in accepted)
    half = _half_widths(selected)
    retuned, frozen, numbers = _numbers(selected, half)
    others = [_alternative(selected, accepted, one) for one in selected.rivals]
    noise = residuals.noise
    values = search.fitting.unknowns.machine(point).values
    rivals = rivals_of(settings, others)
    found = told(settings, others, rivals, _estimates(selected, accepted, half))
    limits = _limits(selected, accepted)
    train, held = _predicted(machine, selected, held_out, len(residuals.trajectories))
    unexplained = _unexplained(selected, bool(numbers))
    is_better = helps(held, "nominal" if numbers else "retuned")
    against = (NO_HELP,) if is_better is False else ()
    found, numbers = (tuple(replace(one, evidence_against=(*one.evidence_against, *against)) for one in each) for each in (found, numbers))
    unseen = unseen_at(machine, residuals, limits)
    verdict, reason = _verdict(audit, [*numbers, *found], others, unexplained, is_better, unseen, selected, settings)
    is_nothing = verdict in ("consistent", "inconclusive")
    if not found and not numbers and verdict != "inconclusive":
        reason = "; ".join([reason, what_may_hide(recordings_of(residuals)), *never_shown(limits)])
    linear, there = _linear_fit(selected, residuals, levels, values, settings)
    proposal = None
    if verdict == "ambiguous":
        proposal = proposed(machine, values, there.offset[: len(linear.numbers.indices)], settings, others, levels, residuals, report)
    if proposal is not None:
        found = tuple(replace(finding, separating_experiment=NEXT_EXPERIMENT) for finding in found)
    gained = 2.0 * (search.score(selected.plain) - search.score(fit))
    diagnosis = Diagnosis(
        verdict=verdict,
        reason=reason,
        findings=(*found, *numbers),
        hypotheses=hypotheses_of(settings, len(point.parameters), (gained, None), others, ()),
        retuned={} if is_nothing else retuned,
        frozen={} if is_nothing else frozen,
        noise=noise,
        location=Location() if verdict in ("consistent", "retuned") else where_it_is(residuals, linear, there),
        fit=fit_of(train, held, has_held_out=held_out != {}),
        unexplained_share=unexplained,
        seconds=time.monotonic() - began,
        lacking={residuals.trajectories[0].joints[joint]: share for joint, share in shares_of(residuals).items()},
        audit=audit.document(),
        detection_limits=tuple(limit_of(limit, machine.plant) for limit in limits),
        baseline=_baseline(selected),
        known=known_effects(machine.plant),
        separations=() if proposal is None else separations_of(proposal),
    )
    columns = np.vstack([np.moveaxis(each, 0, -1).reshape(-1, len(each)) for each in fit.columns]) if fit.columns else np.zeros((0, 0))
    names = [selected.unknowns.each[k].name for k in point.free]
    if is_nothing:  # the file stays as it is
        values, settings = selected.unknowns.plant.nominal, ()
    acts, told_of = acting(settings), (columns, (*names, *parameters_of(fit)))
    return Outcome(machine, with_confidence(diagnosis), names_of(residuals), residuals, values, acts, proposal, told_of)


def _alternative(selected: Selected, accepted: Sequence[int], rival: Rival) -> Alternative:
    """Return a rival as a set of effects beside those that are named."""
    settings = [selected.fit.point.settings[k] for k in accepted if k != rival.without]
    settings += rival.settings[-1:] if rival.has_another else ()
    gained = 2.0 * (selected.search.score(selected.plain) - selected.search.score(selected.fit)) - rival.behind
    return Alternative(tuple(settings), rival.behind, (accepted.index(rival.without),), rival.has_another, gained, rival.parameters)


def _half_widths(selected: Selected) -> np.ndarray:
    """Return half of the 95 % intervals (free + Q,) of unknowns and parameters."""
    bent, differ = selected.search.fitting.variances(selected.fit, selected.search.folded(selected.fit))
    half: np.ndarray = np.maximum(WITHIN_95 * np.sqrt(bent + differ), WITHIN_95_OF_FEW * np.sqrt(differ))
    return half


def _estimates(selected: Selected, accepted: Sequence[int], half: np.ndarray) -> list[dict[str, ParameterEstimate]]:
    """Return parameters with units and intervals, one table for each effect that is named."""
    point, plant = selected.fit.point, selected.unknowns.plant.settings
    reach = {(k, parameter.name): float(each) for (k, parameter), each in zip(point.parameters, half[len(point.free) :], strict=True)}
    tables = []
    for k in accepted:
        setting, table = point.settings[k], {}
        for parameter in effect_at(setting.name, setting.at, plant).parameters:
            value, by = float(setting.parameters[parameter.name]), reach.get((k, parameter.name), 0.0)
            low, high = max(value - by, parameter.low), min(value + by, parameter.high)
            table[parameter.name] = ParameterEstimate(value, unit_of(parameter, setting.at, plant), (min(low, value), max(high, value)))
        tables.append(table)
    return tables


def _numbers(selected: Selected, half: np.ndarray) -> tuple[dict[str, RetunedValue], dict[str, str], tuple[Finding, ...]]:
    """Return the numbers that the recordings show, what became of the others, and those that left their tolerance, as findings."""
    point, unknowns = selected.fit.point, selected.unknowns
    shown_numbers, frozen, found = {}, {}, []
    reach = dict(zip(point.free, half.tolist(), strict=False))
    for k, unknown in enumerate(unknowns.each):
        at, by = float(point.numbers[k]), reach.get(k, 0.0)
        unit = _unit(selected, unknown)
        low, high = sorted((unknown.value(at - by), unknown.value(at + by)))
        number = RetunedValue(unknown.nominal, unknown.value(at), unit, (low, high))
        if unknown.kind is Kind.NUMBER:
            if k in point.held:
                frozen[unknown.name] = f"other numbers do what it does; it stays at {unknown.nominal:.5g} {unit}".rstrip()
            elif by < SHOWN * WITHIN_95 or abs(at) > by:
                shown_numbers[unknown.name] = number
            else:
                frozen[unknown.name] = f"these recordings do not show it; machine.toml has {unknown.value(at):.5g} {unit}".rstrip()
        if abs(at) - by > 1.0:
            axes = " and ".join(drive.axis for drive in unknowns.plant.settings.drives)
            place = EffectAt(unknown.name, axes if unknown.kind is Kind.LATENESS else unknown.name.partition(".")[0])
            of = "" if unknown.recording is None else f" (recording {unknown.recording + 1})"
            found.append(number_finding(place, number, of))
    return shown_numbers, frozen, tuple(found)


def _unit(selected: Selected, unknown: Unknown) -> str:
    if unknown.kind is Kind.NUMBER:
        return selected.unknowns.plant.parameters[unknown.place].unit
    plant = selected.unknowns.plant.settings
    if unknown.kind in UNITS:
        return UNITS[unknown.kind]
    if unknown.kind is Kind.EFFORT_ZERO:
        return plant.drives[unknown.place].unit
    of_channel = {encoder.channel: encoder.joints[0] for encoder in plant.encoders}
    joint = plant.drives[unknown.place].joint if unknown.kind is Kind.SPEED_LIMIT else of_channel[unknown.name.removesuffix(".zero")]
    length = next("m" if each.kind == "prismatic" else "rad" for each in plant.tree.joints if each.name == joint)
    return f"{length}/s" if unknown.kind is Kind.SPEED_LIMIT else length


def _baseline(selected: Selected) -> tuple[Finding, ...]:
    """Return the engineer's fit."""
    baseline = replace(selected, fit=selected.baseline)
    settings = selected.baseline.point.settings
    tables = _estimates(baseline, range(len(settings)), _half_widths(baseline))
    return tuple(
        Finding(EffectAt(setting.name, setting.at), 0.5, table, family=effects()[setting.name].family)
        for setting, table in zip(settings, tables, strict=True)
    )


def _limits(selected: Selected, accepted: Sequence[int]) -> list[Limit]:
    """Return the least strength of every effect at every place that would have been named beside the answer."""
    search, fit = selected.search, selected.fit
    taken = {(effects()[fit.point.settings[k].name].family, fit.point.settings[k].at) for k in accepted}
    asked = ((law, squares, 2.0 * search.worth([law.setting(np.zeros(law.width))])) for law, squares in shown(selected.of))
    return least_shown([each for each in asked if (each[0].effect.family, each[0].at) not in taken])


def _unexplained(selected: Selected, from_the_file: bool) -> float:
    """Return the share that the answer leaves of what numbers alone leave, or the file: the mean of the longest horizon's ratios."""
    (nominal,) = selected.search.fitting.at([selected.unknowns.start()]) if from_the_file else (selected.plain,)
    if nominal is None:
        return 0.0
    ratios = selected.fit.mean_squares[-1] / nominal.mean_squares[-1]
    return min(1.0, math.exp(float(np.mean(np.log(ratios)))))


def _predicted(
    machine: Machine, selected: Selected, held_out: Mapping[str, Recording], recordings: int
) -> tuple[Predicted, Predicted | None]:
    """Return the errors of the machine at every stage over the longest horizon that was judged, in training and held out."""
    judge, unknowns = selected.search.fitting.judge, selected.unknowns
    stages = {"nominal": unknowns.start(), "retuned": selected.plain.point}
    stages |= {"baseline": selected.baseline.point, "extended": selected.fit.point}
    machines = [unknowns.machine(each) for each in stages.values()]
    tables: list[Predicted | None] = []
    can_run = bool(held_out) and (not selected.closed or is_closed(machine, held_out))
    for runs in (judge.runs, runs_of(machine, held_out, selected.closed, recordings)[1] if can_run else ()):
        if not runs or runs[0].channels != judge.runs[0].channels:
            tables.append(None)
            continue
        one = Judge(runs, judge.horizons[-1:], judge.jobs)
        spread = np.sqrt(np.nanvar(np.concatenate([run.recorded for run in runs]), axis=0))
        table: dict[str, dict[str, float]] = {channel: {} for channel in one.runs[0].channels}
        for stage, left in zip(stages, one.left(machines), strict=True):
            errors = np.full(len(table), np.inf) if left is None else np.sqrt(one.squares(left.errors)[0] / one.counts[0])
            for c, channel in enumerate(table):
                table[channel][stage] = float(errors[c] / spread[c]) if spread[c] > 0.0 else math.inf
        for c, channel in enumerate(table):
            table[channel]["noise"] = float(judge.noise[c] / spread[c]) if spread[c] > 0.0 else math.inf
        kept = {channel: stages for c, (channel, stages) in enumerate(table.items()) if spread[c] > 0.0}
        tables.append(Predicted(judge.horizons[-1], kept, "closed_loop" if selected.closed else "efforts"))
    train, held = tables
    assert train is not None
    return train, held


def _linear_fit(
    selected: Selected, residuals: Residuals, levels: Levels, values: np.ndarray, settings: Sequence[EffectSetting]
) -> tuple[LinearModel, Fitted]:
    """Return the answer along the recorded motion, for what it shows there."""
    offset = nominal_offset(residuals.trajectories)
    linear = linear_at(residuals.trajectories, levels, offset, settings)
    numbers = linear.numbers
    nominal = numbers.plant.nominal
    offset[: len(numbers.indices)] = (values[numbers.indices] - nominal[numbers.indices]) / numbers.scale
    linear = linear_at(residuals.trajectories, levels, offset, settings)
    there = fit_linear(linear, settings, offset, longest=0.0)
    assert there is not None
    return linear, there


def _verdict(
    audit: Audit, found: Sequence[Finding], others: Sequence[Alternative], unexplained: float, is_better: bool | None,
    unseen: Sequence[str], selected: Selected, settings: Sequence[EffectSetting],
) -> tuple[Verdict, str]:  # fmt: skip
    """Return the first verdict that applies, and why."""
    names = " and ".join(finding.name for finding in found)
    if (first := verdict_of_audit(audit, names, unseen)) is not None:
        return first
    if not found:
        (nominal,) = selected.search.fitting.at([selected.unknowns.start()])
        if nominal is None or 2.0 * (nominal.cost - selected.plain.cost) > NOT_TOLD_APART:
            return "retuned", f"other numbers in the machine file, within their tolerances, explain the difference; {NOTHING_MISSING}"
        return "consistent", NOTHING_MISSING
    near = [*rivals_of(settings, others), *(one for one in others if not one.has_another and one.told_apart < NOT_TOLD_APART)]
    if near:
        said = "; ".join(dict.fromkeys(words(other.settings) for other in near))
        return "ambiguous", f"{names}, which these recordings do not tell apart from {said}"
    if unexplained > LEFT:
        return "ambiguous", f"{names}, beside which something may act that is not accepted: {unexplained:.0%} of the mismatch is left"
    if is_better is False:
        return "ambiguous", f"{names}, but {NO_HELP}"
    return "explained", f"{names}: no other law or place predicts these recordings as well"
