"""A linear plant as the sample loop meets it: from the command of one row to the readings of the next ones.

Command k acts from SYNC k + 1 on, its drive's delay d T + f T (d whole, 0 <= f < 1) later, and is held for a period T:

    x_(k+1) = e^(A T) x_k + N u_(k-d) + O u_(k-d-1),   u_k = command_(k-1),
    N = int_0^((1-f) T) e^(A s) B ds,   O = int_(0)^(T) e^(A s) B ds - N.

What passes to a reading at once is the target on which the drive acts at the SYNC: u_(k-d), and u_(k-d-1) where f > 0. A reading that is
old is a cubic through the samples about its age, as the emulated sensors read it (`virtual_bus/sensors/effects.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg

from virtual_bus.effects.table import WHOLE
from virtual_bus.linear.left_out import LeftOut
from virtual_bus.linear.plant import LinearPlant


@dataclass(frozen=True, eq=False)
class SampledPlant:
    """x_(k+1) = a x_k + b command_k, y_k = c x_k.

    Attributes
    ----------
    a, b, c : arrays (N, N), (N, axes), (k, N)
        The first states are those of the continuous plant; the others are commands and readings that wait.
    input_labels, output_labels : as of `LinearPlant`
    period_s : float
    poles : (m,) complex array
        Of the motion, continuous [rad/s].
    late_s : float
        Longest time [s] from a command to a reading that no state of the plant stands for.
    left_out : effects of the machine that are not in it
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    input_labels: tuple[str, ...]
    output_labels: tuple[str, ...]
    period_s: float
    poles: np.ndarray
    late_s: float
    left_out: tuple[LeftOut, ...] = ()

    def rows(self, outputs: Sequence[str]) -> np.ndarray:
        """Return the rows (k, N) of c of these outputs."""
        return self.c[[self.output_labels.index(name) for name in outputs]]

    def response(self, frequencies_Hz: np.ndarray, outputs: Sequence[str] | None = None) -> np.ndarray:
        """Return the response (L, k, axes) from commands to these outputs, all by default: c (z I - a)^-1 b."""
        z = np.exp(2j * np.pi * np.asarray(frequencies_Hz, dtype=float) * self.period_s)[:, None, None]
        c = self.c if outputs is None else self.rows(outputs)
        driven = np.broadcast_to(self.b.astype(complex), (len(z), *self.b.shape))
        found: np.ndarray = c @ np.linalg.solve(z * np.eye(len(self.a)) - self.a, driven)
        return found


def sampled(plant: LinearPlant, period_s: float, outputs: Sequence[str]) -> SampledPlant:
    """Return a plant as the loop meets it, with these outputs. What no output shows (an IMU's low pass) is not in it."""
    rows = [plant.output_labels.index(name) for name in outputs]
    seen = _seen(plant.A, plant.C[rows])
    a, b, c, d = plant.A[np.ix_(seen, seen)], plant.B[seen], plant.C[rows][:, seen], plant.D[rows]
    n, axes = b.shape
    whole, part = _whole_and_part(plant.delay_s / period_s)
    held = whole + 1 + (part > 0.0)  # commands of each axis that act or wait
    ages = plant.age_s[rows] / period_s
    weights = [_weights(age) for age in ages]
    waiting = np.array([len(each) - 1 for each in weights])
    first = np.concatenate(([n], n + np.cumsum([*held, *waiting])))
    total = int(first[-1])
    step, entering, now = np.zeros((total, total)), np.zeros((total, axes)), np.zeros((len(rows), total))
    transition, whole_period = _held(a, b, period_s)
    step[:n, :n], now[:, :n] = transition, c
    for axis in range(axes):
        newest = first[axis]
        entering[newest, axis] = 1.0
        for older in range(newest, first[axis + 1] - 1):
            step[older + 1, older] = 1.0
        acting, share = newest + whole[axis], part[axis]
        new = whole_period[:, axis] if share == 0.0 else _held(a, b[:, [axis]], (1.0 - share) * period_s)[1][:, 0]
        step[:n, acting] += new
        now[:, acting + (share > 0.0)] += d[:, axis]
        if share > 0.0:
            step[:n, acting + 1] += whole_period[:, axis] - new
    read = np.zeros_like(now)
    for number, each in enumerate(weights):
        last = first[axes + number]
        read[number] = each[0] * now[number]
        read[number, last : last + len(each) - 1] = each[1:]
        if len(each) > 1:
            step[last] = now[number]
            for newer, older in pairwise(range(last, last + len(each) - 1)):
                step[older, newer] = 1.0
    return SampledPlant(
        step, entering, read, plant.input_labels, tuple(outputs), period_s, plant.poles,
        period_s + float(plant.delay_s.max(initial=0.0) + plant.age_s[rows].max(initial=0.0)), plant.left_out,
    )  # fmt: skip


def _seen(a: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return the numbers of the states on which an output depends, now or later."""
    seen = (c != 0.0).any(axis=0)
    while True:
        further = seen | (a[seen] != 0.0).any(axis=0)
        if (further == seen).all():
            return np.flatnonzero(seen)
        seen = further


def _whole_and_part(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    whole = np.floor(samples + WHOLE).astype(np.int64)
    part = samples - whole
    return whole, np.where(part < WHOLE, 0.0, part)


def _held(a: np.ndarray, b: np.ndarray, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return e^(A t) and the integral of e^(A s) B over 0 to t (Van Loan 1978)."""
    n, axes = b.shape
    after = scipy.linalg.expm(np.block([[a, b], [np.zeros((axes, n + axes))]]) * time_s)
    return after[:n, :n], after[:n, n:]


def _weights(age: float) -> np.ndarray:
    """Return the weights of a channel's samples, the latest first, in a reading of this age in samples: Lagrange's of a cubic."""
    if age <= 0.0:
        return np.ones(1)
    first = max(int(age) - 1, 0)
    x = age - first
    weights = np.zeros(first + 4)
    weights[first:] = (
        -(x - 1.0) * (x - 2.0) * (x - 3.0) / 6.0,
        x * (x - 2.0) * (x - 3.0) / 2.0,
        -x * (x - 1.0) * (x - 3.0) / 2.0,
        x * (x - 1.0) * (x - 2.0) / 6.0,
    )
    return weights
