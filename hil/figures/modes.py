"""Figures of fitted modes over the poses: natural frequencies and damping ratios, beside the fits pose by pose."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hil.identification.modal.lpv_model import ModalFrfModel

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito
POINTS = 121
POINTS_OF_MAP = 41  # along either axis


def modes_figure(model: ModalFrfModel, *, angle: bool = True, title: str = "", axes_names: tuple[str, ...] = ()) -> Figure:
    """Draw the model over its poses: curves with 95 % bands along one axis, a map for every mode over two.

    Parameters
    ----------
    angle : the scheduling parameters are angles and drawn in degrees.
    axes_names : of the scheduling parameters, for the labels.
    """
    figure = _curves(model, angle) if len(model.directions) == 1 else _maps(model, angle, axes_names or ("first axis", "second axis"))
    if title:
        figure.suptitle(title)
    return figure


def _curves(model: ModalFrfModel, angle: bool) -> Figure:
    low, high = model.pose_range[0].tolist()
    along = np.linspace(low, high, POINTS)
    curves = [np.stack(values) for values in zip(*(model.modes(pose) for pose in along), strict=True)]
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    frequency, damping = figure.subplots(2, 1, sharex=True)
    poses = model.poses[:, 0]
    shown, points = (np.degrees(along), np.degrees(poses)) if angle else (along, poses)
    for k in range(curves[0].shape[1]):
        colour = COLOURS[k % len(COLOURS)]
        for axes, value, half in ((frequency, curves[0][:, k], curves[2][:, k]), (damping, 100 * curves[1][:, k], 100 * curves[3][:, k])):
            axes.plot(shown, value, color=colour, linewidth=1.2, label=f"mode {k + 1}")
            axes.fill_between(shown, value - half, value + half, color=colour, alpha=0.25, linewidth=0)
        frequency.plot(points, model.alone[:, k, 0], ".", color=colour, markersize=5)
        damping.plot(points, 100 * model.alone[:, k, 1], ".", color=colour, markersize=5)
    frequency.set_ylabel("natural frequency [Hz]")
    damping.set_ylabel("damping ratio [%]")
    damping.set_yscale("log")
    damping.yaxis.set_major_formatter("{x:g}")
    damping.yaxis.set_minor_formatter("{x:g}")
    damping.set_xlabel("pose [°]" if angle else "pose [m]")
    for axes in (frequency, damping):
        axes.grid(alpha=0.3, linewidth=0.5)
    frequency.legend(ncols=3, fontsize="small")
    return figure


def _maps(model: ModalFrfModel, angle: bool, names: tuple[str, ...]) -> Figure:
    """Draw a row for every mode, with a dot at each pose in the colour of the fit there alone."""
    first, second = (np.linspace(low, high, POINTS_OF_MAP) for low, high in model.pose_range.tolist())
    found = [[model.modes((x, y)) for x in first] for y in second]
    modes = len(found[0][0][0])
    figure = Figure(figsize=(8.4, 0.8 + 2.8 * modes), layout="constrained")
    unit, scale = ("°", 180.0 / np.pi) if angle else ("m", 1.0)
    for k, row in enumerate(figure.subplots(modes, 2, squeeze=False, sharex=True, sharey=True)):
        for axes, place, factor, what in ((row[0], 0, 1.0, "natural frequency [Hz]"), (row[1], 1, 100.0, "damping ratio [%]")):
            values = factor * np.array([[each[place][k] for each in line] for line in found])
            alone = factor * model.alone[:, k, place]
            limits = min(values.min(), alone.min()), max(values.max(), alone.max())
            colours = {"cmap": "viridis", "vmin": limits[0], "vmax": limits[1]}
            shown = axes.pcolormesh(scale * first, scale * second, values, shading="nearest", **colours)
            axes.scatter(*(scale * model.poses).T, c=alone, edgecolors="white", linewidths=0.8, s=36, **colours)
            figure.colorbar(shown, ax=axes, label=what, format="%.4g")
            axes.set_title(f"mode {k + 1}", fontsize="small")
        row[0].set_ylabel(f"{names[1]} [{unit}]")
    for axes in figure.axes[2 * (modes - 1) : 2 * modes]:
        axes.set_xlabel(f"{names[0]} [{unit}]")
    return figure
