"""Tail filters 1 / (N_s N_u*) for plants with zeros, (7.33), with three stable stand-ins for zeros that cannot be inverted, (7.34).

For a zero of the right half plane (outside the unit circle) the stand-in for 1/N_u is
    "dc"     1 / N_u(0)                  right at standstill only, (7.34)
    "zpetc"  N_u(-s) / N_u(0)^2          no phase error at any frequency
    "zmetc"  1 / N_u(-s)                 no magnitude error at any frequency
and (7.33) becomes (7.25) where there are no zeros. Beyond the transient L T the tail's own poles ring on unless the plant's zeros cancel
them: they do so exactly for N_s, and not for the mirrored zeros of "zmetc".
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.signal

from controllers.errors import DesignError
from controllers.shapers.delays import SETTLED
from controllers.shapers.dynamics import Dynamics

METHODS = ("dc", "zpetc", "zmetc")

FAR = 1e3
"""Modulus beyond which a zero of a sampled system stands for a delay of a sample."""


def tail_of(dynamics: Dynamics, method: str = "dc", zeros: Iterable[complex] | None = None) -> tuple[Dynamics | None, float]:
    """Return the tail filter of DC gain 1, and how much earlier its tap must stand [s] (samples that "zpetc" looks ahead).

    Parameters
    ----------
    dynamics : Dynamics
    method : "dc", "zpetc" or "zmetc"
    zeros : those to invert (s plane, or z plane of a sampled system); if not given, all that do not stem from sampling.

    Returns
    -------
    Dynamics or None, float
        None where there is nothing to invert.

    Raises
    ------
    DesignError
        A zero on the imaginary axis or unit circle, or an inverse with more zeros than poles.
    """
    if method not in METHODS:
        raise DesignError(f"inverse {method!r}: must be one of {', '.join(METHODS)}")
    chosen = np.array(list(invertible(dynamics) if zeros is None else zeros), dtype=complex)
    period = dynamics.sample_period_s
    if not chosen.size:
        return None, 0.0
    edge = chosen.real / np.maximum(np.abs(chosen), 1e-300) if period is None else np.abs(chosen) - 1.0
    if (np.abs(edge) < 1e-9).any():
        raise DesignError(f"zero at {chosen[np.argmin(np.abs(edge))]:.4g} on the edge of stability: its inverse never settles")
    stable, unstable = chosen[edge < 0.0], chosen[edge > 0.0]
    zeros, poles, ahead = list[complex](), list(stable), 0.0
    if period is None:
        zeros += list(-unstable) if method == "zpetc" else []
        poles += list(-unstable) if method == "zmetc" else []
        if len(zeros) > len(poles):
            raise DesignError(
                f"zpetc: {len(unstable)} zeros of the right half plane against {len(stable)} of the left would have to be differentiated; "
                "use zmetc or dc, or design at the sample rate"
            )
    else:
        # N(z) = prod(1 - zero/z); mirrored prod(1/z - zero), which is prod(1 - zero z) as many samples late
        zeros += [0.0] * len(stable)
        if method == "zpetc":
            zeros += list(1.0 / unstable)
            poles += [0.0] * len(unstable)
            ahead = len(unstable) * period
        elif method == "zmetc":
            zeros += [0.0] * len(unstable)
            poles += list(1.0 / unstable)
    if not any(poles) and not any(zeros):
        return None, 0.0
    tail = _cascade(np.array(zeros), np.array(poles), period)
    return tail.scaled(1.0 / float(tail.response(0.0).real)), ahead


def _cascade(zeros: np.ndarray, poles: np.ndarray, period: float | None) -> Dynamics:
    """Return a series of second-order sections: the coefficients of one polynomial lose zeros that lie close together."""
    sections = scipy.signal.zpk2sos(zeros, poles, 1.0, pairing="minimal" if period is None else "nearest", analog=period is None)
    series = Dynamics.from_polynomials([1.0], [1.0], period)
    for section in sections:
        numerator, denominator = section[:3], section[3:]
        while len(denominator) > 1 and numerator[-1] == 0.0 == denominator[-1]:  # a root at 0 in both
            numerator, denominator = numerator[:-1], denominator[:-1]
        series = Dynamics.from_polynomials(numerator, denominator, period).after(series)
    return series


def invertible(dynamics: Dynamics, within_s: float = np.inf) -> np.ndarray:
    """Return the zeros worth inverting: all of a continuous plant; of a sampled one those in the right half of the z plane.

    Sampling adds zeros near z = -1 whose inverse would ring at half the sample rate, and zeros far outside that are delays.

    Parameters
    ----------
    dynamics : Dynamics
    within_s : float
        Zeros whose inverse takes longer to settle to `SETTLED` are left out.
    """
    zeros = dynamics.zeros
    if dynamics.sample_period_s is None:
        rates = np.abs(zeros.real)
    else:
        size = np.abs(zeros)
        zeros, size = zeros[(zeros.real > 0.0) & (size < FAR)], size[(zeros.real > 0.0) & (size < FAR)]
        rates = np.abs(np.log(size)) / dynamics.sample_period_s
    quick: np.ndarray = zeros[rates * within_s >= -np.log(SETTLED)] if np.isfinite(within_s) else zeros
    return quick
