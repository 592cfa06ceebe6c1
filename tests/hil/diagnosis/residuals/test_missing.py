"""What the machine file's equations lack along a motion, beside Euler steps of a mass on a damper."""

from __future__ import annotations

import numpy as np
from pushed_mass import RAIL, MASS_kg, recorded

from hil.diagnosis.residuals.residuals import residuals_of


def test_of_a_complete_file_nothing_is_missing_while_efforts_change_either() -> None:
    """Efforts act from one row to the next: beside those that the motion takes at a row they would be half a row early."""
    period_s = 1.0 / RAIL.sample_rate_Hz
    time_s = np.arange(round(6.0 * RAIL.sample_rate_Hz)) * period_s
    whole = 2.0 * np.pi
    reference = 0.02 * np.sin(whole * 0.5 * time_s) + 0.005 * np.sin(whole * 1.7 * time_s) * np.minimum(time_s, 1.0)
    (missing,) = residuals_of(RAIL, {"a": recorded(reference, lambda *_: 0.0, seed=1, noise=0.02)}).missing()
    inside = slice(50, -50)
    jerk = np.gradient(np.gradient(missing.speed, period_s), period_s)[inside]
    early = 0.5 * period_s * MASS_kg * jerk
    followed = float(np.dot(early, missing.missing[inside]) / np.dot(early, early))
    print(f"of a lag of half a row {followed:.1%} is left")
    assert abs(followed) < 0.1
    assert len(missing.time) == len(missing.given) == len(time_s) - 1
