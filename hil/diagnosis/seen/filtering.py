"""Whitening: a Kalman filter along a known motion, through which readings and the columns of hypotheses pass alike.

The state is what the machine does beside that motion: deviations of the joints' positions and speeds, a disturbance on every joint
(first-order Gauss-Markov), and the IMUs' low passes. Its innovations are white with unit variance where the equations are right; a missing
term leaves in them what its column, filtered alike, has. Linearised Kalman filter: Anderson and Moore 1979, chapters 3 and 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

DETERMINED = 1e-12
"""Share of the largest pivot: a smaller one is rounding."""
TAYLOR = 12
"""Order of the matrix exponential's series, after halving until the step is below one half: its error is 0.5^13/13! = 2e-14."""


@dataclass(frozen=True)
class Linearised:
    """The machine along a motion of N rows, with n joints, m channels and s states; `stride` rows share one linearisation.

    Attributes
    ----------
    transition : (L, s, s) array
    of_effort, of_rise : (L, s, n) arrays
        What an effort held over a row does to the next row's state, and one that rises from zero to one over the row.
    observation : (L, m, s) array
        What the channels see of the state.
    through : (L, m, n) array
        What they see of an effort at once.
    noise : (m,) array
        Variances of the channels.
    process : (s,) array
        Variances added to the state in one row.
    start : (s,) array
        Variances at row 0.
    """

    stride: int
    transition: np.ndarray
    of_effort: np.ndarray
    of_rise: np.ndarray
    observation: np.ndarray
    through: np.ndarray
    noise: np.ndarray
    process: np.ndarray
    start: np.ndarray


@dataclass(frozen=True)
class Whitening:
    """Gains (N, s, m) and inverse roots (N, m, m) of the innovations' covariances; of a missing reading both are zero."""

    along: Linearised
    gains: np.ndarray
    roots: np.ndarray
    log_determinant: float
    readings: int

    def columns(self, efforts: np.ndarray, ends: np.ndarray, readings: np.ndarray, first: int, state: np.ndarray, out: np.ndarray) -> None:
        """Pass columns through the filter from row `first` on.

        Parameters
        ----------
        efforts, ends : (R, n, C) arrays
            Generalised efforts of C columns at each row, and just before the next; linear between.
        readings : (R, m, C) array
            What they add to the readings themselves.
        first : int
            Row of the recording that they begin in.
        state : (s, C) array
            Of the filter; zero at row 0. Overwritten with that of row first + R.
        out : (R m, C) array
            Whitened columns.
        """
        lin = self.along
        _columns(
            lin.stride, lin.transition, lin.of_effort, lin.of_rise, lin.observation, lin.through, self.gains, self.roots, efforts, ends,
            readings, first, state, out,
        )  # fmt: skip


def whitening(along: Linearised, present: np.ndarray, extra: np.ndarray | None = None) -> Whitening:
    """Run the filter's covariances along a motion.

    Parameters
    ----------
    along : Linearised
    present : (N, m) bool array
        Which readings there are.
    extra : (N, s) array, optional
        Further variances added to the state after each row.
    """
    rows, channels = present.shape
    states = along.transition.shape[1]
    gains, roots = np.zeros((rows, states, channels)), np.zeros((rows, channels, channels))
    more = np.zeros((1, states)) if extra is None else extra
    total = _covariances(
        along.stride, along.transition, along.observation, along.noise, along.process, along.start, present, more, gains, roots
    )
    return Whitening(along, gains, roots, float(total), int(present.sum()))


@numba.njit(cache=True, fastmath=False)
def _covariances(stride, transition, observation, noise, process, start, present, extra, gains, roots):  # type: ignore[no-untyped-def]
    rows, channels = present.shape
    states = transition.shape[1]
    p = np.zeros((states, states))
    for i in range(states):
        p[i, i] = start[i]
    total = 0.0
    for k in range(rows):
        number = k // stride
        a, h = transition[number], observation[number]
        ph = np.dot(p, h.T.copy())
        s = np.dot(h, ph)
        for c in range(channels):
            s[c, c] += noise[c]
        for c in range(channels):
            if not present[k, c]:
                for d in range(channels):
                    s[c, d] = 0.0
                    s[d, c] = 0.0
                s[c, c] = 1.0
                for i in range(states):
                    ph[i, c] = 0.0
        root = np.linalg.inv(np.linalg.cholesky(s))
        gain = np.dot(np.dot(ph, root.T.copy()), root)
        for c in range(channels):
            if present[k, c]:
                total -= 2.0 * np.log(root[c, c])
            else:
                root[c, c] = 0.0
        roots[k] = root
        gains[k] = gain
        p = p - np.dot(gain, ph.T.copy())
        p = np.dot(np.dot(a, p), a.T.copy())
        p = 0.5 * (p + p.T)
        for i in range(states):
            p[i, i] += process[i]
        if len(extra) > 1:
            for i in range(states):
                p[i, i] += extra[k, i]
    return total


def smooth_states(
    filtered: Whitening, efforts: np.ndarray, ends: np.ndarray, readings: np.ndarray, present: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the smoothed states (N, s) of one column and their standard deviations (modified Bryson-Frazier; Bierman 1973)."""
    lin = filtered.along
    rows, size = len(readings), lin.transition.shape[1]
    states, deviations = np.zeros((rows, size)), np.zeros((rows, size))
    _smoothed(
        lin.stride, lin.transition, lin.of_effort, lin.of_rise, lin.observation, lin.through, lin.noise, lin.process, lin.start,
        filtered.gains, filtered.roots, efforts, ends, readings, present, states, deviations,
    )  # fmt: skip
    return states, deviations


@numba.njit(cache=True, fastmath=False)
def _smoothed(  # type: ignore[no-untyped-def]
    stride, transition, of_effort, of_rise, observation, through, noise, process, start, gains, roots, efforts, ends, readings, present,
    states, deviations,
):  # fmt: skip
    rows, channels = readings.shape
    size = transition.shape[1]
    covariances = np.zeros((rows, size, size))
    innovations = np.zeros((rows, channels))
    p = np.zeros((size, size))
    for i in range(size):
        p[i, i] = start[i]
    x = np.zeros(size)
    for k in range(rows):
        number = k // stride
        a, h = transition[number], observation[number]
        covariances[k] = p
        states[k] = x
        v = readings[k] - np.dot(h, x) - np.dot(through[number], efforts[k])
        for c in range(channels):
            if not present[k, c]:
                v[c] = 0.0
        innovations[k] = v
        x = np.dot(a, x + np.dot(gains[k], v)) + np.dot(of_effort[number], efforts[k]) + np.dot(of_rise[number], ends[k] - efforts[k])
        p = p - np.dot(gains[k], np.dot(h, p))
        p = np.dot(np.dot(a, p), a.T.copy())
        p = 0.5 * (p + p.T)
        for i in range(size):
            p[i, i] += process[i]
    adjoint = np.zeros(size)
    weight = np.zeros((size, size))
    for k in range(rows - 1, -1, -1):
        number = k // stride
        h = observation[number]
        inverse = np.dot(roots[k].T.copy(), roots[k])
        back = np.eye(size) - np.dot(gains[k], h)
        adjoint = np.dot(back.T.copy(), adjoint) - np.dot(h.T.copy(), np.dot(inverse, innovations[k]))
        weight = np.dot(np.dot(back.T.copy(), weight), back) + np.dot(np.dot(h.T.copy(), inverse), h)
        states[k] = states[k] - np.dot(covariances[k], adjoint)
        reduced = np.dot(np.dot(covariances[k], weight), covariances[k])
        for i in range(size):
            deviations[k, i] = np.sqrt(max(covariances[k, i, i] - reduced[i, i], 0.0))
        if k > 0:
            a = transition[(k - 1) // stride]
            adjoint = np.dot(a.T.copy(), adjoint)
            weight = np.dot(np.dot(a.T.copy(), weight), a)


@numba.njit(cache=True, fastmath=False, nogil=True)
def _columns(stride, transition, of_effort, of_rise, observation, through, gains, roots, efforts, ends, readings, first, state, out):  # type: ignore[no-untyped-def]
    rows, channels, count = readings.shape
    states = state.shape[0]
    seen = np.zeros((channels, count))
    for r in range(rows):
        k = first + r
        number = k // stride
        np.dot(observation[number], state, seen)
        innovation = readings[r] - seen
        innovation -= np.dot(through[number], efforts[r])
        np.dot(roots[k], innovation, out[r * channels : (r + 1) * channels])
        corrected = state + np.dot(gains[k], innovation)
        moved = np.dot(transition[number], corrected)
        moved += np.dot(of_effort[number], efforts[r])
        moved += np.dot(of_rise[number], ends[r] - efforts[r])
        for i in range(states):
            for c in range(count):
                state[i, c] = moved[i, c]


@numba.njit(cache=True, fastmath=False)
def discretised(period, inverses, stiffnesses, dampings, felt, through, corners, transition, of_effort, of_rise):  # type: ignore[no-untyped-def]
    """Write what a period does to positions, speeds and low passes, and what efforts do that are held or rise over it.

    `felt` (L, i, 2n) and `through` (L, i, n) are what IMU channels feel of positions and speeds, and of efforts; `corners` (i,) are their
    low passes' [rad/s]. The state is (positions, speeds, efforts as they stand, low passes): transition (L, 3n + i, 3n + i), with efforts
    that stay; of_effort and of_rise (L, 3n + i, n), without.
    """
    count, n, _ = inverses.shape
    imus = len(corners)
    size = 4 * n + imus
    f = np.zeros((size, size))
    low, rise = 3 * n, 3 * n + imus
    for k in range(count):
        f[:] = 0.0
        for i in range(n):
            f[i, n + i] = period
            f[2 * n + i, rise + i] = 1.0
        f[n : 2 * n, :n] = -period * np.dot(inverses[k], stiffnesses[k])
        f[n : 2 * n, n : 2 * n] = -period * np.dot(inverses[k], dampings[k])
        f[n : 2 * n, 2 * n : 3 * n] = period * inverses[k]
        for c in range(imus):
            pull = period * corners[c]
            f[low + c, low + c] = -pull
            f[low + c, : 2 * n] = pull * felt[k, c]
            f[low + c, 2 * n : 3 * n] = pull * through[k, c]
        norm = 1.0
        for i in range(n):
            norm = max(norm, abs(f[n + i, n + i]) + np.sqrt(abs(f[n + i, i]) * period))
        for c in range(imus):
            norm = max(norm, period * corners[c])
        halvings = 0
        while norm > 0.5 and halvings < 30:
            norm *= 0.5
            halvings += 1
        term = np.eye(size)
        total = np.eye(size)
        small = f / 2.0**halvings
        for order in range(1, TAYLOR + 1):
            term = np.dot(term, small) / order
            total += term
        for _ in range(halvings):
            total = np.dot(total, total)
        transition[k] = total[:rise, :rise]
        of_effort[k] = total[:rise, 2 * n : 3 * n]
        of_rise[k] = total[:rise, rise:]
        for i in range(n):
            of_effort[k, 2 * n : 3 * n, i] = 0.0
            of_rise[k, 2 * n : 3 * n, i] = 0.0
