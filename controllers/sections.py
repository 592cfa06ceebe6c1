"""Second-order sections: one sample through a cascade or through all axes' controllers, frequency response, and state at standstill.

Rows are (b0, b1, b2, 1, a1, a2) as in `scipy.signal.sosfilt`; a state is that function's `zi`, direct form II transposed.
"""

from __future__ import annotations

import numpy as np
import scipy.signal
from numba import float64, int64, types

from controllers.compiled import kept_on_disk
from controllers.errors import DesignError

INTEGRATOR_TOLERANCE = 1e-9
"""A section integrates when |1 + a1 + a2| is below this: a pole nearer to z = 1 forgets in more than a month at 256 Hz."""

STEADY_TOLERANCE = 1e-9
"""Relative residual up to which a standstill state counts as solved."""

# Without an explicit setting, fast math would be inherited from the first compiled caller, and numba's cache would give every caller its
# roundings.
exactly_compiled = kept_on_disk(fastmath=False)


@exactly_compiled
def sections_step(sections: np.ndarray, state: np.ndarray, x: float) -> float:
    """Pass one sample through a cascade, bit for bit as `scipy.signal.sosfilt` does; callable from other compiled functions.

    Parameters
    ----------
    sections : (n, 6) array
    state : (n, 2) array
        Advanced in place.
    x : float
        Input of this sample.

    Returns
    -------
    float
        Output of this sample.
    """
    for i in range(sections.shape[0]):
        y = sections[i, 0] * x + state[i, 0]
        state[i, 0] = sections[i, 1] * x - sections[i, 4] * y + state[i, 1]
        state[i, 1] = sections[i, 2] * x - sections[i, 5] * y
        x = y
    return x


_READ = types.Array(float64, 1, "C", readonly=True)  # a plan's rows are read-only; writable arrays are accepted too

# One machine code for all arrays that come: compiling another in the middle of a motion would stop the commands for seconds.
FEEDBACK_STEP = int64(
    *(float64[:, ::1], float64[:, ::1], int64[:, ::1], float64[::1], float64[:, ::1], _READ, _READ, _READ, _READ, float64[::1])
)


@kept_on_disk(FEEDBACK_STEP, fastmath=False)
def feedback_step(
    sections: np.ndarray,
    state: np.ndarray,
    rows: np.ndarray,
    limit: np.ndarray,
    held: np.ndarray,
    reference: np.ndarray,
    position: np.ndarray,
    excitation: np.ndarray,
    feedforward: np.ndarray,
    out: np.ndarray,
) -> int:
    """Compute one sample of every axis, u = C_r r - C_y y + w + feedforward; callable from other compiled functions.

    See `controllers.feedback`.

    Parameters
    ----------
    sections, state : (n_sections, 6) and (n_sections, 2) arrays
        All axes' cascades one below the other; `state` is advanced in place.
    rows : (n_axes, 3) int array
        First row of C_r, first row of C_y, end of C_y. C_r of no rows means one filter on r - y.
    limit : (n_axes,) array
    held : (n_axes, 2) array
        Last output of the filters and last command, kept for missing values.
    reference, position, excitation, feedforward, out : (n_axes,) arrays

    Returns
    -------
    int
        Bit i set: axis i had a missing value.
    """
    missing = 0
    for axis in range(limit.shape[0]):
        r, y = reference[axis], position[axis]
        if np.isfinite(r) and np.isfinite(y):
            first, middle, end = rows[axis, 0], rows[axis, 1], rows[axis, 2]
            if first == middle:
                held[axis, 0] = sections_step(sections[middle:end], state[middle:end], r - y)
            else:
                from_reference = sections_step(sections[first:middle], state[first:middle], r)
                held[axis, 0] = from_reference - sections_step(sections[middle:end], state[middle:end], y)
        else:
            missing |= 1 << axis
        u = held[axis, 0] + excitation[axis] + feedforward[axis]
        if np.isfinite(u):
            held[axis, 1] = min(max(u, -limit[axis]), limit[axis])
        else:
            missing |= 1 << axis
        out[axis] = held[axis, 1]
    return missing


def response(sections: np.ndarray, frequencies_Hz: np.ndarray, sample_rate_Hz: float) -> np.ndarray:
    """Return the complex frequency response (n_frequencies,) of a cascade (n, 6)."""
    z = np.exp(-2j * np.pi * np.asarray(frequencies_Hz) / sample_rate_Hz)[:, None]
    b0, b1, b2, a0, a1, a2 = np.asarray(sections, dtype=float).T
    cascade: np.ndarray = np.prod((b0 + z * (b1 + z * b2)) / (a0 + z * (a1 + z * a2)), axis=1)
    return cascade


def integrates(sections: np.ndarray) -> np.ndarray:
    """Return which sections (n,) have a pole at z = 1."""
    found: np.ndarray = np.abs(1.0 + sections[:, 4] + sections[:, 5]) < INTEGRATOR_TOLERANCE
    return found


def preload_state(sections: np.ndarray, output: float) -> np.ndarray:
    """Return the state (n, 2) in which a cascade holds `output` for as long as its input is zero.

    The last integrating section holds it, and the sections behind pass it on with their static gain.

    Raises
    ------
    DesignError
        No section integrates, or one behind the integrator blocks constants, and `output` is not zero.
    """
    state = np.zeros((len(sections), 2))
    if output == 0.0:
        return state
    found = np.flatnonzero(integrates(sections))
    if not found.size:
        raise DesignError(f"nothing in the controller holds {output:.4g} at standstill: no integrator; add one, or gravity feedforward")
    holder = int(found[-1])
    numerators, denominators = sections[holder + 1 :, :3].sum(axis=1), 1.0 + sections[holder + 1 :, 4:].sum(axis=1)
    static_gain = float(np.prod(numerators / denominators))
    if static_gain == 0.0:
        raise DesignError(f"nothing in the controller holds {output:.4g} at standstill: a section behind the integrator blocks constants")
    held = output / static_gain
    for i in range(holder, len(sections)):
        b0, b1, b2, _, a1, a2 = sections[i]
        entering = 0.0 if i == holder else held
        leaving = held if i == holder else held * (b0 + b1 + b2) / (1.0 + a1 + a2)
        state[i] = leaving - b0 * entering, b2 * entering - a2 * leaving
        held = leaving
    return state


def standstill_states(
    reference_sections: np.ndarray, position_sections: np.ndarray, position: float, output: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return states of separate filters C_r, C_y in which C_r r - C_y y stays at `output` while r = y = `position`.

    Where both integrate, each of them ramps and the ramps cancel. The solution of least norm is taken.

    Raises
    ------
    DesignError
        No such state exists: the filters differ at standstill and neither has an integrator that could make up for it.
    """
    filters = [_state_space(sections) for sections in (reference_sections, position_sections)]
    transition = scipy.linalg.block_diag(filters[0][0], filters[1][0])
    entering = np.concatenate([filters[0][1], filters[1][1]]) * position
    leaving = np.concatenate([filters[0][2], -filters[1][2]])
    through = (filters[0][3] - filters[1][3]) * position
    n = len(entering)
    rest = transition - np.eye(n)
    # x_k = offset + k ramp, with  rest ramp = 0,  rest offset + entering = ramp,  leaving ramp = 0,  leaving offset + through = output
    zero_row, zero_block = np.zeros((1, n)), np.zeros((n, n))
    matrix = np.block([[rest, -np.eye(n)], [zero_block, rest], [zero_row, leaving[None, :]], [leaving[None, :], zero_row]])
    right = np.concatenate([-entering, np.zeros(n), [0.0], [output - through]])
    solution = np.linalg.lstsq(matrix, right, rcond=1e-13)[0]
    if np.abs(matrix @ solution - right).max(initial=0.0) > STEADY_TOLERANCE * max(np.abs(right).max(), 1e-12):
        raise DesignError(
            f"nothing in the controller holds {output:.4g} at standstill at position {position:.4g}: "
            "add an integrator to both reference and position sections, or gravity feedforward"
        )
    offset = solution[:n].reshape(-1, 2)
    return offset[: len(reference_sections)].copy(), offset[len(reference_sections) :].copy()


def _state_space(sections: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return transition (2n, 2n), input (2n,), output (2n,) and feedthrough of a cascade in the coordinates of its `zi`."""
    size = 2 * len(sections)
    transition, entering, leaving, through = np.zeros((size, size)), np.zeros(size), np.zeros(size), 1.0
    for i, (b0, b1, b2, _, a1, a2) in enumerate(sections):
        # this section's input is leaving . x + through * u, x the states of the sections before it
        own = slice(2 * i, 2 * i + 2)
        gain = np.array([b1 - a1 * b0, b2 - a2 * b0])
        transition[own] = np.outer(gain, leaving)
        transition[own, own] += np.array([[-a1, 1.0], [-a2, 0.0]])
        entering[own] = gain * through
        leaving, through = b0 * leaving, b0 * through
        leaving[2 * i] += 1.0
    return transition, entering, leaving, through
