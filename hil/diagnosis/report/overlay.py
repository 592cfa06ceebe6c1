"""Recorded beside simulated, nominal, re-tuned and with the effects: current beside encoder beside IMU, to zoom into."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hil.diagnosis.report.style import STAGE_LOOKS, STAGE_NAMES
from hil.diagnosis.residuals.mismatch import Mismatch
from hil.pages import Band, Chart, Charts, Scale, Series

RESIDUAL_PX = 150
WITHIN = 2.0
"""Standard deviations of the band of noise."""

KINDS = (("current_", "effort_", "command_"), ("position_", "link_position_", "speed_"), ("imu_", "gyro_"))
"""One column each; of every kind the channel with the largest mismatch."""


def overlay_charts(found: Mismatch, stages: Mapping[str, Sequence[np.ndarray]], title: str) -> Charts:
    """Above, the channel and its simulations; below, what each leaves, with the noise of one repeat as a grey band.

    Parameters
    ----------
    found : Mismatch
    stages : mapping of str to sequence of (N, C) arrays
        Simulated rows per group at "nominal", "retuned" and, where an effect is named, "extended".
    """
    number = _most_changed(found, stages)
    group, time = found.groups[number], Scale("time [s]")
    of = f"mean of {group.repeats} repeats from {group.labels[0]} on" if group.repeats > 1 else group.labels[0]
    cells = []
    for c in _columns(found, stages, number):
        name, unit = found.channels[c], f" [{found.units[c]}]" if found.units[c] else ""
        sigma = np.full(len(group.time_s), WITHIN * float(found.noise.std[c]))
        overlaid = [Series("recorded", group.time_s, group.mean[:, c], look=0)]
        left = []
        for stage, simulated in stages.items():
            look = STAGE_LOOKS[stage]
            overlaid.append(Series(STAGE_NAMES[stage], group.time_s, simulated[number][:, c], look=look))
            left.append(Series(STAGE_NAMES[stage], group.time_s, group.mean[:, c] - simulated[number][:, c], look=look))
        noise = Band(f"noise, ±{WITHIN:g} standard deviations", group.time_s, -sigma, sigma)
        cells.append(
            (
                Chart(f"{title}: {name}", time, Scale(name + unit), overlaid, pose=of, group="time"),
                Chart(f"{name}: recorded less simulated", time, Scale(f"residual{unit}"), left, [noise], group="time", height=RESIDUAL_PX),
            )
        )
    return Charts(cells, columns=min(2, len(cells)))


def _most_changed(found: Mismatch, stages: Mapping[str, Sequence[np.ndarray]]) -> int:
    """Return the group in which the nominal simulation and the last one differ most, in units of noise."""
    first, *_, last = stages["nominal"], *stages.values()
    change = [float(np.mean(((b - a) / found.noise.std) ** 2)) for a, b in zip(first, last, strict=True)]
    return int(np.argmax(np.nan_to_num(change, nan=0.0, posinf=0.0)))


def _columns(found: Mismatch, stages: Mapping[str, Sequence[np.ndarray]], number: int) -> list[int]:
    """One channel of every kind there is."""
    residual = found.groups[number].mean - stages["nominal"][number]
    size = np.sqrt(np.mean(residual**2, axis=0)) / found.noise.std
    chosen = []
    for kind in KINDS:
        of_kind = [c for c, name in enumerate(found.channels) if name.startswith(kind)]
        if of_kind:
            chosen.append(max(of_kind, key=lambda c: size[c]))
    return chosen
