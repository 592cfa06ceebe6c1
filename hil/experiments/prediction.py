"""Linearised closed loop at a pose: the response of command and position to a period of jog and excitation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.sections import response
from hil.errors import ExperimentError
from hil.machine import Machine
from hil.machine.closed_loop import position_loop
from virtual_bus.physics import Physics


@dataclass(frozen=True)
class Response:
    """A response in deviations from standstill, arrays (N, n_axes)."""

    command: np.ndarray
    position: np.ndarray
    speed: np.ndarray


class ClosedLoop:
    """The machine's linearisation under its controllers.

    Timing: `virtual_bus.linear.sampled`.

    Raises
    ------
    ExperimentError
        The closed loop is not stable at this pose.
    """

    def __init__(self, machine: Machine, physics: Physics, pose: np.ndarray) -> None:
        self._machine = machine
        loop = position_loop(machine, physics.linear(pose))
        if (radius := loop.pole_radius()) >= 1.0:
            raise ExperimentError(
                f"{machine.name}: the closed loop is not stable at {pose.round(4).tolist()} (largest pole radius {radius:.6f}); "
                "lower the controller's gain"
            )
        self._plant = loop.plant

    def steady(self, deviation: np.ndarray, excitation: np.ndarray) -> Response:
        """Return the response to one period of reference deviation and excitation, (N, n_axes) each.

        U = (I + C_y G)^-1 (W + C_r R), Y = G U at the excited lines.
        """
        samples, rate = len(deviation), self._machine.sample_rate_Hz
        r, w = np.fft.rfft(deviation, axis=0), np.fft.rfft(excitation, axis=0)
        size = np.abs(r).max(initial=0.0), np.abs(w).max(initial=0.0)
        present = (np.abs(r) > 1e-12 * size[0]).any(axis=1) | (np.abs(w) > 1e-12 * size[1]).any(axis=1)
        present[0] = False  # the mean is standstill
        lines = np.flatnonzero(present)
        frequencies = lines * rate / samples
        from_reference, from_position = self._controllers(frequencies)
        plant = self._plant.response(frequencies)
        loop = np.eye(len(self._machine.axes)) + from_position[:, :, None] * plant
        u = np.linalg.solve(loop, (w[lines] + from_reference * r[lines])[:, :, None])
        y = (plant @ u)[:, :, 0]
        return Response(
            command=self._in_time(u[:, :, 0], lines, samples),
            position=self._in_time(y, lines, samples),
            speed=self._in_time(y * (2j * np.pi * frequencies)[:, None], lines, samples),
        )

    def _controllers(self, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return C_r and C_y of every axis, (n_frequencies, n_axes)."""
        rate = self._machine.sample_rate_Hz
        from_position = [response(each.position_sections, frequencies, rate) for each in self._machine.controllers]
        from_reference = [
            own if each.reference_sections is None else response(each.reference_sections, frequencies, rate)
            for own, each in zip(from_position, self._machine.controllers, strict=True)
        ]
        return np.array(from_reference).T, np.array(from_position).T

    def _in_time(self, values: np.ndarray, lines: np.ndarray, samples: int) -> np.ndarray:
        spectrum = np.zeros((samples // 2 + 1, values.shape[1]), dtype=complex)
        spectrum[lines] = values
        return np.fft.irfft(spectrum, samples, axis=0)
