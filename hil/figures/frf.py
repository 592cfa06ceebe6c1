"""Figures of frequency response matrices: magnitude and phase with their standard deviations, as in Fig. 3.3."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hil.identification.modal.resonances import Resonance
from hil.identification.result import FrequencyResponse

# Okabe and Ito's palette: told apart by colour-blind readers and in grey
BLUE, VERMILION, ORANGE, GREY = "#0072B2", "#D55E00", "#E69F00", "#BBBBBB"
CELL_WIDTH_IN, MAGNITUDE_HEIGHT_IN, PHASE_HEIGHT_IN = 3.6, 1.7, 0.8
NUMBER_WIDTH = 0.04  # of a panel, that the number of a resonance takes


def frf_figure(
    response: FrequencyResponse,
    *,
    over_poses: Sequence[FrequencyResponse] = (),
    compared: Sequence[tuple[str, np.ndarray, np.ndarray]] = (),
    modes: Sequence[Resonance] = (),
    title: str = "",
) -> Figure:
    """Draw magnitude and phase of every element, with the standard deviations due to noise and to nonlinear distortion.

    Parameters
    ----------
    response : the frequency response drawn.
    over_poses : responses whose range of magnitudes is drawn as a grey band.
    compared : (label, frequencies_Hz (K,), G (K, n_y, n_u)) drawn as thin lines, e.g. a model.
    modes : resonances, marked with frequency and damping ratio.
    title : above the grid; the pose where none is given.
    """
    _, n_y, n_u = response.G.shape
    figure = Figure(figsize=(CELL_WIDTH_IN * n_u + 1.0, (MAGNITUDE_HEIGHT_IN + PHASE_HEIGHT_IN) * n_y + 0.9), layout="constrained")
    grid = figure.subplots(2 * n_y, n_u, sharex=True, squeeze=False, height_ratios=[MAGNITUDE_HEIGHT_IN, PHASE_HEIGHT_IN] * n_y)
    for i in range(n_y):
        for j in range(n_u):
            _draw_magnitude(grid[2 * i, j], response, i, j, over_poses, compared)
            _draw_phase(grid[2 * i + 1, j], response, i, j, compared)
            _mark(grid[2 * i, j], modes, named=i == 0)
            _mark(grid[2 * i + 1, j], modes, named=False)
    for j in range(n_u):
        grid[-1, j].set_xlabel("Frequency [Hz]")
        grid[0, j].set_title(f"from {_label(response.input_names[j], response.input_units[j])}", fontsize="medium", pad=12.0)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), n_u), frameon=False)
    if lines := [line for line in (title, _named(modes)) if line]:
        figure.suptitle("\n".join(lines), fontsize="medium")
    figure.align_ylabels(grid[:, 0])
    return figure


def _draw_magnitude(
    axes: Axes,
    response: FrequencyResponse,
    i: int,
    j: int,
    over_poses: Sequence[FrequencyResponse],
    compared: Sequence[tuple[str, np.ndarray, np.ndarray]],
) -> None:
    frequencies = response.frequencies_Hz
    if over_poses:
        low, high = _band(over_poses, frequencies, i, j)
        axes.fill_between(frequencies, _dB(low), _dB(high), color=GREY, linewidth=0, label="range over poses")
    axes.semilogx(frequencies, _dB(response.G[:, i, j]), color=BLUE, linewidth=1.2, label="|G|")
    if response.noise_covariance is not None:
        noise = response.standard_deviation("noise")[:, i, j]
        axes.semilogx(frequencies, _dB(noise), ".", color=VERMILION, markersize=2.5, label="standard deviation, noise")
    if response.nonlinear_covariance is not None:
        nonlinear = response.standard_deviation("nonlinear")[:, i, j]
        axes.semilogx(frequencies, _dB(nonlinear), "x", color=ORANGE, markersize=3, label="standard deviation, nonlinear distortion")
    for number, (label, at, G) in enumerate(compared):
        axes.semilogx(at, _dB(G[:, i, j]), color="black", linewidth=0.8, linestyle=("--", ":", "-.")[number % 3], label=label)
    if j == 0:
        axes.set_ylabel(
            f"{response.output_names[i]}\n[dB re {_ratio(response.output_units[i], response.input_units[j])}]", fontsize="small"
        )
    axes.grid(alpha=0.3, linewidth=0.5)


def _mark(axes: Axes, modes: Sequence[Resonance], *, named: bool) -> None:
    """Mark resonances by lines, with their numbers where `named`; close ones go one below the other."""
    low, high = axes.get_xlim()
    row, last = 0, -np.inf
    for number, mode in enumerate(modes, start=1):
        axes.axvline(mode.frequency_Hz, color="black", linewidth=0.6, linestyle=(0, (2, 2)))
        at = np.log(mode.frequency_Hz / low) / np.log(high / low)
        row, last = (row + 1 if at - last < NUMBER_WIDTH else 0), at
        if named:
            axes.annotate(
                str(number),
                (mode.frequency_Hz, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0.0, 1.0 + 8.0 * row),
                textcoords="offset points",
                horizontalalignment="center",
                fontsize="x-small",
            )


def _named(modes: Sequence[Resonance]) -> str:
    """Return the marked resonances by their numbers, for the title."""
    each = [f"{number}: {mode.frequency_Hz:.3g} Hz, {100.0 * mode.damping:.2g} %" for number, mode in enumerate(modes, start=1)]
    return "frequency and damping of the modes  " + ";  ".join(each) if each else ""


def _draw_phase(axes: Axes, response: FrequencyResponse, i: int, j: int, compared: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> None:
    axes.semilogx(response.frequencies_Hz, np.degrees(np.angle(response.G[:, i, j])), ".", color=BLUE, markersize=2)
    for number, (_, at, G) in enumerate(compared):
        axes.semilogx(at, np.degrees(np.angle(G[:, i, j])), color="black", linewidth=0.6, linestyle=("--", ":", "-.")[number % 3])
    axes.set_ylim(-190, 190)
    axes.set_yticks((-180, 0, 180))
    if j == 0:
        axes.set_ylabel("phase [°]", fontsize="small")
    axes.grid(alpha=0.3, linewidth=0.5)


def _band(over_poses: Sequence[FrequencyResponse], frequencies: np.ndarray, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
    magnitudes = np.stack([np.interp(frequencies, pose.frequencies_Hz, np.abs(pose.G[:, i, j])) for pose in over_poses])
    return magnitudes.min(axis=0), magnitudes.max(axis=0)


def _dB(values: np.ndarray) -> np.ndarray:
    """Return 20 lg |x|; zeros, which have none, are left out of the curve."""
    magnitude = np.abs(values)
    return np.where(magnitude > 0.0, 20.0 * np.log10(np.where(magnitude > 0.0, magnitude, 1.0)), np.nan)


def _label(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _ratio(output_unit: str, input_unit: str) -> str:
    if not output_unit and not input_unit:
        return "1"
    if "/" in output_unit and input_unit:
        numerator, denominator = output_unit.split("/", 1)
        return f"{numerator}/({denominator} {input_unit})"
    return f"{output_unit or '1'}/{input_unit}" if input_unit else output_unit
