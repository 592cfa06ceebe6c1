"""The machine file's plant in the loop: linear about a pose, sampled, with a delay of one tick between command and effort."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.signal

from hil.machine import Machine
from virtual_bus.physics import Physics


def sampled_response(machine: Machine, pose: np.ndarray, frequencies_Hz: np.ndarray, outputs: Sequence[str]) -> np.ndarray:
    """Return the frequency response from command k to the outputs of row k, without friction effects.

    The drives apply command k-1 at SYNC k and hold it to k+1: x_{k+1} = A x_k + B u_{k-1}, y_k = C x_k + D u_{k-1} with the zero-order
    hold's A and B (docs/explanation/notation.md), so G(z) = z^-1 (C (z I - A)^-1 B + D).

    Parameters
    ----------
    machine : Machine
    pose : (n_axes,) array
        Rest position [rad or m].
    frequencies_Hz : (L,) array
    outputs : sequence of str
        Channel names of encoders and IMU.

    Returns
    -------
    (L, n_outputs, n_axes) complex array
    """
    model = Physics(machine.plant, noise=False).linearise(pose)
    rows = [model.output_labels.index(name) for name in outputs]
    period_s = 1.0 / machine.sample_rate_Hz
    a, b, c, d, _ = scipy.signal.cont2discrete((model.A, model.B, model.C[rows], model.D[rows]), period_s)
    z = np.exp(2j * np.pi * np.asarray(frequencies_Hz) * period_s)[:, None, None]
    driven = np.broadcast_to(b.astype(complex), (len(z), *b.shape))
    response: np.ndarray = (c @ np.linalg.solve(z * np.eye(len(a)) - a, driven) + d) / z
    return response
