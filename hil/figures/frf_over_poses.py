"""Figures of frequency responses over poses: surfaces as in Figs. 4.6 to 4.9, variances beside each other as in Figs. 4.8 and 4.10."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from hil.identification.result import CovarianceKind, FrequencyResponse

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")  # Okabe and Ito
KINDS: tuple[CovarianceKind, ...] = ("noise", "nonlinear")
LINES = ("-", "--", ":", "-.")


def surface_figure(responses: Sequence[FrequencyResponse], direction: int, *, angle: bool = True, title: str = "") -> Figure:
    """Draw the magnitude of every element over frequency and one scheduling parameter.

    Parameters
    ----------
    responses : one per pose, at the same lines.
    direction : column of the poses that is the vertical axis.
    angle : the scheduling parameter is an angle and drawn in degrees.
    """
    responses = sorted(responses, key=lambda response: response.pose[direction])
    first = responses[0]
    _, n_y, n_u = first.G.shape
    poses = np.array([response.pose[direction] for response in responses])
    figure = Figure(figsize=(4.0 * n_u + 0.6, 2.7 * n_y + 0.5), layout="constrained")
    grid = figure.subplots(n_y, n_u, sharex=True, sharey=True, squeeze=False)
    for i in range(n_y):
        for j in range(n_u):
            level = 20.0 * np.log10(np.abs(np.stack([response.G[:, i, j] for response in responses])) + np.finfo(float).tiny)
            drawn = grid[i, j].pcolormesh(
                first.frequencies_Hz, np.degrees(poses) if angle else poses, level, shading="nearest", cmap="cividis"
            )
            grid[i, j].set_xscale("log")
            grid[i, j].set_title(f"{first.output_names[i]} from {first.input_names[j]}", fontsize="medium")
            figure.colorbar(drawn, ax=grid[i, j], label=f"dB re {first.output_units[i] or '1'} per {first.input_units[j] or '1'}")
    for axes in grid[-1]:
        axes.set_xlabel("Frequency [Hz]")
    for axes in grid[:, 0]:
        axes.set_ylabel("pose [°]" if angle else "pose")
    if title:
        figure.suptitle(title)
    return figure


def variance_figure(methods: Mapping[str, Sequence[FrequencyResponse]], *, title: str = "") -> Figure:
    """Draw magnitude, noise and nonlinear standard deviations averaged over poses, methods beside each other.

    Parameters
    ----------
    methods : name of a method and its responses, one per pose.
    """
    first = next(iter(methods.values()))[0]
    _, n_y, n_u = first.G.shape
    figure = Figure(figsize=(3.8 * n_u + 0.8, 2.6 * n_y + 0.8), layout="constrained")
    grid = figure.subplots(n_y, n_u, sharex=True, squeeze=False)
    for i in range(n_y):
        for j in range(n_u):
            axes = grid[i, j]
            axes.semilogx(
                first.frequencies_Hz, _mean_dB([np.abs(r.G[:, i, j]) ** 2 for r in _first_of(methods)]), color="black", label="|G|"
            )
            for (name, responses), colour in zip(methods.items(), COLOURS, strict=False):
                for kind, line in zip(KINDS, LINES, strict=False):
                    if responses[0].noise_covariance is None or (kind == "nonlinear" and responses[0].nonlinear_covariance is None):
                        continue
                    square = [r.standard_deviation(kind)[:, i, j] ** 2 for r in responses]
                    axes.semilogx(
                        first.frequencies_Hz, _mean_dB(square), color=colour, linestyle=line, linewidth=0.9, label=f"{name}, {kind}"
                    )
            axes.set_title(f"{first.output_names[i]} from {first.input_names[j]}", fontsize="medium")
            axes.grid(alpha=0.3, linewidth=0.5)
        grid[i, 0].set_ylabel(f"dB re {first.output_units[i] or '1'} per {first.input_units[0] or '1'}")
    for axes in grid[-1]:
        axes.set_xlabel("Frequency [Hz]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    if title:
        figure.suptitle(title)
    return figure


def _first_of(methods: Mapping[str, Sequence[FrequencyResponse]]) -> Sequence[FrequencyResponse]:
    """Return the responses of the first method, whose magnitude is drawn for all."""
    return next(iter(methods.values()))


def _mean_dB(squares: Sequence[np.ndarray]) -> np.ndarray:
    decibels: np.ndarray = 10.0 * np.log10(np.mean(squares, axis=0) + np.finfo(float).tiny)
    return decibels
