"""Machines whose numbers, laws or controllers are not the file's, found by free runs: recordings by Euler steps that share nothing.

A mass and a friction alone are found for every change by the whole diagnosis (test_numbers.py, test_diagnose.py).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.diagnosis.likelihood.fitting import Fit
from hil.diagnosis.selection.select import Selected, select
from hil.machine import Machine
from hil.machine.load import machine_from_text
from hil.recording import Recording
from tests.hil.diagnosis.pushed_mass import RAIL, DAMPING_N_s_m, MASS_kg, recorded
from virtual_bus.settings import EffectSetting

COULOMB_N = 14.0
SECONDS = 20.0


def reference(seed: int) -> np.ndarray:
    time_s = np.arange(round(SECONDS * RAIL.sample_rate_Hz)) / RAIL.sample_rate_Hz
    phases = np.random.default_rng(seed).uniform(0.0, 6.3, 3)
    gate = 0.5 - 0.5 * np.cos(np.pi * np.clip(time_s / 0.5, 0.0, 1.0))
    return np.asarray(
        gate * sum(a * np.sin(2.0 * np.pi * f * time_s + p) for a, f, p in zip((0.12, 0.03, 0.01), (0.4, 1.3, 3.1), phases, strict=True))
    )


def with_mass(mass_kg: float) -> Machine:
    return machine_from_text(RAIL.text.replace("mass_kg = 20.0", f"mass_kg = {mass_kg}"), label="rail.toml")


def selected(machine: Machine, recording: Recording) -> Selected:
    found = select(machine, {"run": recording}, jobs=2)
    assert found is not None
    return found


def number(found: Selected, name: str, fit: Fit | None = None) -> float:
    fit = found.fit if fit is None else fit
    for unknown, at in zip(found.unknowns.each, fit.point.numbers, strict=True):
        if unknown.name == name:
            return unknown.value(float(at))
    raise KeyError(name)


def nothing(_time: float, _position: float, _speed: float) -> float:
    return 0.0


def rubs(_time: float, _position: float, speed: float) -> float:
    return -COULOMB_N * float(np.tanh(speed / 1e-3))


@pytest.mark.nightly
def test_a_mass_that_the_file_has_wrong_by_a_factor_is_found_by_windows_that_the_efforts_drive() -> None:
    machine = replace(with_mass(MASS_kg / 0.4), controllers=())
    found = selected(machine, recorded(reference(1), nothing, 5))
    assert number(found, "block.mass") == pytest.approx(MASS_kg, rel=0.02)
    assert found.fit.point.settings == ()


def test_a_controllers_gain_that_is_not_the_files_is_found_and_no_law_stands_for_it() -> None:
    found = selected(RAIL, recorded(reference(2), nothing, 6, gain=1.6, noise=10.0))
    assert number(found, "carriage.controller_gain") == pytest.approx(1.6, rel=0.03)
    assert number(found, "block.mass") == pytest.approx(MASS_kg, rel=0.05)
    assert found.fit.point.settings == ()


def test_a_command_that_acts_within_its_row_is_found() -> None:
    found = selected(RAIL, recorded(reference(4), nothing, 8, early=0.6, noise=10.0))
    assert number(found, "carriage.command_early") == pytest.approx(0.6, abs=0.05)
    assert number(found, "carriage.controller_gain") == pytest.approx(1.0, rel=0.02)
    assert found.fit.point.settings == ()


@pytest.mark.nightly
def test_a_damping_that_the_file_has_too_large_is_lowered_where_no_friction_can_stand_in_for_it() -> None:
    text = RAIL.text.replace(f"damping_N_s_m = {DAMPING_N_s_m}", f"damping_N_s_m = {1.3 * DAMPING_N_s_m}")
    found = selected(replace(machine_from_text(text, label="rail.toml"), controllers=()), recorded(reference(9), nothing, 10))
    fitting = found.search.fitting
    viscous = EffectSetting("viscous_friction", "carriage", {"Fv": 0.0})
    fit = fitting.fit(fitting.based(found.unknowns.start((viscous,))))
    assert fit is not None
    assert number(found, "carriage.damping", fit) == pytest.approx(DAMPING_N_s_m, rel=0.03)
    assert found.search.fitting.judge.jobs == 2


@pytest.mark.nightly
def test_a_friction_is_named_beside_a_mass_that_is_wrong() -> None:
    machine = replace(with_mass(MASS_kg / 2.0), controllers=())
    found = selected(machine, recorded(reference(3), rubs, 7))
    (friction,) = found.fit.point.settings
    assert (friction.name, friction.at) == ("coulomb_friction", "carriage")
    assert friction.parameters["Fc"] == pytest.approx(COULOMB_N, rel=0.03)
    assert number(found, "block.mass") == pytest.approx(MASS_kg, rel=0.03)
