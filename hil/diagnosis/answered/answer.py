"""From what was named to the answer."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.audit.audit import Audit
from hil.diagnosis.audit.sensors import SensorAudit
from hil.diagnosis.named.fitting import Fitted
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
    scattered,
    unexplained,
)
from hil.diagnosis.observed.known import known_effects
from hil.diagnosis.observed.shaken import what_may_hide
from hil.diagnosis.predicted.open_runs import Predicted, predicted
from hil.diagnosis.predicted.refitting import refitted
from hil.diagnosis.result import (
    READ_OFF,
    DetectionLimit,
    Diagnosis,
    DisturbanceShares,
    EffectAt,
    Estimate,
    Finding,
    Fit,
    Hypothesis,
    Location,
    NoiseKind,
    RetunedValue,
    Stages,
    Verdict,
)
from hil.diagnosis.seen.see import Seen, see
from hil.diagnosis.tuned.retuning import Tuned
from hil.machine import Machine
from hil.recording import Recording
from virtual_bus.effects.effect import FRICTION, Parameter
from virtual_bus.effects.places import drive_unit, is_prismatic
from virtual_bus.effects.registry import effects
from virtual_bus.plant.parameters import plant_parameters
from virtual_bus.settings import EffectSetting, PlantSettings

LARGEST = {"repeats": 0.99, "periods": 0.99, "assumed": 0.9}
"""Confidence of a name at most, by what is known of noise."""
WITHIN_95 = 1.96
SHOWN = 0.5
"""Of a number's prior, in which its standard deviation must be that recordings show it."""
MOST_HYPOTHESES = 12
MOST_HIDDEN = 3
"""Effects that would not have shown, named in the sentence; all are among the detection limits."""
NOTHING_MISSING = "no physics larger than the detection limits is missing"


@dataclass(frozen=True, eq=False)
class Answered:
    """The answer and what it was made from.

    Attributes
    ----------
    machine : Machine
    diagnosis : Diagnosis
    recordings : tuple of str
    named : Named or None
        None where the recordings show nothing, or by themselves.
    values : (parameters,) array
        Plant parameters of the answer.
    effects : tuple of EffectSetting
    """

    machine: Machine
    diagnosis: Diagnosis
    recordings: tuple[str, ...]
    named: Named | None
    values: np.ndarray
    effects: tuple[EffectSetting, ...]


def answer(machine: Machine, audit: Audit, named: Named, held_out: Mapping[str, Recording], began: float) -> Answered:
    """Return the answer to what was named; held-out recordings are scored and decide nothing. `began` is when (`time.monotonic`)."""
    noise: NoiseKind = "assumed" if named.levels.are_assumed else "repeats"
    before, named = {fitted.names: fitted for _, fitted in named.sets}, refitted(named)
    tuned, best, seen = named.tuned, named.best, named.seen
    along_motion = before.get(best.names, best)
    judged = replace(named, best=along_motion)  # rivals are weighed along the motion, where equations are linear
    of = library(tuned, along_motion)
    others = alternatives(judged, of) if best.settings else []
    spread = deviations(judged, best)
    values = tuned.numbers.values(best.offset[: len(tuned.numbers.indices)])
    settings = machine.plant
    estimates = _estimates(settings, best, spread)
    findings = _findings(best, others, estimates, LARGEST[noise])
    limits = detection_limits(judged, of)
    retuned, frozen = _numbers(tuned, best, spread)
    verdict, reason = _verdict(audit, judged, findings, others, _unseen(machine, seen, limits))
    if not findings and verdict != "inconclusive":
        reason = "; ".join([reason, what_may_hide(_recordings(seen)), *_never_shown(limits)])
    machines = _machines(named, values)
    alongs = seen.alongs
    scales = dict(zip(alongs[0].observed.channels, named.levels.sensors.tolist(), strict=False))  # efforts follow the channels
    train = predicted(alongs, scales, machines, "extended")
    held = None
    if held_out:
        held = predicted(see(machine, held_out).alongs, scales, machines, "extended")
    missing = {alongs[0].joints[joint]: share for joint, share in _shares(named).items()}
    diagnosis = Diagnosis(
        verdict=verdict,
        reason=reason,
        findings=findings,
        hypotheses=_hypotheses(best, gained_by(judged), others, LARGEST[noise]),
        retuned=retuned,
        frozen=frozen,
        noise=noise,
        location=Location(channels=_by_channel(machine, missing)),
        fit=_fit(train, held, held_out != {}),
        unexplained_share=unexplained(judged),
        seconds=time.monotonic() - began,
        disturbance=DisturbanceShares(joints=missing),
        audit=audit.document(),
        detection_limits=tuple(_limit(limit, settings) for limit in limits),
        baseline=baseline_of(machine, named.baseline, noise),
        known=known_effects(machine.plant),
    )
    return Answered(machine, diagnosis, _names(seen), named, values, best.settings)


def baseline_of(machine: Machine, fitted: Fitted, noise: NoiseKind) -> tuple[Finding, ...]:
    """Return the engineer's fit."""
    estimates = _estimates(machine.plant, fitted, scattered(fitted))
    return tuple(
        Finding(EffectAt(setting.name, setting.at), 0.5 * LARGEST[noise], table, family=effects()[setting.name].family)
        for setting, table in zip(fitted.settings, estimates, strict=True)
    )


def nothing_seen(machine: Machine, audit: Audit, seen: Seen, seconds: float) -> Answered:
    """Return the answer to recordings in which nothing moves."""
    noise: NoiseKind = "assumed" if seen.levels.are_assumed else "repeats"
    stages = Stages(None, None, None, None, None)
    diagnosis = Diagnosis(
        verdict="inconclusive",
        reason=f"{', '.join(seen.still)} {'does' if len(seen.still) == 1 else 'do'} not move in these recordings: excite every axis",
        findings=(), hypotheses=(), retuned={}, frozen={}, noise=noise, location=Location(),
        fit=Fit({}, stages, None, None, None), unexplained_share=0.0, seconds=seconds, audit=audit.document(),
        known=known_effects(machine.plant),
    )  # fmt: skip
    return Answered(machine, diagnosis, _names(seen), None, seen.alongs[0].plant.nominal, ())


def wrong_recordings(machine: Machine, audit: Audit, recordings: Mapping[str, Recording], seconds: float) -> Answered:
    """Return the answer to recordings that are not what they say: nothing is explained by them."""
    stages = Stages(None, None, None, None, None)
    lacks = all(fault.is_lack for fault in audit.faults)
    share = 1.0 / len(audit.faults)
    diagnosis = Diagnosis(
        verdict="inconclusive" if lacks else "misconfigured",
        reason="; ".join(fault.said for fault in audit.faults),
        findings=(), hypotheses=(), retuned={}, frozen={}, noise="assumed",
        location=Location(channels={fault.channel: share for fault in audit.faults}),
        fit=Fit({}, stages, None, None, None), unexplained_share=1.0, seconds=seconds, audit=audit.document(),
    )  # fmt: skip
    values = np.array([parameter.value for parameter in plant_parameters(machine.plant)])
    return Answered(machine, diagnosis, tuple(recordings), None, values, ())


def play_seen(machine: Machine, audit: Audit, seen: Seen, seconds: float) -> Answered:
    """Return the answer where two encoders show play between them: what else is missing shows once it is modelled."""
    noise: NoiseKind = "assumed" if seen.levels.are_assumed else "repeats"
    stages = Stages(None, None, None, None, None)
    sure = min(READ_OFF, LARGEST[noise])
    found = tuple(_play(machine, each, sure) for each in audit.sensors if each.gap > 0.0)
    names = " and ".join(str(finding.effect) for finding in found)
    said = "; ".join(each.said for each in audit.sensors if each.gap > 0.0)
    diagnosis = Diagnosis(
        verdict="misconfigured" if audit.wrong else "explained",
        reason=f"{'; '.join([*audit.wrong, ''])}{names}: {said}. What else is missing shows once the machine file has this play",
        findings=found, hypotheses=(Hypothesis(tuple(one.effect for one in found), sure, is_confirmed=True),), retuned={}, frozen={},
        noise=noise, location=Location(channels={each.second: 1.0 / len(found) for each in audit.sensors if each.gap > 0.0}),
        fit=Fit({}, stages, None, None, None), unexplained_share=1.0, seconds=seconds, audit=audit.document(),
        known=known_effects(machine.plant),
    )  # fmt: skip
    return Answered(machine, diagnosis, _names(seen), None, seen.alongs[0].plant.nominal, ())


def _recordings(seen: Seen) -> dict[str, Recording]:
    return {repeat.name: repeat.recording for group in seen.groups for repeat in group.repeats}


def _never_shown(limits: Sequence[Limit]) -> list[str]:
    """Return in words which effects would not have shown at any strength that the catalogue allows."""
    hidden = [f"{limit.effect} at {limit.at}" for limit in limits if not math.isfinite(limit.strength)]
    if not hidden:
        return []
    more = f" and {len(hidden) - MOST_HIDDEN} more" if len(hidden) > MOST_HIDDEN else ""
    return [f"not even the largest would have shown of {', '.join(hidden[:MOST_HIDDEN])}{more} (detection limits)"]


def _names(seen: Seen) -> tuple[str, ...]:
    return tuple(repeat.name for group in seen.groups for repeat in group.repeats)


def _play(machine: Machine, one: SensorAudit, sure: float) -> Finding:
    """Return what two encoders show by themselves."""
    axis = one.first.removeprefix("position_")
    effect = next(effect for effect in effects().values() if effect.play)
    gap = next(parameter for parameter in effect.parameters if parameter.name == effect.play)
    reach = WITHIN_95 * one.scatter
    half = 0.5 * one.gap
    table = {gap.name: Estimate(half, _unit(gap, axis, machine.plant), (half - reach, half + reach))}
    return Finding(EffectAt(effect.name, axis), sure, table, evidence_for=(one.said,), family=effect.family)


def first_answer(machine: Machine, audit: Audit, seen: Seen, baseline: Fitted, seconds: float) -> Diagnosis:
    """Return what can be said once the engineer's fit is there: it is marked provisional."""
    noise: NoiseKind = "assumed" if seen.levels.are_assumed else "repeats"
    stages = Stages(None, None, None, None, None)
    fitted = baseline_of(machine, baseline, noise)
    return Diagnosis(
        verdict="misconfigured" if audit.wrong else "ambiguous",
        reason="; ".join(audit.wrong) or "first answer: friction of every driven joint, fitted as an engineer would; the search goes on",
        findings=tuple(one for one in fitted if _is_sure(one)), hypotheses=(), retuned={}, frozen={}, noise=noise, location=Location(),
        fit=Fit({}, stages, None, None, None), unexplained_share=1.0, seconds=seconds, audit=audit.document(), baseline=fitted,
        provisional=True, known=known_effects(machine.plant),
    )  # fmt: skip


def _is_sure(finding: Finding) -> bool:
    return all(estimate.ci95[0] * estimate.ci95[1] > 0.0 for estimate in finding.parameters.values())


def _verdict(
    audit: Audit, named: Named, findings: Sequence[Finding], others: Sequence[Alternative], unseen: Sequence[str]
) -> tuple[Verdict, str]:
    """Return the first verdict that applies, and why."""
    names = " and ".join(str(finding.effect) for finding in findings)
    if unseen and not findings:
        said = f"friction as large as all effort would not have shown at {', '.join(unseen)}: excite it more, or for longer"
        return "inconclusive", "; ".join([said, *audit.wrong])
    if audit.wrong:
        said = "; ".join(audit.wrong)
        return "misconfigured", said + (f"; beside it, the recorded efforts show {names}" if findings else "; beside it no physics shows")
    if not is_spanned(named):
        left = f"{math.sqrt(named.best.squares / named.tuned.readings):.2f} times what noise leaves"
        said = f"{names} {'explains' if len(findings) == 1 else 'explain'} a part; " if findings else ""
        return "unknown_physics", f"{said}what is left is {left}, and no known effect explains it"
    if not findings:
        if numbers_help(named):
            return "retuned", f"other numbers in the machine file explain the difference; {NOTHING_MISSING}"
        return "consistent", NOTHING_MISSING
    near = [other for other in others if other.has_another and other.behind < NOT_TOLD_APART]
    rivals = [other for other in near if other.behind < 0.0 or not _is_variant(named.best, other)]  # a likelier law of the family, too
    doubted = [other for other in others if not other.has_another and other.behind < NOT_TOLD_APART]
    if rivals or doubted:
        said = "; ".join(dict.fromkeys(_words(other.settings) for other in [*rivals, *doubted]))
        return "ambiguous", f"{names}, which these recordings do not tell apart from {said}"
    if named.levels.are_assumed and not named.seen.alongs[0].followed.all():
        return "ambiguous", f"{names}, if disturbances at joints that no encoder follows are small: record repeats, which show them"
    return "explained", f"{names}: no other law or place explains these recordings as well"


def _unseen(machine: Machine, seen: Seen, limits: Sequence[Limit]) -> list[str]:
    """Return the axes at which dry friction would not have shown, were it as large as all effort."""
    efforts: dict[str, float] = {}
    for each in seen.missing():
        efforts[each.joint] = max(efforts.get(each.joint, 0.0), float(np.sqrt(np.mean(each.given**2))))
    axes = {drive.axis: efforts.get(drive.joint, 0.0) for drive in machine.plant.drives}
    dry = [limit for limit in limits if effects()[limit.effect].everyday and effects()[limit.effect].kind is FRICTION]
    hidden = {limit.at for limit in dry if limit.parameter.unit == "Nm" and not limit.strength < axes.get(limit.at, 0.0)}
    return [axis for axis in axes if axis in hidden]


def _words(settings: Sequence[EffectSetting]) -> str:
    return " and ".join(f"{setting.name} at {setting.at}" for setting in settings) or "no effect"


def _is_variant(best: Fitted, other: Alternative) -> bool:
    """Whether an alternative has another law of the same family at the same place."""
    own, its = best.settings[other.without[0]], other.settings[-1]
    return len(other.without) == 1 and own.at == its.at and effects()[own.name].family == effects()[its.name].family


def _weights(others: Sequence[Alternative]) -> tuple[float, list[float]]:
    """Return the shares of the answer and of each alternative: their evidences, which sum to one."""
    least = min([0.0, *(other.behind for other in others)])
    own = math.exp(0.5 * least)
    each = [math.exp(-0.5 * min(other.behind - least, 1400.0)) for other in others]
    total = own + sum(each)
    return own / total, [one / total for one in each]


def _findings(best: Fitted, others: Sequence[Alternative], estimates: Sequence[Mapping[str, Estimate]], cap: float) -> tuple[Finding, ...]:
    found = []
    for number, (setting, table) in enumerate(zip(best.settings, estimates, strict=True)):
        mine = [other for other in others if number in other.without]
        own, shares = _weights(mine)
        at, family = EffectAt(setting.name, setting.at), effects()[setting.name].family
        variants = [(at, cap * own)]
        rivals, missing = [], 0.0
        for other, share in zip(mine, shares, strict=True):
            if other.has_another and _is_variant(best, other):
                variants.append((EffectAt(other.settings[-1].name, other.settings[-1].at), cap * share))
            elif other.has_another and other.behind < NOT_TOLD_APART:
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
                evidence_for=(f"without it, squares rise by {missing:.4g} in units of what scatters",),
                evidence_against=tuple(f"{_words(other.settings)} is {other.behind:.3g} such units behind" for other in rivals),
                family=family,
                variants=tuple(sorted(variants, key=lambda pair: -pair[1])),
            )
        )
    return tuple(found)


def _hypotheses(best: Fitted, gained: float, others: Sequence[Alternative], cap: float) -> tuple[Hypothesis, ...]:
    own, shares = _weights(others)
    sets = [Hypothesis(tuple(EffectAt(one.name, one.at) for one in best.settings), cap * own, gained, None, len(best.parameters), True)]
    for other, share in list(zip(others, shares, strict=True))[:MOST_HYPOTHESES]:
        what = tuple(EffectAt(one.name, one.at) for one in other.settings)
        sets.append(Hypothesis(what, cap * share, other.gained, None, other.parameters, False))
    return tuple(sorted(sets, key=lambda each: -each.confidence))


def _estimates(settings: PlantSettings, fitted: Fitted, spread: np.ndarray) -> list[dict[str, Estimate]]:
    """Return parameters with units and intervals, one table an effect."""
    free = {(k, parameter.name): float(each) for (k, parameter), each in zip(fitted.parameters, spread[len(fitted.offset) :], strict=True)}
    tables = []
    for k, setting in enumerate(fitted.settings):
        table = {}
        for parameter in effects()[setting.name].parameters:
            value = float(setting.parameters[parameter.name])
            reach = WITHIN_95 * free.get((k, parameter.name), 0.0)
            low, high = max(value - reach, parameter.low), min(value + reach, parameter.high)
            table[parameter.name] = Estimate(value, _unit(parameter, setting.at, settings), (min(low, value), max(high, value)))
        tables.append(table)
    return tables


def _unit(parameter: Parameter, at: str, settings: PlantSettings) -> str:
    return parameter.unit_at(is_prismatic(at, settings), drive_unit(at, settings))


def _numbers(tuned: Tuned, fitted: Fitted, spread: np.ndarray) -> tuple[dict[str, RetunedValue], dict[str, str]]:
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


def _machines(named: Named, values: np.ndarray) -> dict[str, tuple[np.ndarray | None, tuple[EffectSetting, ...]]]:
    numbers = named.tuned.numbers
    count = len(numbers.indices)
    return {
        "nominal": (None, ()),
        "retuned": (numbers.values(named.plain.offset[:count]), ()),
        "baseline": (numbers.values(named.baseline.offset[:count]), named.baseline.settings),
        "extended": (values, named.best.settings),
    }


def _fit(train: Predicted | None, held: Predicted | None, has_held_out: bool) -> Fit:
    judged = held if has_held_out else train
    on_train = _total(train)
    on_held_out = _total(held) if has_held_out else None
    best = on_held_out or on_train
    channels = {} if judged is None else {name: _stages(table) for name, table in judged.channels.items()}
    horizon = None if judged is None else judged.horizon_s
    return Fit(channels, on_train, on_held_out, _removed(best.retuned, best.extended), _removed(best.nominal, best.extended), horizon)


def _stages(table: Mapping[str, float]) -> Stages:
    kept = {name: value if math.isfinite(value) else None for name, value in table.items()}
    return Stages(kept["nominal"], kept["retuned"], kept["extended"], None, kept["noise"], kept["baseline"])


def _total(found: Predicted | None) -> Stages:
    """Return E: over channels, rms errors in units of the channel's noise."""
    if found is None:
        return Stages(None, None, None, None, None)
    total: dict[str, float | None] = {}
    for stage in ("nominal", "retuned", "extended", "baseline"):
        ratios = [table[stage] / table["noise"] for table in found.channels.values() if table["noise"] > 0.0]
        value = math.hypot(*ratios) / math.sqrt(len(ratios)) if ratios else math.inf
        total[stage] = value if math.isfinite(value) else None
    return Stages(total["nominal"], total["retuned"], total["extended"], None, 1.0, total["baseline"])


def _removed(before: float | None, after: float | None) -> float | None:
    if before is None or after is None or before <= 1.0:
        return None
    return (1.0 - (after / before) ** 2) / (1.0 - before**-2.0)  # without squares of what ran away


def _shares(named: Named) -> dict[int, float]:
    """Return every driven joint's share of the missing effort's power, each in units of the effort on it."""
    along = named.seen.alongs[0]
    power: dict[int, float] = {}
    for each in named.seen.missing():
        joint = along.joints.index(each.joint)
        power[joint] = power.get(joint, 0.0) + each.share**2
    total = sum(power.values())
    return {joint: value / total for joint, value in power.items()} if total > 0.0 else {}


def _by_channel(machine: Machine, shares: Mapping[str, float]) -> dict[str, float]:
    names = {drive.joint: f"{'current' if drive.unit == 'A' else 'effort'}_{drive.axis}" for drive in machine.plant.drives}
    return {names[joint]: share for joint, share in shares.items() if joint in names}


def _limit(limit: Limit, settings: PlantSettings) -> DetectionLimit:
    strength = limit.strength if math.isfinite(limit.strength) else None
    return DetectionLimit(EffectAt(limit.effect, limit.at), limit.parameter.name, strength, _unit(limit.parameter, limit.at, settings))
