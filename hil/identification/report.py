"""A frequency response in words."""

from __future__ import annotations

from typing import Literal

import numpy as np

from hil.identification.modal.resonances import METHOD, Resonances
from hil.identification.result import FrequencyResponse

WIDENED = 1.2
"""Misfit from which it is told that bounds are widened: less is the chance of a few hundred lines."""


def response_lines(response: FrequencyResponse, modes: Resonances | None = None) -> list[str]:
    """Return resonances, lines, band, and noise and nonlinear distortion per element as lines of text."""
    frequencies = response.frequencies_Hz
    text = [] if modes is None else resonance_lines(modes)
    text.append(f"{len(frequencies)} lines from {frequencies[0]:.3g} to {frequencies[-1]:.4g} Hz")
    text += [f"note: {note}" for note in response.notes]
    text.append("median standard deviation relative to |G| (noise / total):")
    for i, output in enumerate(response.output_names):
        for j, source in enumerate(response.input_names):
            noise, total = _relative(response, "noise", i, j), _relative(response, "total", i, j)
            text.append(f"  {source} -> {output:22s} {_percent(noise)} / {_percent(total)}")
    return text


def resonance_lines(modes: Resonances) -> list[str]:
    """Return the resonances in words, or why there are none."""
    if not modes.found:
        return [f"no resonance is told: {modes.reason}"]
    count = f"{len(modes.found)} resonance{'s' if len(modes.found) > 1 else ''}"
    left = [f"  the fit leaves {modes.misfit:.2g} times the noise, by which the bounds are widened"] if modes.misfit > WIDENED else []
    return [
        f"{count} with 95 % bounds, averaged over the experiment's motion:",
        *(f"  {mode.line}" for mode in modes.found),
        f"  {METHOD}",
        *left,
    ]


def _deviation(response: FrequencyResponse, kind: Literal["noise", "total"]) -> np.ndarray | None:
    known = response.noise_covariance if kind == "noise" else response.total_covariance
    return None if known is None else response.standard_deviation(kind)


def _relative(response: FrequencyResponse, kind: Literal["noise", "total"], i: int, j: int) -> float | None:
    deviation = _deviation(response, kind)
    if deviation is None:
        return None
    magnitude = np.abs(response.G[:, i, j])
    return float(np.nanmedian(deviation[:, i, j] / np.where(magnitude > 0.0, magnitude, np.nan)))


def _percent(value: float | None) -> str:
    return "not known" if value is None else f"{100.0 * value:.3g} %"
