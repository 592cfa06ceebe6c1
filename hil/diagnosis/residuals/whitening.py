"""Whitening: a Kalman filter along a known motion, through which readings and the columns of hypotheses pass alike.

The state is what the machine does beside that motion: deviations of the joints' positions and speeds, a disturbance on every joint
(first-order Gauss-Markov), and the IMUs' low passes. Its innovations are white with unit variance where the equations are right; a missing
term leaves in them what its column, filtered alike, has. Linearised Kalman filter: Anderson and Moore 1979, chapters 3 and 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.diagnosis.residuals.noise_spectrum import whitened_by
from hil.diagnosis.residuals.propagation import (
    exactly_compiled,
    inverse_root,
    propagated,
    quickly_compiled,
    times,
    times_transposed,
    transposed_times,
)

DETERMINED = 1e-12
"""Share of the largest pivot: a smaller one is rounding."""


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
    """Gains (N, s, m) and inverse roots (N, m, m) of the innovations' covariances; of a missing reading both are zero.

    `extra` (N, s) holds further variances of the state after each row, `jolts` (N, n) those of efforts that are others in every row; with
    one row where there are none. Innovations are divided by `loudness`
    (N, m), and pass the filters `colour` (m, p + 1) last; None where they are white.
    """

    linearised: Linearised
    gains: np.ndarray
    roots: np.ndarray
    extra: np.ndarray
    jolts: np.ndarray
    log_determinant: float
    readings: int
    colour: np.ndarray | None = None
    loudness: np.ndarray | None = None

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
        lin = self.linearised
        _columns(
            lin.stride, lin.transition, lin.of_effort, lin.of_rise, lin.observation, lin.through, self.gains, self.roots, efforts, ends,
            readings, first, state, out,
        )  # fmt: skip

    def scores(self, whitened: np.ndarray) -> np.ndarray:
        """Return by how much a unit of effort on each joint, at each row, agrees with whitened values (N, m): (N, n), the adjoint.

        The product of a whitened column with these values is that of its efforts with the scores.
        """
        back = whitened.copy()
        if self.colour is not None:
            lags = self.colour.shape[1]
            padded = np.vstack([back, np.zeros((lags - 1, back.shape[1]))])
            back = np.sum([self.colour[:, k] * padded[k : k + len(back)] for k in range(lags)], axis=0)
        if self.loudness is not None:
            back /= self.loudness
        lin = self.linearised
        out = np.zeros((len(back), lin.of_effort.shape[2]))
        _adjoint(lin.stride, lin.transition, lin.of_effort, lin.observation, lin.through, self.gains, self.roots, back, out)
        return out

    def coloured(self, out: np.ndarray) -> np.ndarray:
        """Return whitened columns (N m, C) of a whole recording without the colour of its noise; `out` is overwritten."""
        if self.loudness is not None:
            out /= self.loudness.reshape(-1, 1)
        if self.colour is not None:
            whitened_by(self.colour, out)
        return out


def whitening(linearised: Linearised, present: np.ndarray, extra: np.ndarray | None = None, jolts: np.ndarray | None = None) -> Whitening:
    """Run the filter's covariances along a motion.

    Parameters
    ----------
    linearised : Linearised
    present : (N, m) bool array
        Which readings there are.
    extra : (N, s) array, optional
        Further variances added to the state after each row.
    jolts : (N, n) array, optional
        Variances of efforts that act for a row each.
    """
    rows, channels = present.shape
    states = linearised.transition.shape[1]
    gains, roots = np.zeros((rows, states, channels)), np.zeros((rows, channels, channels))
    more = np.zeros((1, states)) if extra is None else extra
    shocks = np.zeros((1, linearised.of_effort.shape[2])) if jolts is None else jolts
    total = _covariances(
        linearised.stride, linearised.transition, linearised.of_effort, linearised.observation, linearised.noise, linearised.process,
        linearised.start, present, more, shocks, gains, roots,
    )  # fmt: skip
    return Whitening(linearised, gains, roots, more, shocks, float(total), int(present.sum()))


@exactly_compiled
def _covariances(
    stride: int, transition: np.ndarray, of_effort: np.ndarray, observation: np.ndarray, noise: np.ndarray, process: np.ndarray,
    start: np.ndarray, present: np.ndarray, extra: np.ndarray, jolts: np.ndarray, gains: np.ndarray, roots: np.ndarray,
) -> float:  # fmt: skip
    rows, channels = present.shape
    states = transition.shape[1]
    p, work = np.zeros((states, states)), np.zeros((states, states))
    ph, s, half = np.zeros((states, channels)), np.zeros((channels, channels)), np.zeros((states, channels))
    for i in range(states):
        p[i, i] = start[i]
    total = 0.0
    for k in range(rows):
        number = k // stride
        times_transposed(p, observation[number], ph)
        times(observation[number], ph, s)
        for c in range(channels):
            s[c, c] += noise[c]
        for c in range(channels):
            if not present[k, c]:
                s[c, :] = 0.0
                s[:, c] = 0.0
                s[c, c] = 1.0
                ph[:, c] = 0.0
        if not inverse_root(s, roots[k]):
            if channels > 1:
                raise np.linalg.LinAlgError("the covariance of what is read next is not positive definite")
            roots[k, 0, 0] = np.nan
        times_transposed(ph, roots[k], half)
        times(half, roots[k], gains[k])
        for c in range(channels):
            if present[k, c]:
                total -= 2.0 * np.log(roots[k, c, c])
            else:
                roots[k, c, c] = 0.0
        for i in range(states):
            for j in range(states):
                for c in range(channels):
                    p[i, j] -= gains[k, i, c] * ph[j, c]
        propagated(p, transition[number], of_effort[number], process, extra, jolts, k, work, p)
    return total


def smooth_states(
    filtered: Whitening, efforts: np.ndarray, ends: np.ndarray, readings: np.ndarray, present: np.ndarray, unsure: slice = slice(None)
) -> tuple[np.ndarray, np.ndarray]:
    """Return the smoothed states (N, s) of one column, and the standard deviations (N, u) of some of them.

    Modified Bryson-Frazier (Bierman 1973). Most of the work is in the deviations: `unsure` are the states whose ones are asked for.
    """
    lin = filtered.linearised
    rows, size = len(readings), lin.transition.shape[1]
    first, last, _ = unsure.indices(size)
    states, deviations = np.zeros((rows, size)), np.zeros((rows, last - first))
    _smoothed(
        lin.stride, lin.transition, lin.of_effort, lin.of_rise, lin.observation, lin.through, lin.noise, lin.process, lin.start,
        filtered.extra, filtered.jolts, filtered.gains, filtered.roots, efforts, ends, readings, present, first, states, deviations,
    )  # fmt: skip
    return states, deviations


@exactly_compiled
def _smoothed(
    stride: int, transition: np.ndarray, of_effort: np.ndarray, of_rise: np.ndarray, observation: np.ndarray, through: np.ndarray,
    noise: np.ndarray, process: np.ndarray, start: np.ndarray, extra: np.ndarray, jolts: np.ndarray, gains: np.ndarray, roots: np.ndarray,
    efforts: np.ndarray, ends: np.ndarray, readings: np.ndarray, present: np.ndarray, first: int, states: np.ndarray,
    deviations: np.ndarray,
) -> None:  # fmt: skip
    rows, channels = readings.shape
    size, unsure = transition.shape[1], deviations.shape[1]
    covariances = np.zeros((rows, size, size))
    innovations = np.zeros((rows, channels))
    p, work = np.zeros((size, size)), np.zeros((size, size))
    ph = np.zeros((size, channels))
    for i in range(size):
        p[i, i] = start[i]
    x, corrected = np.zeros(size), np.zeros(size)
    for k in range(rows):
        number = k // stride
        a, h = transition[number], observation[number]
        for i in range(size):
            states[k, i] = x[i]
            for j in range(size):
                covariances[k, i, j] = p[i, j]
        times_transposed(p, h, ph)
        for c in range(channels):
            value = readings[k, c]
            for j in range(size):
                value -= h[c, j] * x[j]
            for j in range(efforts.shape[1]):
                value -= through[number, c, j] * efforts[k, j]
            innovations[k, c] = value if present[k, c] else 0.0
        for i in range(size):
            corrected[i] = x[i]
            for c in range(channels):
                corrected[i] += gains[k, i, c] * innovations[k, c]
        for i in range(size):
            value = 0.0
            for j in range(size):
                value += a[i, j] * corrected[j]
            for j in range(efforts.shape[1]):
                value += of_effort[number, i, j] * efforts[k, j] + of_rise[number, i, j] * (ends[k, j] - efforts[k, j])
            x[i] = value
        for i in range(size):
            for j in range(size):
                for c in range(channels):
                    p[i, j] -= gains[k, i, c] * ph[j, c]
        propagated(p, a, of_effort[number], process, extra, jolts, k, work, p)
    adjoint, moved = np.zeros(size), np.zeros(size)
    weight, turned, back = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
    inverse, visible = np.zeros((channels, channels)), np.zeros((channels, size))
    for k in range(rows - 1, -1, -1):
        number = k // stride
        h = observation[number]
        times(roots[k].T, roots[k], inverse)
        times(inverse, h, visible)
        times(gains[k], h, back)
        for i in range(size):
            for j in range(size):
                back[i, j] = -back[i, j]
            back[i, i] += 1.0
        for i in range(size):
            value = 0.0
            for j in range(size):
                value += back[j, i] * adjoint[j]
            for c in range(channels):
                value -= visible[c, i] * innovations[k, c]
            moved[i] = value
        for i in range(size):
            adjoint[i] = moved[i]
        for i in range(size):
            for j in range(size):
                states[k, i] -= covariances[k, i, j] * adjoint[j]
        if unsure > 0:
            times(back.T, weight, turned)
            times(turned, back, weight)
            for i in range(size):
                for j in range(size):
                    for c in range(channels):
                        weight[i, j] += h[c, i] * visible[c, j]
            times(covariances[k, first : first + unsure], weight, turned[:unsure])
            for i in range(unsure):
                reduced = 0.0
                for j in range(size):
                    reduced += turned[i, j] * covariances[k, j, first + i]
                deviations[k, i] = np.sqrt(max(covariances[k, first + i, first + i] - reduced, 0.0))
        if k > 0:
            a = transition[(k - 1) // stride]
            for i in range(size):
                value = 0.0
                for j in range(size):
                    value += a[j, i] * adjoint[j]
                moved[i] = value
            for i in range(size):
                adjoint[i] = moved[i]
            if unsure > 0:
                times(a.T, weight, turned)
                times(turned, a, weight)


@quickly_compiled
def _adjoint(
    stride: int,
    transition: np.ndarray,
    of_effort: np.ndarray,
    observation: np.ndarray,
    through: np.ndarray,
    gains: np.ndarray,
    roots: np.ndarray,
    whitened: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write the efforts' gradients (N, n) of the product of whitened columns and `whitened` (N, m); efforts are held over a row."""
    states, channels, joints = transition.shape[1], whitened.shape[1], out.shape[1]
    later, carried, less = np.zeros((states, 1)), np.zeros((states, 1)), np.zeros((states, 1))
    visible, more, pushed, at_once = np.zeros((channels, 1)), np.zeros((channels, 1)), np.zeros((joints, 1)), np.zeros((joints, 1))
    seen = np.zeros((channels, 1))
    for k in range(len(whitened) - 1, -1, -1):
        number = k // stride
        transposed_times(transition[number], later, carried)
        for c in range(channels):
            seen[c, 0] = whitened[k, c]
        transposed_times(roots[k], seen, visible)
        transposed_times(gains[k], carried, more)
        for c in range(channels):
            visible[c, 0] += more[c, 0]
        transposed_times(of_effort[number], later, pushed)
        transposed_times(through[number], visible, at_once)
        for j in range(joints):
            out[k, j] = pushed[j, 0] - at_once[j, 0]
        transposed_times(observation[number], visible, less)
        for i in range(states):
            later[i, 0] = carried[i, 0] - less[i, 0]


@quickly_compiled
def _columns(
    stride: int, transition: np.ndarray, of_effort: np.ndarray, of_rise: np.ndarray, observation: np.ndarray, through: np.ndarray,
    gains: np.ndarray, roots: np.ndarray, efforts: np.ndarray, ends: np.ndarray, readings: np.ndarray, first: int, state: np.ndarray,
    out: np.ndarray,
) -> None:  # fmt: skip
    rows, channels, count = readings.shape
    states, joints = state.shape[0], efforts.shape[1]
    innovation, corrected = np.zeros((channels, count)), np.zeros((states, count))
    for r in range(rows):
        k = first + r
        number = k // stride
        for i in range(channels):
            for c in range(count):
                innovation[i, c] = readings[r, i, c]
            for j in range(states):
                weight = observation[number, i, j]
                if weight != 0.0:
                    for c in range(count):
                        innovation[i, c] -= weight * state[j, c]
            for j in range(joints):
                weight = through[number, i, j]
                if weight != 0.0:
                    for c in range(count):
                        innovation[i, c] -= weight * efforts[r, j, c]
        for i in range(channels):
            row = out[r * channels + i]
            row[:] = 0.0
            for j in range(channels):
                weight = roots[k, i, j]
                if weight != 0.0:
                    for c in range(count):
                        row[c] += weight * innovation[j, c]
        for i in range(states):
            for c in range(count):
                corrected[i, c] = state[i, c]
            for j in range(channels):
                weight = gains[k, i, j]
                if weight != 0.0:
                    for c in range(count):
                        corrected[i, c] += weight * innovation[j, c]
        for i in range(states):
            state[i, :] = 0.0
            for j in range(states):
                weight = transition[number, i, j]
                if weight != 0.0:
                    for c in range(count):
                        state[i, c] += weight * corrected[j, c]
            for j in range(joints):
                held, rising = of_effort[number, i, j], of_rise[number, i, j]
                if held != 0.0 or rising != 0.0:
                    for c in range(count):
                        state[i, c] += held * efforts[r, j, c] + rising * (ends[r, j, c] - efforts[r, j, c])
