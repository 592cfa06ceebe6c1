"""Numbers that left their tolerance in the machine file, as findings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hil.diagnosis.model_choice.far_off import beyond_tolerance, stand_ins
from hil.diagnosis.model_choice.fitting import Fitted
from hil.diagnosis.result import EffectAt, Finding, RetunedValue
from hil.diagnosis.retuning.linear_model import LinearModel
from hil.diagnosis.verdict.values import WITHIN_95, number_finding
from hil.machine import Machine
from virtual_bus.plant.parameters import PlantParameter


def far_off(
    machine: Machine, linear: LinearModel, fitted: Fitted, spread: np.ndarray, retuned: Mapping[str, RetunedValue]
) -> tuple[Finding, ...]:
    """Return the re-tuned numbers whose whole interval is beyond their tolerance, by deviations (P + Q,), and what could stand for them."""
    found = []
    for one in beyond_tolerance(machine, linear, fitted.offset, WITHIN_95 * spread):
        if (number := retuned.get(_name(one))) is not None:
            instead = tuple(EffectAt(_name(other), other.owner) for other in stand_ins(linear, fitted, one))
            finding = number_finding(EffectAt(_name(one), one.owner), number)
            found.append(replace(finding, ambiguous_with=instead, ambiguous_sets=tuple((each,) for each in instead)))
    return tuple(found)


def _name(number: PlantParameter) -> str:
    return f"{number.owner}.{number.quantity}"
