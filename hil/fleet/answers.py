"""What tasks find, as rows of numbers with their covariance; the columns of the results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hil.diagnosis.result import Diagnosis, ParameterEstimate, RetunedValue
    from hil.diagnosis.verdict.values import Everyday
    from hil.identification import Resonances
    from hil.simulation import Comparison

UNUSABLE, FAILED = "unusable", "failed"
"""Verdicts of rows without an answer: the recordings do not give one; or the computer did not, so that another attempt may."""

FAILURE = "failure"
"""Quantity of such a row."""

Z95 = 1.959963984540054
"""Standard deviations to either side that hold 95 %."""


@dataclass(frozen=True)
class Number:
    """A quantity that a task found.

    Attributes
    ----------
    quantity, unit : its name and unit.
    value : NaN for a row that only says a verdict.
    group : quantities that were estimated together; "" for one by itself.
    covariance : with the quantities of the group, in their order; empty where it is not known.
    place : its own place in that order.
    """

    quantity: str
    value: float
    unit: str
    verdict: str
    message: str = ""
    group: str = ""
    covariance: tuple[float, ...] = ()
    place: int = 0

    @property
    def standard_deviation(self) -> float:
        """Root of its variance, NaN where that is not known."""
        return math.sqrt(self.covariance[self.place]) if self.covariance else math.nan


def failure(message: str, verdict: str = UNUSABLE) -> list[Number]:
    """Return the row of a task without an answer."""
    return [Number(FAILURE, math.nan, "", verdict, message)]


def of_comparison(comparison: Comparison) -> list[Number]:
    """Return per channel by how much a recording differs from its simulation, and the noise where repeats or periods show it."""
    rows = [Number("verdict", math.nan, "", "agrees" if comparison.agrees else "differs", comparison.verdict)]
    for channel in comparison.channels:
        verdict = "agrees" if channel.agrees else "differs"
        rows.append(Number(f"{channel.name} difference", channel.rms, channel.unit, verdict))
        rows.append(Number(f"{channel.name} difference in noise", channel.in_noise, "1", verdict))
        if comparison.noise.source != "assumed":
            rows.append(Number(f"{channel.name} noise", channel.noise, channel.unit, verdict))
    return rows


def of_resonances(modes: Resonances, expected_Hz: Sequence[float], said: str, repeat: str = "") -> list[Number]:
    """Return frequency and damping of each resonance, by the mode of the machine file that is nearest to it.

    Parameters
    ----------
    modes
        What was found.
    expected_Hz
        Frequencies of the machine file's modes, rising.
    said
        Message of the first row.
    repeat
        Which of several repeats; numbers of different ones are independent.
    """
    verdict = "identified" if modes.found else "no resonance"
    rows = [Number("resonances", float(len(modes.found)), "1", verdict, "; ".join(filter(None, (modes.reason, said))))]
    names = _nearest([mode.frequency_Hz for mode in modes.found], expected_Hz)
    for mode, name in zip(modes.found, names, strict=True):
        of_both = [("frequency", mode.frequency_Hz, "Hz"), ("damping", mode.damping, "1")]
        for place, (kind, value, unit) in enumerate(of_both):
            rows.append(Number(f"{name} {kind}", value, unit, verdict, "", name + repeat, mode.covariance[place], place))
    return rows


def _nearest(found_Hz: Sequence[float], expected_Hz: Sequence[float]) -> list[str]:
    """Return a name for each frequency: the nearest mode's, each given once, nearest pairs first; so that a name stays with its mode."""
    pairs = sorted(
        (abs(math.log(one / other)), i, k) for i, one in enumerate(found_Hz) for k, other in enumerate(expected_Hz) if one > 0.0 < other
    )
    mode_of: dict[int, int] = {}
    for _, i, k in pairs:
        if i not in mode_of and k not in mode_of.values():
            mode_of[i] = k
    left = [i for i in range(len(found_Hz)) if i not in mode_of]
    return [f"mode {mode_of[i] + 1}" if i in mode_of else f"further mode {left.index(i) + 1}" for i in range(len(found_Hz))]


def of_diagnosis(diagnosis: Diagnosis) -> list[Number]:
    """Return the verdict, and what was found and re-tuned."""
    verdict = diagnosis.verdict
    rows = [Number("verdict", math.nan, "", verdict, diagnosis.reason)]
    for finding in diagnosis.findings:
        if finding.kind == "number" and finding.name in diagnosis.retuned:
            continue  # among the numbers of the file, below
        number = f" {finding.effect.number}" if finding.effect.number > 1 else ""
        for name, estimate in finding.parameters.items():
            rows.append(_of_interval(f"{finding.effect.at} {finding.effect.effect}{number} {name}", estimate, verdict))
    for name, value in diagnosis.retuned.items():
        rows.append(_of_interval(name, value, verdict))
    rows.append(Number("unexplained share", diagnosis.unexplained_share, "1", verdict))
    return rows


def _of_interval(quantity: str, estimate: ParameterEstimate | RetunedValue, verdict: str) -> Number:
    deviation = (estimate.ci95[1] - estimate.ci95[0]) / (2.0 * Z95)
    known = (deviation**2,) if math.isfinite(deviation) else ()
    return Number(quantity, estimate.value, estimate.unit, verdict, covariance=known)


def of_friction(fitted: Everyday) -> list[Number]:
    """Return friction and constant load of every driven joint, which each night has; only the verdict where nothing was fitted."""
    if not fitted.names:
        return [Number("verdict", math.nan, "", fitted.diagnosis.verdict, fitted.diagnosis.reason)]
    return of_parameters("friction", "fitted", "", fitted.names, fitted.units, fitted.values, fitted.covariance)


def of_parameters(
    group: str, verdict: str, said: str, names: Sequence[str], units: Sequence[str], values: np.ndarray, covariance: np.ndarray
) -> list[Number]:
    """Return jointly estimated parameters."""
    rows = [Number("verdict", math.nan, "", verdict, said)]
    for place, (name, unit) in enumerate(zip(names, units, strict=True)):
        row = tuple(float(one) for one in covariance[place])
        rows.append(Number(name, float(values[place]), unit, verdict, "", group, row, place))
    return rows
