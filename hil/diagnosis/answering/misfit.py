"""How far simulations are from recordings, in numbers a person can compare: free-run NRMSE per channel, and E in units of noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.diagnosis.result import Stages

Rows = Sequence[np.ndarray]  # (N, C) per group


def misfit_E(mismatch: Mismatch, rows: Rows) -> float:
    """Root mean square over channels of the residual of every repeat, in units of that channel's noise."""
    return float(np.sqrt(np.mean((_rms(mismatch, rows) / mismatch.noise.std) ** 2)))


def nrmse(mismatch: Mismatch, rows: Rows) -> np.ndarray:
    """(C,) rms of simulation less recording over the rms of the recording about its mean; NaN for a channel that does not move."""
    spread = _spread(mismatch)
    return np.where(spread > 0.0, _rms(mismatch, rows) / np.where(spread > 0.0, spread, 1.0), np.nan)


def noise_nrmse(mismatch: Mismatch) -> np.ndarray:
    """(C,) of a perfect simulation."""
    spread = _spread(mismatch)
    return np.where(spread > 0.0, mismatch.noise.std / np.where(spread > 0.0, spread, 1.0), np.nan)


def channel_stages(mismatch: Mismatch, stages: Sequence[Rows | None]) -> dict[str, Stages]:
    """NRMSE of every channel at nominal, retuned, extended and placebo, and of noise alone."""
    columns = [None if rows is None else nrmse(mismatch, rows) for rows in stages]
    floor = noise_nrmse(mismatch)
    found = {}
    for c, name in enumerate(mismatch.channels):
        found[name] = _in_order([None if column is None else float(column[c]) for column in [*columns, floor]])
    return found


def total_stages(mismatch: Mismatch, stages: Sequence[Rows | None]) -> Stages:
    """E at nominal, retuned, extended and placebo; 1 is noise alone."""
    return _in_order([*(None if rows is None else misfit_E(mismatch, rows) for rows in stages), 1.0])


def _in_order(numbers: Sequence[float | None]) -> Stages:
    nominal, retuned, extended, placebo, floor = (None if n is None or not np.isfinite(n) else n for n in numbers)
    return Stages(nominal, retuned, extended, placebo, floor)


def _residuals(group: RepeatGroup, rows: np.ndarray) -> np.ndarray:
    return group.measured - rows


def _rms(mismatch: Mismatch, rows: Rows) -> np.ndarray:
    found = [_residuals(group, values).reshape(-1, len(mismatch.channels)) for group, values in zip(mismatch.groups, rows, strict=True)]
    return np.sqrt(np.nanmean(np.concatenate(found) ** 2, axis=0))


def _spread(mismatch: Mismatch) -> np.ndarray:
    found = [(group.measured - np.nanmean(group.measured, axis=(0, 1))).reshape(-1, len(mismatch.channels)) for group in mismatch.groups]
    return np.sqrt(np.nanmean(np.concatenate(found) ** 2, axis=0))
