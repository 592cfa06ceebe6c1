"""The answer as a value, and its numbers with units and intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.diagnosis.candidates.entries import effect_sought
from hil.diagnosis.model_choice.covariance import covariance_of, scattered
from hil.diagnosis.model_choice.fitting import Fitted
from hil.diagnosis.next_experiment.proposal import Proposal
from hil.diagnosis.residuals.residuals import Residuals
from hil.diagnosis.result import Diagnosis, EffectAt, Finding, KnownEffect, ParameterEstimate, RetunedValue
from hil.machine import Machine
from virtual_bus.effects.effect import Parameter
from virtual_bus.effects.places import drive_unit, is_prismatic
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting, PlantSettings

RIGHT = {"explained": (21, 38), "ambiguous": (10, 49), "retuned": (120, 177)}
"""By verdict, how many answers to opened cases of the concealed benchmark were right, and how many there were. `retuned` is right where
nothing was hidden, or a number alone."""
ASSUMED = 0.9
"""Of that share, where noise is assumed: no such case is among them."""
WITHIN_95 = 1.96


@dataclass(frozen=True, eq=False)
class Outcome:
    """The answer and what it was made from.

    Attributes
    ----------
    machine : Machine
    diagnosis : Diagnosis
    recordings : tuple of str
    residuals : Residuals or None
        None where the recordings show nothing, or by themselves.
    values : (parameters,) array
        Plant parameters of the answer.
    effects : tuple of EffectSetting
    proposal : Proposal or None
        The experiment that would tell the answer from its rivals.
    columns : pair of (M, P) array and tuple of str, or None
        What numbers and the effects' parameters change, and their names.
    """

    machine: Machine
    diagnosis: Diagnosis
    recordings: tuple[str, ...]
    residuals: Residuals | None
    values: np.ndarray
    effects: tuple[EffectSetting, ...]
    proposal: Proposal | None = None
    columns: tuple[np.ndarray, tuple[str, ...]] | None = None


@dataclass(frozen=True, eq=False)
class Everyday:
    """The engineer's fit: everyday effects at every driven joint, fitted together with the machine's numbers.

    Attributes
    ----------
    diagnosis : Diagnosis
        A first answer with that fit as its baseline; where there is none, why.
    names, units : tuples of str
        Of the effects' parameters, as `roll coulomb_friction Fc`.
    values : (K,) array
    covariance : (K, K) array
    """

    diagnosis: Diagnosis
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


def everyday_of(machine: Machine, diagnosis: Diagnosis, fitted: Fitted) -> Everyday:
    """Return the engineer's fit with its covariance, beside its first answer."""
    of = [(fitted.settings[k], parameter) for k, parameter in fitted.parameters]
    own = slice(len(fitted.offset), None)
    return Everyday(
        diagnosis,
        tuple(f"{setting.at} {setting.name} {parameter.name}" for setting, parameter in of),
        tuple(unit_of(parameter, setting.at, machine.plant) for setting, parameter in of),
        np.array([setting.parameters[parameter.name] for setting, parameter in of], dtype=float),
        covariance_of(fitted)[own, own],
    )


def counted_as(diagnosis: Diagnosis) -> str:
    """Return the verdict whose right answers were counted: its own, or the one that is as sure."""
    return {"consistent": "retuned"}.get(diagnosis.verdict, diagnosis.verdict if diagnosis.verdict in RIGHT else "ambiguous")


def with_confidence(diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis whose shares of the evidence have become confidences."""
    right, answers = RIGHT[counted_as(diagnosis)]
    sure = right / answers * (ASSUMED if diagnosis.noise == "assumed" else 1.0)
    sets = tuple(replace(one, confidence=sure * one.confidence) for one in diagnosis.hypotheses)
    return replace(diagnosis, findings=tuple(one.times(sure) for one in diagnosis.findings), hypotheses=sets)


def baseline_of(machine: Machine, fitted: Fitted) -> tuple[Finding, ...]:
    """Return the engineer's fit; whether its effects act, it does not say."""
    estimates = estimates_of(machine.plant, fitted, scattered(fitted))
    return tuple(
        Finding(EffectAt(setting.name, setting.at), 0.5, table, family=effects()[setting.name].family)
        for setting, table in zip(fitted.settings, estimates, strict=True)
    )


def estimates_of(settings: PlantSettings, fitted: Fitted, spread: np.ndarray) -> list[dict[str, ParameterEstimate]]:
    """Return parameters with units and intervals, one table an effect."""
    free = {(k, parameter.name): float(each) for (k, parameter), each in zip(fitted.parameters, spread[len(fitted.offset) :], strict=True)}
    tables = []
    for k, setting in enumerate(fitted.settings):
        table = {}
        for parameter in effect_sought(setting.name).parameters:
            value = float(setting.parameters[parameter.name])
            reach = WITHIN_95 * free.get((k, parameter.name), 0.0)
            low, high = max(value - reach, parameter.low), min(value + reach, parameter.high)
            table[parameter.name] = ParameterEstimate(value, unit_of(parameter, setting.at, settings), (min(low, value), max(high, value)))
        tables.append(table)
    return tables


def shown_findings(machine: Machine, residuals: Residuals) -> tuple[Finding, ...]:
    """Return what readings show by themselves."""
    found = []
    for one in residuals.shown:
        effect = effects()[one.setting.name]
        table = {}
        for parameter in effect.parameters:
            value, low, high = one.shown.values[parameter.name]
            table[parameter.name] = ParameterEstimate(value, unit_of(parameter, one.setting.at, machine.plant), (low, high))
        at = EffectAt(effect.name, one.setting.at)
        found.append(Finding(at, 1.0, table, evidence_for=(one.shown.said,), family=effect.family, variants=((at, 1.0),)))
    return tuple(found)


def number_finding(at: EffectAt, number: RetunedValue, of: str = "") -> Finding:
    """Return a number that left its tolerance, as a finding; `of` says of what, where its name does not."""
    said = f"{number.value:.4g} {number.unit}".rstrip() + f", the file says {number.nominal:.4g}{of}"
    table = {"value": ParameterEstimate(number.value, number.unit, number.ci95, number.nominal)}
    return Finding(at, 1.0, table, evidence_for=(said,), family="number", kind="number")


def acting(settings: Sequence[EffectSetting]) -> tuple[EffectSetting, ...]:
    """Return the effects that have some strength: what has none explains nothing."""
    strengths = [[p for p in effects()[one.name].parameters if p.is_strength] for one in settings]
    return tuple(
        one for one, own in zip(settings, strengths, strict=True) if not own or any(one.parameters[p.name] != p.neutral for p in own)
    )


def known_effects(settings: PlantSettings) -> tuple[KnownEffect, ...]:
    """Return the effects that a machine has before any is sought, with their units."""
    found = []
    for one in settings.effects:
        table = {each.name: (one.parameters[each.name], unit_of(each, one.at, settings)) for each in effects()[one.name].parameters}
        found.append(KnownEffect(EffectAt(one.name, one.at), table))
    return tuple(found)


def unit_of(parameter: Parameter, at: str, settings: PlantSettings) -> str:
    """Return the unit of a parameter of an effect at a place."""
    return parameter.unit_at(is_prismatic(at, settings), drive_unit(at, settings))


def names_of(residuals: Residuals) -> tuple[str, ...]:
    """Return the recordings, in the order of their groups."""
    return tuple(name for group in residuals.groups for name in group.names)
