"""The machine file's plant in the loop: linear about a pose, sampled, with a delay of one tick between command and effort."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.machine import Machine
from virtual_bus.physics import Physics


def sampled_response(machine: Machine, pose: np.ndarray, frequencies_Hz: np.ndarray, outputs: Sequence[str]) -> np.ndarray:
    """Return the frequency response from command k to the outputs of row k.

    The drives apply command k-1 at SYNC k and hold it to k+1, later where the file has a delay; see `virtual_bus.linear.sampled`.

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
    return Physics(machine.plant, noise=False).sampled(pose, outputs).response(frequencies_Hz)
