"""Frequency response matrices as charts: magnitude and phase of every element, what is uncertain of them, and marked modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.identification import FrequencyResponse
from hil.pages import Chart, Charts, Mark, Scale, Series

FREQUENCY = Scale("frequency [Hz]", is_log=True)
PHASE = Scale("phase [°]", ends=(-200.0, 200.0))
PHASE_PX = 110


def frf_charts(
    response: FrequencyResponse,
    elements: Sequence[tuple[int, int]] | None = None,
    *,
    compared: Sequence[tuple[str, np.ndarray, np.ndarray]] = (),
    marks: Sequence[Mark] = (),
    pose: str = "",
) -> Charts:
    """Return a cell for every element, the elements of one output beside each other.

    Parameters
    ----------
    response : FrequencyResponse
    elements : sequence of (output, input), optional
        Those that are shown; all unless given.
    compared : sequence of (label, frequencies_Hz (K,), G (K, n_y, n_u))
        Drawn over it, e.g. a model.
    marks : sequence of Mark
        Modes, at their frequencies [Hz].
    pose : str
    """
    _, n_y, n_u = response.G.shape
    chosen = [(i, j) for i in range(n_y) for j in range(n_u)] if elements is None else list(elements)
    low, high = response.frequencies_Hz[[0, -1]]
    inside = [mark for mark in marks if low <= mark.x <= high]
    return Charts([_element(response, i, j, compared, inside, pose) for i, j in chosen], columns=min(n_u, 2))


def _element(
    response: FrequencyResponse,
    i: int,
    j: int,
    compared: Sequence[tuple[str, np.ndarray, np.ndarray]],
    marks: Sequence[Mark],
    pose: str,
) -> tuple[Chart, Chart]:
    at = response.frequencies_Hz
    magnitude = [Series("|G|", at, _positive(response.G[:, i, j]), look=0)]
    phase = [Series("phase", at, np.degrees(np.angle(response.G[:, i, j])), is_points=True, look=0)]
    if response.noise_covariance is not None:
        magnitude.append(Series("noise (standard deviation)", at, _positive(response.standard_deviation("noise")[:, i, j]), True, look=2))
    if response.nonlinear_covariance is not None:
        deviation = response.standard_deviation("nonlinear")[:, i, j]
        magnitude.append(Series("nonlinear distortion (standard deviation)", at, _positive(deviation), True, look=5))
    for k, (label, frequencies, G) in enumerate(compared):
        look = (1, 3, 4)[k % 3]
        magnitude.append(Series(label, frequencies, _positive(G[:, i, j]), look=look))
        phase.append(Series(label, frequencies, np.degrees(np.angle(G[:, i, j])), look=look))
    title = f"{response.input_names[j]} → {response.output_names[i]}"
    unit = ratio(response.output_units[i], response.input_units[j])
    return (
        Chart(title, FREQUENCY, Scale(f"magnitude [{unit}]", is_log=True), magnitude, marks=marks, pose=pose, group="frequency"),
        Chart(f"{title}, phase", FREQUENCY, PHASE, phase, group="frequency", height=PHASE_PX),
    )


def own_elements(response: FrequencyResponse) -> list[tuple[int, int]]:
    """Return the elements (output, input) of the same axis: `command_roll` to `position_roll` and the like; all where there is none."""
    own = [
        (i, j)
        for i, output in enumerate(response.output_names)
        for j, source in enumerate(response.input_names)
        if output.startswith("position_") and output.partition("_")[2] == source.partition("_")[2]
    ]
    return own or [(i, j) for i in range(response.G.shape[1]) for j in range(response.G.shape[2])]


def ratio(output_unit: str, input_unit: str) -> str:
    """Return the unit of an element."""
    if not input_unit:
        return output_unit or "1"
    if "/" in output_unit:
        above, _, below = output_unit.partition("/")
        return f"{above}/({below} {input_unit})"
    return f"{output_unit or '1'}/{input_unit}"


def _positive(values: np.ndarray) -> np.ndarray:
    """Magnitudes; what is zero has no logarithm and is left out."""
    magnitude = np.abs(values)
    return np.where(magnitude > 0.0, magnitude, np.nan)
