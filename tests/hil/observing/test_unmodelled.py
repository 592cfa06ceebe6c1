"""Effects that a machine file states are counted in what its observer publishes; a file without them changes nothing."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest
from places import BENCHMARKS

from hil.machine import Machine, load_machine
from hil.observing import ObserverDesign, observe
from hil.observing.held_to_truth import held_to_truth
from hil.observing.true_scan import nine
from hil.observing.unmodelled import with_unmodelled, without_counted

sys.path.insert(0, str(BENCHMARKS))
from observer_scan import shaken_scan
from observer_variances import GROUPS, NINE, own_design, own_noise, scans

from hil.machine.drawn import drawn, typical

MACHINES = 10
QUIET = "roll 30 deg/s, quiet"
"""Of which the design of one command is judged, with what it states for the unscented filter; the others judge a design that is told of
shaking, on a coarser grid of poses."""


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("carm-real")


@pytest.fixture(scope="module")
def known(machine: Machine) -> Machine:
    """A machine whose sizes are those of its file, not a range."""
    effects = tuple(dataclasses.replace(effect, between={}) for effect in machine.own_effects)
    return dataclasses.replace(machine, plant=dataclasses.replace(machine.plant, effects=effects), own_effects=effects)


@pytest.fixture(scope="module")
def told(known: Machine) -> ObserverDesign:
    return own_design(known, (5, 9), told=True)


def test_a_file_without_effects_leaves_the_noise_as_it_is() -> None:
    carm = load_machine("carm")
    design = own_design(carm, (1, 1))
    assert with_unmodelled(design.noise, design.model, carm) is design.noise


def test_each_effect_enters_where_the_filter_has_a_state_for_it(known: Machine, told: ObserverDesign) -> None:
    noise = told.noise
    dry = np.hypot([27.0, 45.0], [13.0, 22.0])  # sliding and break-away beside viscous 20 Nm s/rad at 0.5 rad/s and a cable of 10 Nm/rad
    np.testing.assert_allclose(noise.disturbance[:2], np.sqrt(dry**2 + 200.0 + 0.1**2) / 47.5, rtol=1e-6)  # 47.5 Nm/A
    assert (noise.disturbance_time_s[:2] > 0.99).all(), "friction lasts a second where an axis does not turn"
    gain = noise.initial_gain.reshape(2, 7)
    np.testing.assert_allclose(gain[0, :3], np.sqrt((0.004**2 + 0.006**2 + 0.008**2) / 3.0), rtol=1e-9)
    np.testing.assert_allclose(gain[0, 3:], [np.sqrt((0.003**2 + 0.002**2 + 0.001**2) / 3.0)] * 3 + [0.002], rtol=1e-9)
    start = np.sqrt((0.02**2 + 0.015**2 + 0.01**2) / 3.0)
    np.testing.assert_allclose(noise.initial_bias[[0, 3]], [start, 2e-4], rtol=5e-2)
    apart = np.sqrt(
        3e-5**2 + 2e-5**2 + 5e-6**2 + 0.5 * 2e-6**2 + np.array([0.0, 1.2e-5]) ** 2
    )  # play, teeth, encoder; roll: the arc's heat
    np.testing.assert_allclose(noise.initial_offset[:2], apart, rtol=2e-2)
    np.testing.assert_allclose(noise.initial_offset[8:], np.sqrt(0.5 * (5e-5**2 + 1e-6**2)), rtol=1e-9)
    np.testing.assert_allclose(
        noise.initial_offset[2:8], [0.0, 0.0, 0.0, *(1e-4 * (1 - np.exp(-910 / 1800)) * np.array([0.4, 0.9165, 0.0]))], rtol=1e-3
    )


def test_where_the_file_gives_a_range_its_root_mean_square_counts(machine: Machine, told: ObserverDesign) -> None:
    ranged = with_unmodelled(own_noise(machine, told.model), told.model, machine)
    settled = with_unmodelled(own_noise(machine, told.model), told.model, typical(machine))
    np.testing.assert_array_equal(ranged.initial_offset, settled.initial_offset)
    np.testing.assert_allclose(ranged.initial_gain[0], np.sqrt((0.008**2 - 0.004**2) / (2.0 * np.log(2.0))), rtol=1e-9)


def test_what_is_counted_is_not_measured_and_what_is_not_counted_stays(machine: Machine) -> None:
    plain = without_counted(machine)
    assert [effect.name for effect in plain.plant.effects] == ["creep"]
    assert plain.own_effects == plain.plant.effects


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        QUIET,
        pytest.param("roll 30 deg/s, shaken", marks=pytest.mark.nightly),
        pytest.param("propeller 30 deg/s, reversed, quiet", marks=pytest.mark.nightly),
    ],
)
def test_over_machines_what_is_stated_is_what_is_wrong(machine: Machine, hard_design: ObserverDesign, name: str) -> None:
    plan, loudness = scans(machine)[name]
    known = hard_design
    if name != QUIET:
        known = own_design(typical(machine), (5, 9), told=True)
        if not loudness:  # its noise is that of a shaken machine
            factors = held_to_truth(machine, known.observer("ekf")).factors
            known = dataclasses.replace(known, noise=dataclasses.replace(known.noise, published=factors))
    blind = dataclasses.replace(known, noise=dataclasses.replace(known.noise, initial_gain=np.zeros(0)))
    errors = {"known": np.zeros((2, 3)), "blind": np.zeros((2, 3))}
    for number in range(MACHINES):
        scan = shaken_scan(drawn(machine, number, MACHINES), plan, number, loudness)
        truth = nine(scan.position, scan.rotation, scan.source, machine.geometry.isocenter_m)[256:]  # type: ignore[union-attr]
        for kind, design in (("known", known), ("blind", blind)):
            estimate = observe(scan.recording, design.observer("ekf"))
            found = np.column_stack([estimate[f"estimate_{channel}"] for channel in NINE])[256:] - truth
            found[:, 6:] = (found[:, 6:] + np.pi) % (2.0 * np.pi) - np.pi
            variance = np.column_stack([estimate[f"estimate_{channel}_variance"] for channel in NINE])[256:]
            errors[kind] += [[part[:, at].sum() for at in GROUPS.values()] for part in (found**2, variance)]
    true, stated = np.sqrt(errors["known"])
    assert ((stated / true > 0.7) & (stated / true < 1.5)).all()
    true, stated = np.sqrt(errors["blind"])
    assert (stated / true < 0.7).any(), "without the gains too little is stated"
