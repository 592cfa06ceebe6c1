"""What the lattices of encoder and target do in a loop, which free runs leave out and repeats may share.

A loop rounds what it reads and what it asks for. The errors are small, they go around the loop, and which ones come depends on where within
a count the motion is: a free run that is off by a fraction of a count has others (Widrow and Kollár 2008, ch. 5 and 17). So they are noise
to whoever simulates. Repeats that are apart by a count or more have each their own, and their deviations show them. Repeats that are closer
(an emulator's are equal) share them: no deviation shows them, and a mean of repeats keeps them whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.simulation import Inputs, Simulator
from hil.simulation.smooth import simulated_matrix, smooth

PHASES = 8
"""Places within a count, equally far apart, that the loop's errors are drawn for: as many records as their spectrum is averaged over."""

LEAST_SHARED = 1e-3
"""A smaller part of the errors' power is not told from none."""


def loop_lattices(groups: Sequence[RepeatGroup], channels: Sequence[str]) -> list[tuple[RepeatGroup, np.ndarray]]:
    """By how much simulations with the loop's lattices differ from one without, at the nominal machine, as far as repeats share it.

    Parameters
    ----------
    groups : sequence of RepeatGroup
    channels : sequence of str

    Returns
    -------
    list of (RepeatGroup, (N, C) array)
        Records whose mean power is that of the errors; none where repeats do not share any, or no loop is closed.
    """
    found = []
    for group in groups:
        shared = {axis: _shared(group, axis, channels) for axis in group.machine.axes} if group.machine.controllers else {}
        rounding = [axis for axis, share in shared.items() if share > LEAST_SHARED]
        if not rounding or group.repeats < 2:
            continue
        without = rows_of(Simulator(smooth(group.machine)), group.inputs, channels)
        for axis in rounding:
            weight = np.sqrt(shared[axis] * len(rounding))  # powers of axes add up, those of records are averaged
            simulator = Simulator(smooth(group.machine, rounded=axis))
            for phase in (np.arange(PHASES) + 0.5) / PHASES - 0.5:
                errors = _rounded(simulator, group.inputs, channels, axis, phase) - without
                found += [(group, weight * errors[window]) for window in group.windows]
    return found


def _shared(group: RepeatGroup, axis: str, channels: Sequence[str]) -> float:
    """Share of the power of an encoder's rounding errors that repeats have in common.

    The rounding errors of two positions that are d apart, at any place within a count q, are correlated by cos(2 pi d / q) in their first
    harmonic: by exp(-2 pi^2 var(d) / q^2) in the mean over a normal d. And two readings differ by |d| in the mean over the places.
    """
    name = f"position_{axis}"
    count = next((encoder.resolution for encoder in group.machine.plant.encoders if encoder.channel == name), 0.0)
    if count <= 0.0:
        return 0.0
    if name not in channels:
        return 0.0 if np.ptp(group.position[:, group.machine.axis_index(axis)]) else 1.0
    read = group.measured[:, :, list(channels).index(name)]
    pairs = [np.abs(read[i] - read[j]) for i in range(len(read)) for j in range(i)]
    if not pairs:
        return 0.0
    apart = float(np.nanmean(pairs))
    return float(np.exp(-2.0 * np.pi**2 * (0.5 * np.pi) * (apart / count) ** 2))


def _rounded(simulator: Simulator, inputs: Inputs, channels: Sequence[str], axis: str, phase: float) -> np.ndarray:
    """(N, C) with an axis' lattices, its encoder's zero off by `phase` counts: homing knows it no better than to a count.

    A loop whose encoder reads too much by b stands at the reference less b.
    """
    assert inputs.reference is not None
    machine = simulator.machine
    name = f"position_{axis}"
    offset = phase * next(encoder.resolution for encoder in machine.plant.encoders if encoder.channel == name)
    off = np.where([one == axis for one in machine.axes], offset, 0.0)
    shifted = replace(inputs, reference=inputs.reference - off, start_pose=inputs.start_pose - off)
    rows = rows_of(simulator, shifted, channels)
    if name in channels:
        rows[:, list(channels).index(name)] += offset
    return rows


def rows_of(simulator: Simulator, inputs: Inputs, channels: Sequence[str]) -> np.ndarray:
    """(N, C) of one run."""
    return simulated_matrix(simulator.machine, simulator.run(inputs), channels)
