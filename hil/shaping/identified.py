"""Subjects of a shaper from identified data: a model with the loop closed around it, or a frequency response, closed and fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from controllers.errors import DesignError
from controllers.sections import response as sections_response
from controllers.shapers.dynamics import FORGOTTEN, Dynamics
from hil.identification.result import FrequencyResponse
from hil.machine import Machine
from hil.shaping.plants import loops_around, unit_gain
from hil.shaping.rational import fit
from hil.shaping.shaper_design import subject
from hil.shaping.verdict import Subject

if TYPE_CHECKING:
    import control

WORST_FIT = 0.1
"""Largest relative rms error of the fit with which its poles are used."""


def subject_from_frf(machine: Machine, frf: FrequencyResponse, axis: str, output: str = "link") -> tuple[Subject, float]:
    """Return the subject at the FRF's pose, and the relative rms error of the fit.

    Parameters
    ----------
    machine : its controller closes the loop.
    frf : from commands to at least the motor positions.
    axis, output : as in `hil.shaping.plants.closed_loop`; "detector" is not measured.

    Raises
    ------
    DesignError
        A command or position is not in the response, the sample rate differs, or no rational function fits.
    """
    if abs(frf.sample_rate_Hz / machine.sample_rate_Hz - 1.0) > 1e-6:
        raise DesignError(f"the frequency response is of {frf.sample_rate_Hz:g} Hz; {machine.name} runs at {machine.sample_rate_Hz:g} Hz")
    tracked = _measured(axis, output)
    needed = [*(f"position_{name}" for name in machine.axes), tracked]
    for names, there in (([f"command_{name}" for name in machine.axes], frf.input_names), (needed, frf.output_names)):
        for name in names:
            if name not in there:
                raise DesignError(f"the frequency response has no {name}; it has {', '.join(there)}")
    rung = [name for name in frf.output_names if name.startswith("imu_")]
    loop = _closed(machine, frf, axis)
    columns = [frf.output_names.index(name) for name in (tracked, *rung)]
    found = fit(loop[:, columns], frf.frequencies_Hz, frf.sample_rate_Hz)
    if found.error > WORST_FIT:
        raise DesignError(f"no rational function fits the closed loop: {found.error:.0%} off; identify with more lines or less noise")
    return _subject(found.systems), found.error


def subject_from_model(machine: Machine, plant: control.StateSpace, axis: str, output: str = "link") -> Subject:
    """Return the subject from an identified plant model at one pose (`ModalFrfModel.state_space`), the loop closed around it.

    Raises
    ------
    DesignError
        A command or position is not in the model, or the closed loop is not stable.
    """
    rung = [name for name in plant.output_labels if name.startswith("imu_")]
    return _subject(loops_around(machine, plant, axis, [_measured(axis, output), *rung]))


def _measured(axis: str, output: str) -> str:
    """Return the channel that shall track."""
    tracked = {"link": f"link_position_{axis}", "motor": f"position_{axis}"}.get(output)
    if tracked is None:
        raise DesignError(f"output {output!r}: what is identified has link or motor")
    return tracked


def _subject(systems: Sequence[Dynamics]) -> Subject:
    """Return the subject whose first path tracks; the accelerations after it show which modes ring."""
    path = unit_gain(systems[0])
    return subject(path, [_displacement(system) for system in systems[1:]] or [path])


def _closed(machine: Machine, frf: FrequencyResponse, axis: str) -> np.ndarray:
    """Return the response (L, n_y) from the reference of an axis to every output: G (I + C_y G_p)^-1 C_r e."""
    rate, lines = machine.sample_rate_Hz, frf.frequencies_Hz
    inputs = [frf.input_names.index(f"command_{name}") for name in machine.axes]
    positions = [frf.output_names.index(f"position_{name}") for name in machine.axes]
    plant = frf.G[:, :, inputs]
    c_y = np.array([sections_response(each.position_sections, lines, rate) for each in machine.controllers]).T
    own = machine.controllers[machine.axis_index(axis)]
    c_r = sections_response(own.position_sections if own.reference_sections is None else own.reference_sections, lines, rate)
    entering = np.zeros((len(lines), len(machine.axes)), dtype=complex)
    entering[:, machine.axis_index(axis)] = c_r
    difference = np.eye(len(machine.axes)) + c_y[:, :, None] * plant[:, positions]
    return (plant @ np.linalg.solve(difference, entering[:, :, None]))[:, :, 0]


def _displacement(acceleration: Dynamics) -> Dynamics:
    """Return the same modes weighted as displacements: each residue over its pole squared, comparable to paths of positions."""
    values, right = np.linalg.eig(acceleration.a)
    s = np.log(np.where(values == 0.0, 1.0, values).astype(complex)) / (acceleration.sample_period_s or 1.0)
    share = np.where(np.abs(values) > FORGOTTEN, 1.0 / np.where(values == 0.0, 1.0, s) ** 2, 0.0)
    c = (acceleration.c @ right * share) @ np.linalg.inv(right)
    return Dynamics(acceleration.a, acceleration.b, np.real(c), 0.0, acceleration.sample_period_s)
