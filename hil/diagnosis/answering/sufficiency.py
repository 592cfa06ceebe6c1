"""Do these recordings hold enough to say anything? If not, what is missing."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.residuals.spectra import FILTER_ORDER
from hil.diagnosis.searching.selection import Selection

LEAST_DURATION_s = 1.0
LEAST_ROWS = 8 * FILTER_ORDER
LEAST_SIGNAL = 3.0
"""Motion in units of the channels' noise below which nothing moved."""

DETECTABLE_SHARE = 0.5
"""Where friction must be this share of the drive's rms effort to be seen, nothing found says nothing."""


def what_is_missing(train: Mismatch, selection: Selection) -> str:
    """One sentence; "" where the recordings suffice."""
    longest = max((group for group in train.groups), key=lambda group: len(group.time_s))
    period = 1.0 / train.machine.sample_rate_Hz  # the last row lasts one, too
    duration = float(sum(group.time_s[-1] - group.time_s[0] + period for group in train.groups))
    if duration < LEAST_DURATION_s - 0.5 * period:
        return f"the recordings last {duration:.3g} s in all; {LEAST_DURATION_s:g} s or more are needed"
    if len(longest.time_s) < LEAST_ROWS:
        return f"the longest recording has {len(longest.time_s)} rows; {LEAST_ROWS} or more are needed"
    moves = np.array([np.std(group.mean, axis=0) for group in train.groups]).max(axis=0) / train.noise.std
    if not any(gate.passed for gate in selection.gates) and moves.max() < LEAST_SIGNAL:
        return f"nothing moves: the liveliest channel varies by {moves.max():.2g} times its noise; record a motion or an excitation"
    if not any(gate.significant for gate in selection.gates):
        return _friction_that_would_hide(train, selection)
    return ""


def _friction_that_would_hide(train: Mismatch, selection: Selection) -> str:
    """A sentence where Coulomb friction as large as half the drive's own effort could be there unseen, on every axis; else ""."""
    settings = train.machine.plant
    limits = {}
    for screened in selection.screened:
        if screened.effect.effect != "coulomb_friction" or not selection.gates:
            continue
        drive = next(drive for drive in settings.drives if drive.axis == screened.effect.at)
        axis = train.machine.axis_index(drive.axis)
        effort = max(float(np.sqrt(np.mean(group.effort[:, axis] ** 2))) for group in train.groups) * abs(drive.constant * drive.ratio)
        energy = float(screened.response.astype(float) @ screened.response)
        seen = float(screened.values[0]) * np.sqrt(selection.gates[0].needed / energy) if energy > 0.0 else np.inf
        limits[drive.axis] = seen / effort if effort > 0.0 else np.inf
    if not limits or min(limits.values()) < DETECTABLE_SHARE:
        return ""
    shares = ", ".join(f"{share:.0%} of the drive's effort on {axis}" for axis, share in limits.items() if np.isfinite(share))
    return f"too little moves: friction of {shares or 'any size'} would stay unseen; record more motion, or more repeats"
