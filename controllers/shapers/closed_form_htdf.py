"""Harmonic filter in closed form for a second-order plant and one forcing frequency, (7.4)-(7.14)."""

from __future__ import annotations

import numpy as np

from controllers.shapers.conditions import check_apart
from controllers.shapers.delays import DelayFilter


def second_order(natural_rad_s: float, damping: float, forcing_rad_s: float, half_periods: int = 1) -> DelayFilter:
    """Return three taps n half damped periods apart, for P = w^2 / (s^2 + 2 zeta w s + w^2).

    Corrections: Phi_1 = -numerator/denominator of (7.11), the underbrace includes the minus sign, and A_1 = Phi_1 A_2; the sign of A_2 is
    the one that makes Re(G P) > 0 at the forcing frequency, on either side of the resonance.

    Parameters
    ----------
    natural_rad_s, damping, forcing_rad_s : float
    half_periods : int
        n of (7.7).

    Raises
    ------
    DesignError
        The forcing frequency lies on the pole.

    Examples
    --------
    The plant's pole is cancelled, and a reference at the forcing frequency comes through filter and plant as it is.

    >>> import numpy as np
    >>> from controllers.shapers.closed_form_htdf import second_order
    >>> w, zeta, f = 10.0, 0.05, 3.0
    >>> shaper = second_order(w, zeta, f)
    >>> pole = w * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    >>> bool(abs(shaper.response(pole)) < 1e-12)
    True
    >>> bool(np.isclose(abs(shaper.response(1j * f) * w**2 / (w**2 - f**2 + 2j * zeta * w * f)), 1.0))
    True
    """
    w, zeta, f, n = natural_rad_s, damping, forcing_rad_s, half_periods
    damped = w * np.sqrt(1.0 - zeta**2)
    check_apart([complex(-zeta * w, damped)], [f])
    T = n * np.pi / damped  # (7.7)
    grown, sign, lag, stiff = np.exp(zeta * w * T), (-1.0) ** n, 2.0 * zeta * w * f, w**2 - f**2
    numerator = np.sin(2.0 * f * T) * stiff + lag * (np.cos(2.0 * f * T) - grown**2)
    denominator = np.sin(f * T) * stiff + lag * (np.cos(f * T) - sign * grown)
    phi_1 = -numerator / denominator  # (7.11)
    phi_0 = -sign * phi_1 * grown - grown**2  # (7.12)
    # (7.14)
    inner = 1.0 + phi_0**2 + phi_1**2 + 2.0 * (phi_0 * phi_1 + phi_1) * np.cos(f * T) + 2.0 * phi_0 * np.cos(2.0 * f * T)
    a_2 = np.sqrt((stiff**2 + lag**2) / (w**4 * inner))
    gains = a_2 * np.array([phi_0, phi_1, 1.0])
    delays = T * np.arange(3)
    through = gains @ np.exp(-1j * f * delays) * w**2 / (stiff + 1j * lag)
    return DelayFilter(delays, gains * np.sign(through.real), None, "hTDF")
