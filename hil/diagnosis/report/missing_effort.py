"""The efforts that the simulation lacks on the joints, over time: a map of what is missing that no effect's form bends."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.locating.disturbance import END_s, disturbance
from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.result import DisturbanceShares
from hil.pages import Chart, Charts, Scale, Series

MOST_JOINTS = 4
LEAST_SHARE = 0.01
"""Of the mismatch, below which a joint is not drawn."""


def missing_effort_charts(found: Mismatch, values: np.ndarray, shares: DisturbanceShares) -> Charts | None:
    """A chart for each of the joints that reproduce most, along the group with the largest residual; None where no joint does.

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
    of = group.labels[0] if group.repeats == 1 else f"mean of {group.repeats} repeats from {group.labels[0]} on"
    cells = []
    for name in drawn:
        at = estimated.joints.index(name)
        unit = "Nm" if joints[at].kind == "revolute" else "N"
        cells.append(
            Chart(
                f"Effort that the re-tuned simulation lacks on {name}",
                Scale("time [s]"),
                Scale(f"on {name} [{unit}]"),
                [Series(name, group.time_s, estimated.effort[:, at], look=2)],
                pose=of,
                note=f"It reproduces {shares.joints[name]:.0%} of all mismatch by itself. It is known but for {END_s:g} s at either end,"
                " where it goes to zero.",
                group="time",
            )
        )
    return Charts(cells, columns=min(2, len(cells)))
