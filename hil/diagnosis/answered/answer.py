"""From what was named to the answer."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.answered.values import (
    LARGEST,
    WITHIN_95,
    Answered,
    acting,
    baseline_of,
    estimates_of,
    known_effects,
    names_of,
    shown_findings,
    unit_of,
)  # fmt: skip
from hil.diagnosis.audit.audit import Audit
from hil.diagnosis.audit.audit import audit as audit_of
from hil.diagnosis.free_runs.runs import FreeRuns, lacking
from hil.diagnosis.locating.answered import where_it_is
from hil.diagnosis.named.fitting import LEVEL, Fitted, fit
from hil.diagnosis.named.matching import matched
from hil.diagnosis.named.naming import Named
from hil.diagnosis.named.search import NOT_TOLD_APART, library
from hil.diagnosis.named.standing import (
    Alternative,
    Limit,
    alternatives,
    detection_limits,
    deviations,
    gained_by,
    is_spanned,
    numbers_help,
    times_noise,
    unexplained,
)
from hil.diagnosis.observed.shaken import what_may_hide
from hil.diagnosis.predicted.closed_runs import closed_runs
from hil.diagnosis.predicted.one_ahead import one_ahead
from hil.diagnosis.predicted.open_runs import Predicted, predicted
from hil.diagnosis.predicted.refitting import refitted
from hil.diagnosis.result import (
    DetectionLimit,
    Diagnosis,
    EffectAt,
    Estimate,
    Finding,
    Fit,
    Hypothesis,
    Location,
    PredictedSeparation,
    RetunedValue,
    Stages,
    Verdict,
)
from hil.diagnosis.seen.beside import Levels
from hil.diagnosis.seen.see import Seen, see
from hil.diagnosis.separating.next_experiment import Proposal, propose
from hil.diagnosis.separating.separation import Model
from hil.diagnosis.tuned.retuning import Tuned, tuned_at
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
MOST_HYPOTHESES = 12
MOST_HIDDEN = 3
"""Effects that would not have shown, named in the sentence; all are among the detection limits."""
HELD_OUT = 2.0
"""Times the noise of the repeats that another motion, of which there are none, may have."""
LEFT = 0.1
"""Share of what numbers alone leave that an answer may leave and have explained it."""
NAMED, WEIGHED = 0.75, 0.9
"""Share of the whole when effects are named along the motion, and when rivals begin to be weighed for good."""
NOTHING_MISSING = "no physics larger than the detection limits is missing"


def answer(
    machine: Machine,
    audit: Audit,
    named: Named,
    held_out: Mapping[str, Recording],
    began: float,
    report: Callable[[str, float], None] = lambda what, share: None,
    again: Callable[[Named], Named | None] | None = None,
) -> Answered:
    """Return the answer to what was named; held-out recordings may take assurance away. `began` is when (`time.monotonic`).

    Where the answer is not sure, what is named `again` is answered instead, if anything is.
    """
    report("weighing rivals", WEIGHED if again is None else NAMED)
    before, named = {fitted.names: fitted for _, fitted in named.sets}, refitted(named)
    along_motion = before.get(named.best.names, named.best)
    judged = replace(named, best=along_motion)  # rivals are weighed along the motion, where equations are linear
    tuned, best, seen, noise = named.tuned, named.best, named.seen, named.seen.noise
    of = library(tuned, along_motion, named.of if isinstance(tuned, Tuned) else None)  # limits are beside the answer
    named, judged = replace(named, of=None), replace(judged, of=None)
    others = alternatives(judged, of) if best.settings else []
    spread = deviations(judged, best)
    values = tuned.numbers.values(best.offset[: len(tuned.numbers.indices)])
    shown = shown_findings(machine, seen)
    findings = (*told(best.settings, others, estimates_of(machine.plant, best, spread), LARGEST[noise]), *shown)
    limits = detection_limits(judged, of)
    del of  # it would fill the memory beside that of free runs
    retuned, frozen = _numbers(tuned, best, spread)
    errors = fit_of(*_predicted(machine, named, held_out), has_held_out=held_out != {})
    verdict, reason = _verdict(audit, judged, findings, others, unseen_at(machine, seen, limits), errors)
    if again is not None and verdict in ("ambiguous", "unknown_physics") and (other := again(judged)) is not None:
        return answer(machine, audit, other, held_out, began, report)
    if imposed := seen.alongs[0].observed.imposed:
        reason += f"; no effort of {', '.join(imposed)} was recorded: its motion is given, and sensors are judged by each other"
    if not findings and verdict not in ("inconclusive", "misconfigured"):
        reason = "; ".join([reason, what_may_hide(recordings_of(seen)), *never_shown(limits)])
    along, there = (tuned, along_motion) if isinstance(tuned, Tuned) else _along(named)
    proposal = None
    if verdict == "ambiguous":
        offset = judged.best.offset[: len(tuned.numbers.indices)]
        levels = matched(judged.levels, *_along(judged)) if isinstance(tuned, FreeRuns) else judged.levels
        proposal = proposed(machine, tuned.numbers.values(offset), offset, judged.best.settings, others, levels, seen, report)
    if proposal is not None:
        findings = tuple(replace(finding, separating_experiment=NEXT_EXPERIMENT) for finding in findings)
    diagnosis = Diagnosis(
        verdict=verdict,
        reason=reason,
        findings=findings,
        hypotheses=hypotheses_of(
            best.settings, len(best.parameters), gained_by(judged), others, LARGEST[noise], tuple(finding.effect for finding in shown)
        ),
        retuned=retuned,
        frozen=frozen,
        noise=noise,
        location=Location() if verdict in ("consistent", "retuned") else where_it_is(seen, along, there),
        fit=errors,
        unexplained_share=unexplained(judged),
        seconds=time.monotonic() - began,
        lacking={seen.alongs[0].joints[joint]: share for joint, share in shares_of(seen).items()},
        audit=audit.document(),
        detection_limits=tuple(limit_of(limit, machine.plant) for limit in limits),
        baseline=baseline_of(machine, named.baseline, noise),
        known=known_effects(machine.plant),
        separations=() if proposal is None else separations_of(proposal),
    )
    acts = *acting(best.settings), *(one.setting for one in seen.shown)
    return Answered(machine, diagnosis, names_of(seen), seen, values, acts, proposal, _columns(named))


def _columns(named: Named) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return what numbers and the answer's parameters change, and their names."""
    best, numbers = named.best, named.tuned.numbers
    count = len(numbers.indices)
    kept = [*range(count), *range(len(best.offset), len(best.offset) + len(best.parameters))]
    names = (*numbers.names, *(f"{best.settings[k].name} at {best.settings[k].at}: {parameter.name}" for k, parameter in best.parameters))
    return np.vstack([each[:, kept] for each in best.columns]), names


def _along(named: Named) -> tuple[Tuned, Fitted]:
    """Return the answer of free runs along the recorded motion."""
    best = named.best
    tuned = tuned_at(named.seen.alongs, named.levels, best.offset, best.settings)
    return tuned, fit(tuned, best.settings, best.offset, longest=0.0) or best


def proposed(
    machine: Machine, values: np.ndarray, offset: np.ndarray, settings: Sequence[EffectSetting], others: Sequence[Alternative],
    levels: Levels, seen: Seen, report: Callable[[str, float], None],
) -> Proposal | None:  # fmt: skip
    """Return the experiment that separates an answer, with its numbers and the same as nuisances, from sets that are nearly as likely."""
    near = [other for other in others if other.told_apart < NOT_TOLD_APART]
    own, shares = _weights(near)
    rivals = [Model(values, offset, other.settings, share) for other, share in zip(near, shares, strict=True)]
    models = [Model(values, offset, tuple(settings), own), *rivals[:MOST_RIVALS]]
    told = seen.alongs[0].observed.channels, seen.by
    return propose(machine, models, levels.of(1), *told, lambda share: report("looking for the next experiment", 0.95 + 0.05 * share))


def separations_of(proposal: Proposal) -> tuple[PredictedSeparation, ...]:
    """Return how far an experiment separates the answer from each rival."""
    rivals = [tuple(EffectAt(one.name, one.at) for one in model.effects) for model in proposal.models[1:]]
    return tuple(PredictedSeparation(rival, *map(float, d)) for rival, d in zip(rivals, proposal.separations, strict=True))


def recordings_of(seen: Seen) -> dict[str, Recording]:
    """Return the recordings by name."""
    return {repeat.name: repeat.recording for group in seen.groups for repeat in group.repeats}


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
    audit: Audit, named: Named, findings: Sequence[Finding], others: Sequence[Alternative], unseen: Sequence[str], errors: Fit
) -> tuple[Verdict, str]:
    """Return the first verdict that applies, and why."""
    names = " and ".join(str(finding.effect) for finding in findings)
    if (first := verdict_of_audit(audit, names, unseen)) is not None:
        return first
    if not is_spanned(named):
        left = f"{math.sqrt(times_noise(named)):.2f} times what noise leaves"
        said = f"{names} {'explains' if len(findings) == 1 else 'explain'} a part; " if findings else ""
        return "unknown_physics", f"{said}what is left is {left}, and no known effect explains it"
    if not findings:
        if numbers_help(named):
            return "retuned", f"other numbers in the machine file explain the difference; {NOTHING_MISSING}"
        return "consistent", NOTHING_MISSING
    near = [other for other in others if other.has_another and other.told_apart < NOT_TOLD_APART]
    rivals = [
        other for other in near if other.told_apart < 0.0 or not is_variant(named.best.settings, other)
    ]  # a likelier law of the family, too
    doubted = [other for other in others if not other.has_another and other.told_apart < NOT_TOLD_APART]
    if rivals or doubted:
        said = "; ".join(dict.fromkeys(words(other.settings) for other in [*rivals, *doubted]))
        return "ambiguous", f"{names}, which these recordings do not tell apart from {said}"
    if (power := times_noise(named)) > 1.0 + LEVEL and named.is_noise_known:
        return (
            "ambiguous",
            f"{names}, beside which something may act that no known effect explains: what is left has {power:.2f} times the power of noise",
        )
    if not named.is_noise_known and not named.seen.alongs[0].followed.all():
        return "ambiguous", f"{names}, if disturbances at joints that no encoder follows are small: record repeats, which show them"
    removed = errors.removed_share or 0.0
    if named.is_noise_known and errors.held_out is not None and (errors.held_out.extended or 0.0) > HELD_OUT and removed < 1.0 - LEFT:
        return "ambiguous", f"{names}, as these recordings show; of those held out {1.0 - removed:.0%} of the mismatch is left"
    return "explained", f"{names}: no other law or place explains these recordings as well"


def unseen_at(machine: Machine, seen: Seen, limits: Sequence[Limit]) -> list[str]:
    """Return the axes at which dry friction would not have shown, were it as large as all effort."""
    efforts: dict[str, float] = {}
    for each in seen.missing():
        efforts[each.joint] = max(efforts.get(each.joint, 0.0), float(np.sqrt(np.mean(each.given**2))))
    axes = {drive.axis: efforts[drive.joint] for drive in machine.plant.drives if drive.joint in efforts}
    dry = [limit for limit in limits if effects()[limit.effect].everyday and effects()[limit.effect].kind is FRICTION]
    hidden = {limit.at for limit in dry if limit.parameter.unit == "Nm" and not limit.strength < axes.get(limit.at, 0.0)}
    return [axis for axis in axes if axis in hidden]


def words(settings: Sequence[EffectSetting]) -> str:
    """Return effects with their places."""
    return " and ".join(f"{setting.name} at {setting.at}" for setting in settings) or "no effect"


def is_variant(settings: Sequence[EffectSetting], other: Alternative) -> bool:
    """Whether an alternative has another law of the same family at the same place."""
    own, its = settings[other.without[0]], other.settings[-1]
    return len(other.without) == 1 and own.at == its.at and effects()[own.name].family == effects()[its.name].family


def _weights(others: Sequence[Alternative]) -> tuple[float, list[float]]:
    """Return the shares of the answer and of each alternative: their evidences, which sum to one."""
    least = min([0.0, *(other.told_apart for other in others)])
    own = math.exp(0.5 * least)
    each = [math.exp(-0.5 * min(other.told_apart - least, 1400.0)) for other in others]
    total = own + sum(each)
    return own / total, [one / total for one in each]


def told(
    settings: Sequence[EffectSetting], others: Sequence[Alternative], estimates: Sequence[Mapping[str, Estimate]], cap: float
) -> tuple[Finding, ...]:
    """Return the effects of an answer as findings, each with what might act in its place."""
    found = []
    for number, (setting, table) in enumerate(zip(settings, estimates, strict=True)):
        if setting not in acting(settings):
            continue
        mine = [other for other in others if number in other.without]
        own, shares = _weights(mine)
        at, family = EffectAt(setting.name, setting.at), effects()[setting.name].family
        variants = [(at, cap * own)]
        rivals, missing = [], 0.0
        for other, share in zip(mine, shares, strict=True):
            if other.has_another and is_variant(settings, other):
                variants.append((EffectAt(other.settings[-1].name, other.settings[-1].at), cap * share))
            elif other.has_another and other.told_apart < NOT_TOLD_APART:
                rivals.append(other)
            elif not other.has_another:
                missing = other.behind
        confidence = sum(share for _, share in variants)
        found.append(
            Finding(
                at,
                confidence=min(confidence, cap),
                parameters=table,
                ambiguous_with=tuple(EffectAt(other.settings[-1].name, other.settings[-1].at) for other in rivals),
                ambiguous_sets=tuple(tuple(EffectAt(one.name, one.at) for one in other.settings) for other in rivals),
                evidence_for=(f"without it, twice the log of the evidence falls by {missing:.4g}",),
                evidence_against=tuple(f"{words(other.settings)} is {other.behind:.3g} such units behind" for other in rivals),
                family=family,
                variants=tuple(sorted(variants, key=lambda pair: -pair[1])),
            )
        )
    return tuple(found)


def hypotheses_of(
    settings: Sequence[EffectSetting],
    parameters: int,
    gained: float,
    others: Sequence[Alternative],
    cap: float,
    shown: tuple[EffectAt, ...],
) -> tuple[Hypothesis, ...]:  # fmt: skip
    """Return the sets of effects that were weighed, the surest first."""
    own, shares = _weights(others)
    named = tuple(EffectAt(one.name, one.at) for one in acting(settings))
    sets = [Hypothesis((*named, *shown), cap * own, gained, None, parameters, True)]
    for other, share in list(zip(others, shares, strict=True))[:MOST_HYPOTHESES]:
        what = tuple(EffectAt(one.name, one.at) for one in other.settings)
        sets.append(Hypothesis((*what, *shown), cap * share, other.gained, None, other.parameters, False))
    return tuple(sorted(sets, key=lambda each: -each.confidence))


def _numbers(tuned: Tuned | FreeRuns, fitted: Fitted, spread: np.ndarray) -> tuple[dict[str, RetunedValue], dict[str, str]]:
    """Return the numbers that the recordings show, and what became of the others."""
    numbers = tuned.numbers
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


def _predicted(machine: Machine, named: Named, held_out: Mapping[str, Recording]) -> tuple[Predicted | None, ...]:
    """Return the errors of the machine at every stage, in training and held out, by the same measure.

    In free runs of the closed loop where these judged and the held-out controller is known; else row by row where noise is known, and in
    free runs by the recorded efforts where it is not.
    """
    sets = [named.seen, *([see(machine, held_out, named.seen)] if held_out else [])]
    numbers = named.tuned.numbers
    count = len(numbers.indices)
    fits = {"retuned": named.plain, "baseline": named.baseline, "extended": named.best}
    stages = {"nominal": (np.zeros(count), ()), **{name: (each.offset[:count], each.settings) for name, each in fits.items()}}
    if isinstance(named.tuned, FreeRuns) and not (held_out and lacking(sets[-1], audit_of(machine, held_out))):
        try:
            return tuple(closed_runs(named.tuned, seen, stages) for seen in sets)
        except RecordingError:
            pass
    if not named.levels.are_assumed:
        return tuple(one_ahead(named, seen, stages) for seen in sets)
    scales = dict(zip(named.seen.alongs[0].observed.channels, named.levels.sensors.tolist(), strict=False))  # efforts follow the channels
    machines = {name: (numbers.values(offset), own) for name, (offset, own) in stages.items()}
    return tuple(predicted(seen.alongs, scales, machines, "extended") for seen in sets)


def fit_of(train: Predicted | None, held: Predicted | None = None, *, has_held_out: bool) -> Fit:
    """Return how far every stage is from the recordings."""
    judged = held if has_held_out else train
    on_train = _total(train)
    on_held_out = _total(held) if has_held_out else None
    best = on_held_out or on_train
    channels = {} if judged is None else {name: _stages(table) for name, table in judged.channels.items()}
    shares = _removed(best.retuned, best.extended), _removed(best.nominal, best.extended)
    fit = Fit(channels, on_train, on_held_out, *shares)
    return fit if judged is None else replace(fit, errors_of=judged.errors_of, horizon_s=judged.horizon_s)


def _stages(table: Mapping[str, float]) -> Stages:
    kept = {name: value if math.isfinite(value) else None for name, value in table.items()}
    return Stages(kept["nominal"], kept["retuned"], kept["extended"], None, kept["noise"], kept["baseline"])


def _total(found: Predicted | None) -> Stages:
    """Return E: over channels, rms errors in units of the channel's noise."""
    if found is None:
        return Stages()
    total: dict[str, float | None] = {}
    for stage in ("nominal", "retuned", "extended", "baseline"):
        ratios = [table[stage] / table["noise"] for table in found.channels.values() if table["noise"] > 0.0]
        value = math.hypot(*ratios) / math.sqrt(len(ratios)) if ratios else math.inf
        total[stage] = value if math.isfinite(value) else None
    return Stages(total["nominal"], total["retuned"], total["extended"], None, 1.0, total["baseline"])


def _removed(before: float | None, after: float | None) -> float | None:
    if before is None or after is None or before <= 1.0:
        return None
    return float((1.0 - (after / before) ** 2) / (1.0 - before**-2.0))  # without squares of what ran away


def shares_of(seen: Seen) -> dict[int, float]:
    """Return every driven joint's share of the missing effort's power, each in units of the effort on it."""
    along = seen.alongs[0]
    power: dict[int, float] = {}
    for each in seen.missing():
        joint = along.joints.index(each.joint)
        power[joint] = power.get(joint, 0.0) + each.share**2
    total = sum(power.values())
    return {joint: value / total for joint, value in power.items()} if total > 0.0 else {}


def limit_of(limit: Limit, settings: PlantSettings) -> DetectionLimit:
    """Return a limit with its unit."""
    strength = limit.strength if math.isfinite(limit.strength) else None
    return DetectionLimit(EffectAt(limit.effect, limit.at), limit.parameter.name, strength, unit_of(limit.parameter, limit.at, settings))
