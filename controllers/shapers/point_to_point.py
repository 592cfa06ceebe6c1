"""Point-to-point shapers from the literature: ZV, ZVD, EI, two-hump EI, and several modes by convolution.

All have DC gain 1 and positive taps.

Sources: thesis (7.2), (7.3); Singer and Seering 1990 (ZVD); Singhose, Seering and Singer 1994 (EI); Singhose, Crain and Seering 1997
(two-hump EI), with the damped taps as in Klipper: the undamped ones times K^k, K the decay over half a damped period.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.delays import DelayFilter

TOLERATED_VIBRATION = 0.05
"""Share of the unshaped vibration that EI shapers allow at the modelled frequency, as in the literature and in Klipper."""


def zv(frequency_rad_s: float, damping: float) -> DelayFilter:
    """Return the zero-vibration shaper, thesis (7.2), (7.3): two taps half a damped period apart.

    Examples
    --------
    An undamped mode at 2 Hz rests after two equal steps half a period apart.

    >>> import numpy as np
    >>> from controllers.shapers.point_to_point import zv
    >>> shaper = zv(2.0 * np.pi * 2.0, 0.0)
    >>> shaper.delays_s.tolist(), shaper.gains.tolist()
    ([0.0, 0.25], [0.5, 0.5])
    """
    return _half_periods(frequency_rad_s, damping, [1.0, 1.0], "ZV")


def zvd(frequency_rad_s: float, damping: float) -> DelayFilter:
    """Return the shaper with zero vibration and zero derivative of it over frequency: three taps."""
    return _half_periods(frequency_rad_s, damping, [1.0, 2.0, 1.0], "ZVD")


def ei(frequency_rad_s: float, damping: float, vibration: float = TOLERATED_VIBRATION) -> DelayFilter:
    """Return the extra-insensitive shaper: it leaves `vibration` at the modelled frequency, none at two frequencies beside it."""
    return _half_periods(frequency_rad_s, damping, [0.25 * (1.0 + vibration), 0.5 * (1.0 - vibration), 0.25 * (1.0 + vibration)], "EI")


def two_hump_ei(frequency_rad_s: float, damping: float, vibration: float = TOLERATED_VIBRATION) -> DelayFilter:
    """Return the extra-insensitive shaper with two humps: four taps, one and a half times as long as EI."""
    v2 = vibration**2
    x = np.cbrt(v2 * (np.sqrt(1.0 - v2) + 1.0))
    first = (3.0 * x**2 + 2.0 * x + 3.0 * v2) / (16.0 * x)
    return _half_periods(frequency_rad_s, damping, [first, 0.5 - first, 0.5 - first, first], "2HEI")


def multi_mode(shaper: Callable[[float, float], DelayFilter], modes: Sequence[tuple[float, float]]) -> DelayFilter:
    """Return one shaper per mode (frequency [rad/s], damping ratio), in series."""
    if not modes:
        raise DesignError("a shaper needs at least one mode")
    joined = shaper(*modes[0])
    for mode in modes[1:]:
        joined = joined.then(shaper(*mode))
    return joined


def _half_periods(frequency_rad_s: float, damping: float, undamped: Sequence[float], name: str) -> DelayFilter:
    if not (frequency_rad_s > 0.0 and 0.0 <= damping < 1.0):
        raise DesignError(
            f"{name}: a mode at {frequency_rad_s:.4g} rad/s with damping {damping:.4g}: takes a positive frequency, damping 0 to below 1"
        )
    root = np.sqrt(1.0 - damping**2)
    decay = np.exp(-damping * np.pi / root)  # 1/A of (7.3)
    gains = np.asarray(undamped) * decay ** np.arange(len(undamped))
    return DelayFilter(np.arange(len(undamped)) * np.pi / (frequency_rad_s * root), gains / gains.sum(), None, name)
