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

from controllers.errors import DesignError
from controllers.shapers.dynamics import Dynamics

METHODS = ("dc", "zpetc", "zmetc")


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
    if period is None:
        mirrored = _polynomial(-unstable)
        numerator = mirrored if method == "zpetc" else np.ones(1)
        denominator = _polynomial(stable)
        ahead = 0.0
        if method == "zmetc":
            denominator = np.polymul(denominator, mirrored)
        if len(numerator) > len(denominator):
            raise DesignError(
                f"zpetc: {len(unstable)} zeros of the right half plane against {len(stable)} of the left would have to be differentiated; "
                "use zmetc or dc, or design at the sample rate"
            )
    else:
        # in powers of 1/z: N(z) = prod(1 - zero/z), mirrored prod(1/z - zero), which is prod(1 - zero z) as many samples late
        late = _polynomial(unstable)[::-1]
        numerator = late if method == "zpetc" else np.ones(1)
        denominator = _polynomial(stable)
        if method == "zmetc":
            denominator = np.polymul(denominator, late / late[0])
        width = max(len(numerator), len(denominator))
        numerator, denominator = (np.pad(part, (0, width - len(part))) for part in (numerator, denominator))
        ahead = len(unstable) * period if method == "zpetc" else 0.0
    if len(denominator) == 1:
        return None, 0.0
    tail = Dynamics.from_polynomials(numerator, denominator, period)
    return tail.scaled(1.0 / float(tail.response(0.0).real)), ahead


def invertible(dynamics: Dynamics) -> np.ndarray:
    """Return the zeros worth inverting: all of a continuous plant; of a sampled one those in the right half of the z plane.

    Sampling adds zeros near z = -1 whose inverse would ring at half the sample rate.
    """
    zeros = dynamics.zeros
    return zeros if dynamics.sample_period_s is None else zeros[zeros.real > 0.0]


def _polynomial(roots: np.ndarray) -> np.ndarray:
    """Return real coefficients, highest power first; 1 for no roots."""
    return np.atleast_1d(np.real(np.poly(roots)))
