"""Properties of the reference to shape: the frequencies that must pass unchanged, and its duration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.errors import DesignError


@dataclass(frozen=True)
class Aim:
    """The design goal of a shaper; made by `sweep` or `periodic`."""

    kind: str
    """`sweep` or `periodic`."""
    forcing_rad_s: tuple[float, ...]
    """Frequencies tracked without error, 0 (the mean) always among them."""
    without_slope_rad_s: tuple[float, ...]
    """Those of them where dH/ds is zero, too; 0 for a ramp without lag."""
    longest_transient_s: float
    """Longest transient for which the scan has time."""


def sweep(longest_transient_s: float = 0.6) -> Aim:
    """Return the goal for a move or a sweep: a mean and a ramp pass, H(0) = 1 and dH/ds(0) = 0."""
    if not longest_transient_s > 0.0:
        raise DesignError(f"a transient of {longest_transient_s:g} s: must be positive")
    return Aim("sweep", (0.0,), (0.0,), longest_transient_s)


def periodic(period_s: float, harmonics: Sequence[int] = (1, 3, 5), longest_transient_s: float | None = None) -> Aim:
    """Return the goal for a periodic scan about a mean: these harmonics of 1/period pass; the transient may take one period unless given.

    Raises
    ------
    DesignError
        The harmonics are not different whole numbers from 1 on.
    """
    if not (np.isfinite(period_s) and period_s > 0.0):
        raise DesignError(f"a period of {period_s:g} s: must be positive")
    if not harmonics or len(set(harmonics)) < len(harmonics) or min(harmonics) < 1:
        raise DesignError(f"harmonics {list(harmonics)}: must be different whole numbers from 1 on")
    forcing = (0.0, *(2.0 * np.pi * k / period_s for k in sorted(harmonics)))
    return Aim("periodic", forcing, (), period_s if longest_transient_s is None else longest_transient_s)
