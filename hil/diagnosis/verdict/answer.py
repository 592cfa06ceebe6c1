"""From what was named to the answer."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.audit.audit import Audit
from hil.diagnosis.audit.audit import audit as audit_of
from hil.diagnosis.free_runs.runs import FreeRuns, lacking
from hil.diagnosis.location.mismatch import where_it_is
from hil.diagnosis.model_choice.alternatives import (
    Alternative,
    Limit,
    alternatives,
    detection_limits,
    deviations,
    gained_by,
    is_spanned,
    numbers_help,
    simpler_choice,
    times_noise,
    unexplained,
)
from hil.diagnosis.model_choice.choose import Choice
from hil.diagnosis.model_choice.fitting import NOISE_MARGIN, Fitted, fit
from hil.diagnosis.model_choice.noise_matching import matched
from hil.diagnosis.model_choice.search import NOT_TOLD_APART, library
from hil.diagnosis.next_experiment.proposal import Proposal, propose
from hil.diagnosis.next_experiment.separation import Model
from hil.diagnosis.observed.shaken import what_may_hide
from hil.diagnosis.prediction.closed_runs import closed_runs
from hil.diagnosis.prediction.one_ahead import one_ahead
from hil.diagnosis.prediction.open_runs import Predicted, predicted
from hil.diagnosis.prediction.refitting import refitted
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.residuals import Residuals, residuals_of
from hil.diagnosis.result import (
    DetectionLimit,
    Diagnosis,
    EffectAt,
    Finding,
    Fit,
    Location,
    PredictedSeparation,
    RetunedValue,
    Verdict,
)
from hil.diagnosis.retuning.linear_model import LinearModel, linear_at
from hil.diagnosis.verdict.far_off import far_off
from hil.diagnosis.verdict.findings import Names, hypotheses_of, rivals_of, told, weights, words
from hil.diagnosis.verdict.fit import fit_of, helps
from hil.diagnosis.verdict.values import (
    WITHIN_95,
    Outcome,
    acting,
    baseline_of,
    estimates_of,
    known_effects,
    names_of,
    shown_findings,
    unit_of,
    with_confidence,
)  # fmt: skip
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Recording
from virtual_bus.effects.effect import FRICTION
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting, PlantSettings

NEXT_EXPERIMENT = "next_experiment.toml"
"""File of the experiment that would tell rivals apart."""
MOST_RIVALS = 3
"""That it is sought for."""
SHOWN = 0.5
"""Of a number's prior, in which its standard deviation must be that recordings show it."""
MOST_HIDDEN = 3
"""Effects that would not have shown, named in the sentence; all are among the detection limits."""
HELD_OUT = 2.0
"""Times the noise of the repeats that another motion, of which there are none, may have."""
LEFT = 0.1
"""Share of what numbers alone leave that an answer may leave and have explained it."""
EFFECTS_CHOSEN, WEIGHED = 0.75, 0.9
"""Share of the whole when effects are named along the motion, and when rivals begin to be weighed for good."""
NO_HELP = "with it, recordings that were held out are not predicted better"
NOTHING_MISSING = "no physics larger than the detection limits is missing"


def answer(
    machine: Machine,
    audit: Audit,
    choice: Choice,
    held_out: Mapping[str, Recording],
    began: float,
    report: Callable[[str, float], None] = lambda what, share: None,
    again: Callable[[Choice], Choice | None] | None = None,
    given_up: Names = frozenset(),
) -> Outcome:
    """Return the answer to what was named; held-out recordings may take assurance away. `began` is when (`time.monotonic`).

    `given_up` is the set that a simpler one took the place of: it stays a rival.

    Where the answer is not sure, what is named `again` is answered instead, if anything is.
    """
    report("weighing rivals", WEIGHED if again is None else EFFECTS_CHOSEN)
    before, choice = {fitted.names: fitted for _, fitted in choice.sets}, refitted(choice)
    weighed = before.get(choice.best.names, choice.best)
    judged = replace(choice, best=weighed)  # rivals are weighed along the motion, where equations are linear
    linear, best, residuals, noise = choice.linear, choice.best, choice.residuals, choice.residuals.noise
    of = library(linear, weighed, choice.of if isinstance(linear, LinearModel) else None)  # limits are beside the answer
    choice, judged = replace(choice, of=None), replace(judged, of=None)
    others = alternatives(judged, of) if best.settings else []
    if (simpler := simpler_choice(choice, others)) is not None:
        del of  # as much as all else together
        return answer(machine, audit, simpler, held_out, began, report, again, best.names)
    spread = deviations(judged, best)
    shown = shown_findings(machine, residuals)
    retuned, frozen = _numbers(linear, best, spread)
    values = linear.numbers.values(best.offset[: len(linear.numbers.indices)])
    far = far_off(machine, linear, best, spread, retuned) if isinstance(linear, LinearModel) else ()
    limits = detection_limits(judged, of)
    del of  # it would fill the memory beside that of free runs
    nearest = sorted((other for other in others if other.has_another), key=lambda other: other.told_apart)[:MOST_RIVALS]
    train, *unseen = _predicted(machine, choice, held_out, nearest)
    held = unseen[0] if unseen else None
    for near_one in nearest if (left := {} if held is None else held.squares) else ():
        behind = (left[words(near_one.settings)] - left["extended"]) / best.dispersion
        others[others.index(near_one)] = replace(near_one, held_out=behind)
    others.sort(key=lambda other: other.told_apart)
    rivals = rivals_of(best.settings, others, given_up)
    found = told(best.settings, others, rivals, estimates_of(machine.plant, best, spread))
    errors, gained = fit_of(train, held, has_held_out=held_out != {}), None if held is None else held.gained
    is_better = not best.settings or helps(held, "retuned") is not False
    against = () if is_better else (NO_HELP,)
    findings = (*(replace(one, evidence_against=(*one.evidence_against, *against)) for one in found), *shown, *far)
    near = [*rivals, *(one for one in others if not one.has_another and one.told_apart < NOT_TOLD_APART)]
    verdict, reason = _verdict(audit, judged, findings, near, unseen_at(machine, residuals, limits), errors, is_better)
    if again is not None and verdict in ("ambiguous", "unknown_physics") and (other := again(judged)) is not None:
        return answer(machine, audit, other, held_out, began, report)
    if imposed := residuals.trajectories[0].observed.imposed:
        reason += f"; no effort of {', '.join(imposed)} was recorded: its motion is given, and sensors are judged by each other"
    if not findings and verdict not in ("inconclusive", "misconfigured"):
        reason = "; ".join([reason, what_may_hide(recordings_of(residuals)), *never_shown(limits)])
    model, there = (linear, weighed) if isinstance(linear, LinearModel) else _linear_fit(choice)
    proposal = None
    if verdict == "ambiguous":
        offset = judged.best.offset[: len(linear.numbers.indices)]
        levels = matched(judged.levels, *_linear_fit(judged)) if isinstance(linear, FreeRuns) else judged.levels
        proposal = proposed(residuals.machine, linear.numbers.values(offset), offset, judged.best.settings, near, levels, residuals, report)
    if proposal is not None:
        findings = tuple(replace(finding, separating_experiment=NEXT_EXPERIMENT) for finding in findings)
    diagnosis = Diagnosis(
        verdict=verdict,
        reason=reason,
        findings=findings,
        hypotheses=hypotheses_of(
            best.settings, len(best.parameters), (gained_by(judged), gained), others, tuple(one.effect for one in shown)
        ),
        retuned=retuned,
        frozen=frozen,
        noise=noise,
        location=Location() if verdict in ("consistent", "retuned") else where_it_is(residuals, model, there),
        fit=errors,
        unexplained_share=unexplained(judged),
        seconds=time.monotonic() - began,
        lacking={residuals.trajectories[0].joints[joint]: share for joint, share in shares_of(residuals).items()},
        audit=audit.document(),
        detection_limits=tuple(limit_of(limit, machine.plant) for limit in limits),
        baseline=baseline_of(machine, choice.baseline),
        known=known_effects(machine.plant),
        separations=() if proposal is None else separations_of(proposal),
    )
    acts = *acting(best.settings), *(one.setting for one in residuals.shown)
    return Outcome(machine, with_confidence(diagnosis), names_of(residuals), residuals, values, acts, proposal, _columns(choice))


def _columns(choice: Choice) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return what numbers and the answer's parameters change, and their names."""
    best, numbers = choice.best, choice.linear.numbers
    count = len(numbers.indices)
    kept = [*range(count), *range(len(best.offset), len(best.offset) + len(best.parameters))]
    names = (*numbers.names, *(f"{best.settings[k].name} at {best.settings[k].at}: {parameter.name}" for k, parameter in best.parameters))
    return np.vstack([each[:, kept] for each in best.columns]), names


def _linear_fit(choice: Choice) -> tuple[LinearModel, Fitted]:
    """Return the answer of free runs along the recorded motion."""
    best = choice.best
    linear = linear_at(choice.residuals.trajectories, choice.levels, best.offset, best.settings)
    return linear, fit(linear, best.settings, best.offset, longest=0.0) or best


def proposed(
    machine: Machine, values: np.ndarray, offset: np.ndarray, settings: Sequence[EffectSetting], others: Sequence[Alternative],
    levels: Levels, residuals: Residuals, report: Callable[[str, float], None],
) -> Proposal | None:  # fmt: skip
    """Return the experiment that separates an answer, with its numbers and the same as nuisances, from sets that are nearly as likely."""
    near = [other for other in others if other.told_apart < NOT_TOLD_APART]
    own, shares = weights(near)
    rivals = [Model(values, offset, other.settings, share) for other, share in zip(near, shares, strict=True)]
    models = [Model(values, offset, tuple(settings), own), *rivals[:MOST_RIVALS]]
    told = residuals.trajectories[0].observed.channels, residuals.by
    return propose(machine, models, levels.of(1), *told, lambda share: report("looking for the next experiment", 0.95 + 0.05 * share))


def separations_of(proposal: Proposal) -> tuple[PredictedSeparation, ...]:
    """Return how far an experiment separates the answer from each rival."""
    rivals = [tuple(EffectAt(one.name, one.at) for one in model.effects) for model in proposal.models[1:]]
    return tuple(PredictedSeparation(rival, *map(float, d)) for rival, d in zip(rivals, proposal.separations, strict=True))


def recordings_of(residuals: Residuals) -> dict[str, Recording]:
    """Return the recordings by name."""
    return {repeat.name: repeat.recording for group in residuals.groups for repeat in group.repeats}


def never_shown(limits: Sequence[Limit]) -> list[str]:
    """Return in words which effects would not have shown at any strength that the catalogue allows."""
    hidden = [f"{limit.effect} at {limit.at}" for limit in limits if not math.isfinite(limit.strength)]
    if not hidden:
        return []
    more = f" and {len(hidden) - MOST_HIDDEN} more" if len(hidden) > MOST_HIDDEN else ""
    return [f"not even the largest would have shown of {', '.join(hidden[:MOST_HIDDEN])}{more} (detection limits)"]


def verdict_of_audit(audit: Audit, names: str, unseen: Sequence[str]) -> tuple[Verdict, str] | None:
    """Return the verdict where recordings show too little, or are not what the file says; None where physics decides.

    `names` are those of what was found, `unseen` the axes at which not even friction would have shown.
    """
    if unseen and not names:
        said = f"friction as large as all effort would not have shown at {', '.join(unseen)}: excite it more, or for longer"
        return "inconclusive", "; ".join([said, *audit.wrong])
    if audit.wrong:
        said = "; ".join(audit.wrong)
        return "misconfigured", said + (f"; beside it, the recorded efforts show {names}" if names else "; beside it no physics shows")
    return None


def _verdict(
    audit: Audit,
    choice: Choice,
    findings: Sequence[Finding],
    near: Sequence[Alternative],
    unseen: Sequence[str],
    errors: Fit,
    is_better: bool,
) -> tuple[Verdict, str]:
    """Return the first verdict that applies, and why."""
    names = " and ".join(finding.name for finding in findings)
    if (first := verdict_of_audit(audit, names, unseen)) is not None:
        return first
    if not is_spanned(choice):
        left = f"{math.sqrt(times_noise(choice)):.2f} times what noise leaves"
        said = f"{names} {'explains' if len(findings) == 1 else 'explain'} a part; " if findings else ""
        return "unknown_physics", f"{said}what is left is {left}, and no known effect explains it"
    if not findings:
        if numbers_help(choice):
            return "retuned", f"other numbers in the machine file explain the difference; {NOTHING_MISSING}"
        return "consistent", NOTHING_MISSING
    numbers = [other.effect for finding in findings if finding.kind == "number" for other in finding.ambiguous_with]
    if near or numbers:
        said = "; ".join(dict.fromkeys([*(words(other.settings) for other in near), *numbers]))
        return "ambiguous", f"{names}, which these recordings do not tell apart from {said}"
    if (power := times_noise(choice)) > 1.0 + NOISE_MARGIN and choice.is_noise_known:
        return (
            "ambiguous",
            f"{names}, beside which something may act that no known effect explains: what is left has {power:.2f} times the power of noise",
        )
    if not choice.is_noise_known and not choice.residuals.trajectories[0].followed.all():
        return "ambiguous", f"{names}, if disturbances at joints that no encoder follows are small: record repeats, which show them"
    removed = errors.removed_share or 0.0
    if choice.is_noise_known and errors.held_out is not None and (errors.held_out.extended or 0.0) > HELD_OUT and removed < 1.0 - LEFT:
        return "ambiguous", f"{names}, as these recordings show; of those held out {1.0 - removed:.0%} of the mismatch is left"
    if not is_better:
        return "ambiguous", f"{names}, but {NO_HELP}"
    return "explained", f"{names}: no other law or place explains these recordings as well"


def unseen_at(machine: Machine, residuals: Residuals, limits: Sequence[Limit]) -> list[str]:
    """Return the axes at which dry friction would not have shown, were it as large as all effort."""
    efforts: dict[str, float] = {}
    for each in residuals.missing():
        efforts[each.joint] = max(efforts.get(each.joint, 0.0), float(np.sqrt(np.mean(each.given**2))))
    axes = {drive.axis: efforts[drive.joint] for drive in machine.plant.drives if drive.joint in efforts}
    dry = [limit for limit in limits if effects()[limit.effect].everyday and effects()[limit.effect].kind is FRICTION]
    hidden = {limit.at for limit in dry if limit.parameter.unit == "Nm" and not limit.strength < axes.get(limit.at, 0.0)}
    return [axis for axis in axes if axis in hidden]


def _numbers(linear: LinearModel | FreeRuns, fitted: Fitted, spread: np.ndarray) -> tuple[dict[str, RetunedValue], dict[str, str]]:
    """Return the numbers that the recordings show, and what became of the others."""
    numbers = linear.numbers
    values = numbers.values(fitted.offset[: len(numbers.indices)])
    shown, frozen = {}, {}
    for k, index in enumerate(numbers.indices):
        parameter, value = numbers.plant.parameters[index], float(values[index])
        name = f"{parameter.owner}.{parameter.quantity}"
        is_free = numbers.low[k] < numbers.high[k]
        if is_free and spread[k] < SHOWN:
            reach = WITHIN_95 * float(spread[k] * numbers.scale[k])
            shown[name] = RetunedValue(parameter.value, value, parameter.unit, (value - reach, value + reach))
            if fitted.offset[k] >= numbers.high[k] or (fitted.offset[k] <= numbers.low[k] and numbers.low[k] < 0.0):
                frozen[name] = f"lies on the end of its tolerance, {value:.5g} {parameter.unit}".rstrip()
        elif is_free:
            frozen[name] = f"these recordings do not show it; machine.toml has {value:.5g} {parameter.unit}".rstrip()
        else:
            frozen[name] = f"is not told apart from the scale of all efforts; it stays at {value:.5g} {parameter.unit}".rstrip()
    return shown, {name: why for name, why in frozen.items() if name not in shown or why.startswith("lies")}


def _predicted(
    machine: Machine, choice: Choice, held_out: Mapping[str, Recording], nearest: Sequence[Alternative]
) -> tuple[Predicted | None, ...]:
    """Return the errors of the machine at every stage, in training and, where there are such recordings, held out, by the same measure.

    Held out, those of the nearest alternatives are beside them.

    In free runs of the closed loop where these judged and the held-out controller is known; else row by row where noise is known, and in
    free runs by the recorded efforts where it is not.
    """
    sets = [choice.residuals, *([residuals_of(choice.residuals.machine, held_out, choice.residuals)] if held_out else [])]
    numbers = choice.linear.numbers
    count = len(numbers.indices)
    fits = {"retuned": choice.plain, "baseline": choice.baseline, "extended": choice.best}
    stages = {"nominal": (np.zeros(count), ()), **{name: (each.offset[:count], each.settings) for name, each in fits.items()}}
    if isinstance(choice.linear, FreeRuns) and not (held_out and lacking(sets[-1], audit_of(machine, held_out))):
        try:
            return tuple(closed_runs(choice.linear, residuals, stages) for residuals in sets)
        except RecordingError:
            pass
    if not choice.levels.are_assumed:
        theirs = {words(other.settings): (other.offset[:count], other.settings) for other in nearest}
        return tuple(one_ahead(choice, residuals, stages | own) for residuals, own in zip(sets, ({}, theirs), strict=False))
    channels = choice.residuals.trajectories[0].observed.channels
    scales = dict(zip(channels, choice.levels.sensors.tolist(), strict=False))  # efforts follow them
    machines = {name: (numbers.values(offset), own) for name, (offset, own) in stages.items()}
    return tuple(predicted(residuals.trajectories, scales, machines, "extended") for residuals in sets)


def shares_of(residuals: Residuals) -> dict[int, float]:
    """Return every driven joint's share of the missing effort's power, each in units of the effort on it."""
    trajectory = residuals.trajectories[0]
    power: dict[int, float] = {}
    for each in residuals.missing():
        joint = trajectory.joints.index(each.joint)
        power[joint] = power.get(joint, 0.0) + each.share**2
    total = sum(power.values())
    return {joint: value / total for joint, value in power.items()} if total > 0.0 else {}


def limit_of(limit: Limit, settings: PlantSettings) -> DetectionLimit:
    """Return a limit with its unit."""
    strength = limit.strength if math.isfinite(limit.strength) else None
    return DetectionLimit(EffectAt(limit.effect, limit.at), limit.parameter.name, strength, unit_of(limit.parameter, limit.at, settings))
