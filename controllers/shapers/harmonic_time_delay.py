"""Harmonic time-delay filters (hTDF) for any order and any set of forcing frequencies, by the linear method of Sec. 7.2.3.

With L = N_p + 2 N_w - 1, one tap more than (7.26), the delay T is free and the gains solve linear equations.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.conditions import Condition, cancelling, check_apart, solve, tracking
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics

UNIT_GAIN = 1e-9
"""Largest |H(0) - 1| of a filter for a reference with a mean: with more, a move would end somewhere else."""


def harmonic_conditions(
    dynamics: Dynamics,
    forcing_rad_s: Iterable[float],
    cancelled: Iterable[complex] | None = None,
    *,
    robust_poles: Iterable[complex] = (),
    robust_forcing_rad_s: Iterable[float] = (),
) -> list[Condition]:
    """Make the conditions of Design Requirement 1, with slopes where asked for.

    Parameters
    ----------
    dynamics : Dynamics
    forcing_rad_s : frequencies that are tracked without error; 0 is the mean of the reference.
    cancelled : poles that are cancelled, conjugates once or twice; all of them unless given, none for the second variant of Sec. 7.3.2.
    robust_poles : those of them to whose change the filter shall be insensitive, (7.35).
    robust_forcing_rad_s : forcing frequencies to whose change it shall be insensitive, (7.36); 0: a ramp is followed without lag.

    Raises
    ------
    DesignError
        The plant is not stable, a forcing frequency lies on a pole or is listed twice, or a robust one is not listed.
    """
    dynamics.check_stable()
    forcing, flat = [float(frequency) for frequency in forcing_rad_s], [float(frequency) for frequency in robust_forcing_rad_s]
    poles = [complex(pole) for pole in (dynamics.poles if cancelled is None else cancelled)]
    desensitised = [complex(pole) for pole in robust_poles]
    if any(frequency < 0.0 or not np.isfinite(frequency) for frequency in forcing) or len(set(forcing)) < len(forcing):
        raise DesignError(f"forcing frequencies must be different and not negative, are {forcing} rad/s")
    if not set(flat) <= set(forcing):
        raise DesignError(f"robust forcing frequencies {sorted(set(flat) - set(forcing))} rad/s are not among {forcing}")
    check_apart(poles, forcing)
    conditions = cancelling(poles) + tracking(dynamics, forcing)
    conditions += [condition for condition in cancelling(desensitised, True) if condition.order == 1]
    return conditions + [condition for condition in tracking(dynamics, flat, True) if condition.order == 1]


def harmonic(
    conditions: Sequence[Condition], delay_s: float, *, tail: Dynamics | None = None, ahead_s: float = 0.0, extra_taps: int = 0
) -> DelayFilter:
    """Return the filter with taps at k T, as many as there are equations, or more with the least sum of squares.

    Parameters
    ----------
    conditions : from `harmonic_conditions`.
    delay_s : T.
    tail : on the last tap, from `controllers.shapers.zero_inversion`.
    ahead_s : by how much the tail's tap stands earlier, from there, too.
    extra_taps : beyond the number of equations.

    Raises
    ------
    DesignError
        No solution at this delay, or a delay that the tail's tap would pass.

    Examples
    --------
    References at 0 and 3 rad/s are tracked without error: filter times plant is one there.

    >>> import numpy as np
    >>> from controllers.shapers.dynamics import Dynamics
    >>> from controllers.shapers.harmonic_time_delay import harmonic, harmonic_conditions
    >>> plant = Dynamics.from_polynomials([100.0], [1.0, 1.0, 100.0])
    >>> shaper = harmonic(harmonic_conditions(plant, [0.0, 3.0]), 0.2)
    >>> s = np.array([0.0, 3.0j])
    >>> bool(np.allclose(shaper.response(s) * 100.0 / (s**2 + s + 100.0), 1.0))
    True
    """
    if not (np.isfinite(delay_s) and delay_s > 0.0):
        raise DesignError(f"delay T = {delay_s}: must be positive")
    if ahead_s >= delay_s:
        raise DesignError(f"delay T = {delay_s:g} s: must be longer than the {ahead_s:g} s by which the tail looks ahead")
    delays_s = delay_s * np.arange(tap_count(conditions) + extra_taps)
    delays_s[-1] -= ahead_s
    return solve(conditions, delays_s, tail, "hTDF")


def tap_count(conditions: Sequence[Condition]) -> int:
    """Return the number of taps that meet the conditions for any delay: one per real equation."""
    return sum(condition.equations for condition in conditions)


def check_static_gain(dynamics: Dynamics, shaper: DelayFilter) -> None:
    """Refuse a filter for references with a mean or a ramp unless H(0) = 1.

    Raises
    ------
    DesignError
        H(0) is not 1; the message says where a move would end.
    """
    through = complex(dynamics.response(0.0) * shaper.response(0.0)).real
    if abs(through - 1.0) > UNIT_GAIN:
        raise DesignError(
            f"{shaper.name or 'this filter'} passes a mean with H(0) = {through:.6g}, so a move of 1 would end at {through:.4g}; "
            "a reference with a mean or a ramp needs the forcing frequency 0 among the conditions"
        )
