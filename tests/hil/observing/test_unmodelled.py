"""Effects that a machine file states are counted in what its observer publishes; a file without them changes nothing."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from places import BENCHMARKS

from hil.machine import Machine, load_machine
from hil.observing import ObserverDesign, observe
from hil.observing.unmodelled import with_unmodelled

sys.path.insert(0, str(BENCHMARKS))
from observer_scan import shaken_scan
from observer_variances import NINE, nine, own_design, own_noise, scans


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("carm-real")


@pytest.fixture(scope="module")
def told(machine: Machine) -> ObserverDesign:
    return own_design(machine, (5, 9), told=True)


def test_a_file_without_effects_leaves_the_noise_as_it_is() -> None:
    carm = load_machine("carm")
    design = own_design(carm, (1, 1))
    assert with_unmodelled(design.noise, design.model, carm) is design.noise


def test_each_effect_enters_where_the_filter_has_a_state_for_it(machine: Machine, told: ObserverDesign) -> None:
    noise = told.noise
    dry = np.hypot([27.0, 45.0], [13.0, 22.0])  # sliding and break-away beside viscous 20 Nm s/rad at 0.5 rad/s and a cable of 10 Nm/rad
    np.testing.assert_allclose(noise.disturbance[:2], np.sqrt(dry**2 + 10.0**2 + 10.0**2 + 0.1**2), rtol=1e-6)
    identified = with_unmodelled(own_noise(machine, told.model), told.model, machine)  # its drives count in ampere: 47.5 Nm each
    np.testing.assert_allclose(identified.disturbance[:2], np.hypot(np.sqrt(dry**2 + 200.0) / 47.5, 0.1), rtol=1e-6)
    leak = 9.81 * np.hypot(np.sqrt((0.004**2 + 0.006**2 + 0.008**2) / 3.0), np.sqrt((0.003**2 + 0.002**2 + 0.001**2) / 3.0))
    np.testing.assert_allclose(noise.initial_bias[:3], leak, rtol=1e-2)
    apart = np.sqrt(3e-5**2 + 2e-5**2 + 5e-6**2 + 5e-5**2 + 1e-6**2 + 2e-6**2)  # play, teeth, both encoders
    np.testing.assert_allclose(noise.initial_offset[:2], apart, rtol=2e-2)
    assert noise.initial_offset.shape == (8,)
    assert (noise.initial_offset[2:5] == 0.0).all()
    assert np.hypot(*noise.initial_offset[5:7]) == pytest.approx(
        np.sqrt(2 * (5e-5**2 / 2) + (1e-4 * (1 - np.exp(-910 / 1800))) ** 2), rel=0.05
    )


@pytest.mark.slow
def test_what_is_stated_is_about_as_large_as_what_is_wrong(machine: Machine, told: ObserverDesign) -> None:
    scan = shaken_scan(machine, scans(machine)["roll 30 deg/s, shaken"][0], 3)
    truth = nine(scan.position, scan.rotation, scan.source, machine.geometry.isocenter_m)[256:]  # type: ignore[union-attr]

    def ratio(design: ObserverDesign) -> float:
        estimate = observe(scan.recording, design.observer("ukf"))
        found = np.column_stack([estimate[f"estimate_{name}"] for name in NINE[6:]])[256:]
        variance = np.column_stack([estimate[f"estimate_{name}_variance"] for name in NINE[6:]])[256:]
        return float(np.sqrt(variance.sum() / np.sum((found - truth[:, 6:]) ** 2)))

    assert 0.6 < ratio(told) < 1.6
    assert ratio(own_design(machine, (5, 9))) < 0.1
