"""Figure of fitted modes over the pose: natural frequencies and damping ratios with their intervals, beside the fits pose by pose."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hil.identification.modal.lpv_model import ModalFrfModel

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito
POINTS = 121


def modes_figure(model: ModalFrfModel, *, angle: bool = True, title: str = "") -> Figure:
    """Draw curves of the model with 95 % bands, and points of the fits at single poses.

    Parameters
    ----------
    angle : the scheduling parameter is an angle and drawn in degrees.
    """
    along = np.linspace(*model.pose_range, POINTS)
    curves = [np.stack(values) for values in zip(*(model.modes(pose) for pose in along), strict=True)]
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    frequency, damping = figure.subplots(2, 1, sharex=True)
    shown, points = (np.degrees(along), np.degrees(model.poses)) if angle else (along, model.poses)
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
    damping.set_xlabel("pose [°]" if angle else "pose")
    for axes in (frequency, damping):
        axes.grid(alpha=0.3, linewidth=0.5)
    frequency.legend(ncols=3, fontsize="small")
    if title:
        figure.suptitle(title)
    return figure
