r"""Second-order sections at another sample rate: back to continuous time by the inverse bilinear (Tustin) map, and forth at the new rate.

With v = (z - 1) / (z + 1) the bilinear map at sample period T is s = k v, and on the unit circle v = j tan(w T / 2). The choice
k = w0 / tan(w0 T / 2), prewarping, makes it exact at w0. Out at the old period and in at the new one with the same w0, s drops out:

    v_old = rho v_new,    rho = tan(w0 T_old / 2) / tan(w0 T_new / 2),    T_old / T_new as w0 goes to 0

So a polynomial sum c_i v^i of a section becomes sum c_i rho^i v^i. A root v_i has its corner at w = 2 / T atan |v_i|. w0 is

- the own corner of a complex pair: a notch stays where it is, in frequency and in depth,
- the corner of the geometric mean |v| of all real roots of a section: a lead keeps its centre and its phase there,
- 0 for roots at v = 0, which is z = 1: static gains, integral gains per second and derivative gains stay.

v = infinity, which is z = -1, stays: it is the zero at infinity of a term that rolls off.
"""

from __future__ import annotations

import math

import numpy as np

from controllers.errors import DesignError
from controllers.sections import INTEGRATOR_TOLERANCE

AT_INFINITY = 1e-3
"""Share of half the sample rate that a zero may be below it and still be one at infinity: digits of a file split a double zero so far."""

DOUBLE = 1e-3
"""Angle off the real axis [rad] up to which a pair is one double real root: rounding splits it so far, and must not change its w0."""

# p(z) (1 - v)^n in powers of v, p highest power first; and c(v) (z + 1)^n in powers of z: both maps are the same matrix
_EXCHANGE = (np.array([[1.0]]), np.array([[1.0, 1.0], [1.0, -1.0]]), np.array([[1.0, 1.0, 1.0], [2.0, 0.0, -2.0], [1.0, -1.0, 1.0]]))


def rediscretised(sections: np.ndarray, old_rate_Hz: float, new_rate_Hz: float) -> np.ndarray:
    """Return a cascade (n, 6) at another sample rate; there and back gives the same sections.

    Parameters
    ----------
    sections : (n, 6) array
        Rows (b0, b1, b2, 1, a1, a2) at `old_rate_Hz`.
    old_rate_Hz, new_rate_Hz : float

    Raises
    ------
    DesignError
        A pole or zero at or beyond half of the new rate; it names the section, counted from 1, and the frequency.
    """
    if old_rate_Hz == new_rate_Hz:
        return np.array(sections, dtype=float)
    return np.array([_section(number, row, old_rate_Hz, new_rate_Hz) for number, row in enumerate(np.asarray(sections, dtype=float), 1)])


def rediscretised_share(share: float, old_rate_Hz: float, new_rate_Hz: float) -> float:
    """Return at another rate the share s of a first-order filter s / (1 - (1 - s) q) with q = 1 / z; 1, no filter, stays 1.

    Raises
    ------
    DesignError
        Its corner lies at or beyond a quarter of the new rate: no share above 0 and up to 1 has it there.
    """
    if share == 1.0:
        return share
    corner_Hz = _corner_Hz(share / (2.0 - share), old_rate_Hz)
    if corner_Hz >= new_rate_Hz / 4.0:
        raise DesignError(f"corner at {corner_Hz:.4g} Hz; at {new_rate_Hz:g} Hz it must lie below {new_rate_Hz / 4.0:g} Hz")
    root = math.tan(math.pi * corner_Hz / new_rate_Hz)
    return 2.0 * root / (1.0 + root)


def _section(number: int, row: np.ndarray, old_rate_Hz: float, new_rate_Hz: float) -> np.ndarray:
    order = 2
    while order and row[order] == 0.0 == row[3 + order]:  # a root at z = 0 of both is none
        order -= 1
    polynomials = [_in_v(row[: order + 1]), _in_v(row[3 : 4 + order])]
    roots = []
    for what, polynomial in zip(("zero", "pole"), polynomials, strict=True):
        found = _roots(polynomial)
        corners = _corner_Hz(np.abs(found), old_rate_Hz)
        infinite = corners >= (1.0 - AT_INFINITY) * old_rate_Hz / 2.0
        beyond = infinite | (corners >= new_rate_Hz / 2.0) if what == "pole" else ~infinite & (corners >= new_rate_Hz / 2.0)
        if beyond.any():
            below = min(old_rate_Hz, new_rate_Hz) / 2.0
            raise DesignError(
                f"section {number}: {what} at {corners[beyond].max():.4g} Hz; at {new_rate_Hz:g} Hz it must lie below {below:g} Hz"
            )
        roots.append(found[~infinite])
    real = np.concatenate([found[_is_real(found) & (found != 0.0)] for found in roots])
    mean = float(np.exp(np.log(np.abs(real)).mean())) if len(real) else 0.0
    carried = np.zeros((2, 3))
    for k, (polynomial, found) in enumerate(zip(polynomials, roots, strict=True)):
        at = mean if _is_real(found).all() else float(np.abs(found[0]))
        carried[k, : order + 1] = _EXCHANGE[order] @ _carried(polynomial, at, old_rate_Hz, new_rate_Hz)
    section: np.ndarray = carried.reshape(6) / carried[1, 0]
    if polynomials[1][0] == 0.0:  # exactly at z = 1: an integrator off by rounding would drift over a long run
        section[4], section[5] = (section[4], -1.0 - section[4]) if order == 2 else (-1.0, 0.0)
    section += 0.0  # no negative zeros
    return section


def _in_v(polynomial: np.ndarray) -> np.ndarray:
    """Return a polynomial of z, highest power first, as one of v, lowest power first; roots at v = 0 up to rounding are put there."""
    found: np.ndarray = _EXCHANGE[len(polynomial) - 1] @ polynomial
    small = np.abs(found) < INTEGRATOR_TOLERANCE * max(np.abs(polynomial).max(), 1e-300)
    found[np.logical_and.accumulate(small)] = 0.0
    return found


def _roots(polynomial: np.ndarray) -> np.ndarray:
    """Return as many roots as the order says, those at infinity included."""
    finite = np.roots(polynomial[::-1])
    return np.concatenate([finite, np.full(len(polynomial) - 1 - len(finite), np.inf)])


def _is_real(roots: np.ndarray) -> np.ndarray:
    found: np.ndarray = np.abs(roots.imag) <= DOUBLE * np.abs(roots)
    return found


def _carried(polynomial: np.ndarray, at: float, old_rate_Hz: float, new_rate_Hz: float) -> np.ndarray:
    """Return a polynomial of v at the new rate, prewarped at the corner of the root |v| = `at`; 0: not prewarped."""
    unwarped = new_rate_Hz / old_rate_Hz
    rho = at / math.tan(math.atan(at) * old_rate_Hz / new_rate_Hz) if at > 0.0 else unwarped
    at_one = int(np.argmax(polynomial != 0.0))  # roots at v = 0
    found: np.ndarray = polynomial * rho ** (np.arange(len(polynomial)) - float(at_one)) * unwarped**at_one
    return found


def _corner_Hz(size: np.ndarray | float, sample_rate_Hz: float) -> np.ndarray:
    return np.asarray(sample_rate_Hz / math.pi * np.arctan(size))
