"""The efforts that the simulation lacks on the joints, over time: a map of what is missing that no effect's form bends."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hil.diagnosis.locating.disturbance import END_s, disturbance
from hil.diagnosis.report.style import BLUE
from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.result import DisturbanceShares

MOST_JOINTS = 4
LEAST_SHARE = 0.01
"""Of the mismatch, below which a joint is not drawn."""


def missing_effort_figure(found: Mismatch, values: np.ndarray, shares: DisturbanceShares) -> Figure | None:
    """A row for each of the joints that reproduce most, along the group with the largest residual; None where no joint does.

    Parameters
    ----------
    found : Mismatch
        Beside the simulation that lacks them.
    values : (parameters,) array
        Its plant parameters.
    shares : DisturbanceShares
    """
    drawn = [name for name, share in sorted(shares.joints.items(), key=lambda pair: -pair[1]) if share >= LEAST_SHARE][:MOST_JOINTS]
    if not drawn:
        return None
    group = max(found.groups, key=lambda one: float(np.sum(((one.mean - one.simulated) / found.noise.std) ** 2)))
    joints = found.machine.plant.tree.joints
    estimated = disturbance(found, group, values)
    figure = Figure(figsize=(9.0, 1.4 + 1.5 * len(drawn)), layout="constrained")
    rows = figure.subplots(len(drawn), squeeze=False, sharex=True)[:, 0]
    for axes, name in zip(rows, drawn, strict=True):
        at = estimated.joints.index(name)
        unit = "Nm" if joints[at].kind == "revolute" else "N"
        axes.plot(group.time_s, estimated.effort[:, at], color=BLUE, lw=0.8)
        axes.set_ylabel(f"on {name} [{unit}]")
        axes.set_title(f"{name}: reproduces {shares.joints[name]:.0%} of all mismatch by itself", fontsize="small", loc="left")
        axes.grid(alpha=0.3, lw=0.5)
    rows[-1].set_xlabel("time [s]")
    of = group.labels[0] if group.repeats == 1 else f"mean of {group.repeats} repeats from {group.labels[0]} on"
    said = f"Effort that the re-tuned simulation lacks, {of}\n(it is known but for {END_s:g} s at either end, where it goes to zero)"
    figure.suptitle(said, fontsize="medium")
    return figure
