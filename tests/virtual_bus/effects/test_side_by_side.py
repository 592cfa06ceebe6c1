"""Several machines at a time: every one's answer is what it gives alone, whatever the others are."""

from __future__ import annotations

import gc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from effect_examples import EXAMPLES, ROWS, jog
from numba.core.dispatcher import Dispatcher
from places import CONCEALED_MACHINES

from hil.errors import BadAnswerError, BenchError
from hil.machine import load_machine
from hil.simulation import Inputs, Outputs, Simulator
from hil.simulation.smooth import smooth
from virtual_bus.errors import EmulatorError
from virtual_bus.plant.lanes import LANES
from virtual_bus.settings import EffectSetting

pytestmark = pytest.mark.slow


MACHINES = CONCEALED_MACHINES
CARM = smooth(load_machine("carm"))
SLIDE = load_machine("emps")
FRICTION = EffectSetting("coulomb_friction", "carriage", {"Fc": 20.0})
OTHERS = (
    EffectSetting("delay", "carriage", {"Td": 0.0013}),
    EffectSetting("supply_resistance", "carriage", {"sag": 0.05, "ke": 4.0}),
    EffectSetting("transmitted_load_friction", "carriage", {"Km": 0.1, "Kg": 0.05}),
    EffectSetting("clock_offset", "carriage", {"t0": 0.0027, "delta": 0.0}),
    EffectSetting("cogging", "carriage", {"Np": 100.0, "A1": 3.0, "phi1": 0.2, "A2": 1.0, "phi2": 0.0}),
    EffectSetting("end_stop", "carriage", {"K": 2e4, "D": 50.0, "at_position": 0.03, "side": 1.0}),
)
PASSIVE = (
    EffectSetting("coulomb_friction", "c_arc", {"Fc": 5.0}),
    EffectSetting("motor_load_friction", "c_arc", {"Km": 0.1}),
    EffectSetting("viscous_friction", "detector", {"Fv": 5.0}),
    EffectSetting("clock_offset", "roll", {"t0": 0.006, "delta": 0.0}),
)
"""At joints without a drive, behind springs, and at all encoders of an axis."""
UNSTABLE = EffectSetting("viscous_friction", "carriage", {"Fv": -1e6})
PARTS = ("command", "effort", "position", "link_position", "speed", "imu")


@pytest.fixture(scope="module")
def arm() -> Simulator:
    """Of two axes with an IMU: many sensors and joints, and half a minute to compile."""
    return Simulator(CARM)


@pytest.fixture(scope="module")
def jogged() -> Inputs:
    return jog(CARM.sample_rate_Hz)


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(smooth(SLIDE))


@pytest.fixture(scope="module")
def inputs() -> Inputs:
    """To and fro by some centimetres, with noise on the commands."""
    time_s = np.arange(ROWS) / SLIDE.sample_rate_Hz
    sweep, still = 0.02 * (1.0 - np.cos(2.0 * np.pi * 0.9 * time_s))[:, None], np.zeros((ROWS, 1))
    return Inputs(sweep, 0.1 * np.random.default_rng(4).standard_normal((ROWS, 1)), still, None, still[0])


def difference(one: object, other: Outputs) -> float:
    """The largest, over the channels, in shares of each one's range."""
    assert isinstance(one, Outputs), one
    found = [0.0]
    for name in PARTS:
        a, b = getattr(one, name), getattr(other, name)
        assert np.array_equal(np.isnan(a), np.isnan(b))
        if a.size and not np.isnan(b).all():
            found.append(float(np.nanmax(np.abs(a - b)) / max(float(np.nanmax(np.abs(b - b[0]))), 1e-9)))
    return max(found)


def drawn(simulator: Simulator, seed: int) -> np.ndarray:
    """Plant parameters within a hundredth of the nominal ones."""
    nominal = simulator.plant.nominal
    return nominal * (1.0 + 0.01 * np.random.default_rng(seed).uniform(-1.0, 1.0, len(nominal)))


def test_threads_change_nothing(simulator: Simulator, inputs: Inputs) -> None:
    trials = [(drawn(simulator, seed), ()) for seed in range(3 * LANES)]
    alone = simulator.run_all(inputs, trials)
    with ThreadPoolExecutor(4) as threads:
        together = [simulator.begin_all(inputs, trials, threads) for _ in range(2)]
        for ended in together:
            for one, other in zip(alone, ended(), strict=True):
                assert isinstance(one, Outputs)
                assert isinstance(other, Outputs)
                for values, others in zip(astuple(one), astuple(other), strict=True):
                    np.testing.assert_array_equal(values, others)


@pytest.mark.nightly
def test_every_effect_of_the_catalogue_does_beside_others_what_it_does_alone(arm: Simulator, jogged: Inputs) -> None:
    settings = (*EXAMPLES.values(), *PASSIVE)
    trials = [(drawn(arm, seed), (setting,)) for seed, setting in enumerate(settings)]
    together = arm.run_all(jogged, trials)
    for (values, effects), answer in zip(trials, together, strict=True):
        assert difference(answer, arm.run(jogged, values, effects)) < 1e-7, effects
    moved = [difference(answer, arm.run(jogged, values, ())) for (values, _), answer in zip(trials, together, strict=True)]
    assert min(moved) > 1e-6  # every one of them shows, and at its own place


@pytest.mark.nightly
def test_pairs_of_effects_too(arm: Simulator, jogged: Inputs) -> None:
    names = ("coulomb_friction", "presliding_hysteresis", "axis_coupling", "delay", "clock_offset", "structural_mode", "torque_ripple")
    trials = [(None, (EXAMPLES[one], EXAMPLES[other])) for one, other in pairwise(names)]
    for (_, effects), answer in zip(trials, arm.run_all(jogged, trials), strict=True):
        assert difference(answer, arm.run(jogged, None, effects)) < 1e-7, effects


def test_several_effects_do_beside_others_what_they_do_alone(simulator: Simulator, inputs: Inputs) -> None:
    trials = [(drawn(simulator, seed), (FRICTION, other)) for seed, other in enumerate(OTHERS)]
    for (values, effects), answer in zip(trials, simulator.run_all(inputs, trials), strict=True):
        assert difference(answer, simulator.run(inputs, values, effects)) < 1e-7, effects
        assert difference(answer, simulator.run(inputs, values, effects[:1])) > 1e-6  # it shows


def test_rows_that_may_not_be_written_to_need_no_machine_code_of_their_own(simulator: Simulator, inputs: Inputs) -> None:
    """As those of a recording are."""
    kept = {name: getattr(inputs, name).copy() for name in ("reference", "excitation", "feedforward")}
    for rows in kept.values():
        rows.flags.writeable = False
    codes = []
    for given in (inputs, replace(inputs, **kept)):
        simulator.run(given)
        simulator.run_all(given, [(None, ()), (None, ())])
        codes.append(sum(len(one.signatures) for one in gc.get_objects() if issubclass(type(one), Dispatcher)))
    assert codes[0] == codes[1]


def test_an_answer_does_not_depend_on_what_is_asked_beside_it(simulator: Simulator, inputs: Inputs) -> None:
    asked = (drawn(simulator, 1), (FRICTION,))
    others = [(drawn(simulator, seed), (other,)) for seed, other in enumerate(OTHERS, 2)]
    first, *_ = simulator.run_all(inputs, [asked, others[0]])
    *_, last = simulator.run_all(inputs, [*others, asked])
    assert isinstance(first, Outputs)
    assert isinstance(last, Outputs)
    for name in PARTS:
        np.testing.assert_array_equal(getattr(first, name), getattr(last, name))


@pytest.mark.parametrize("count", [1, 2, LANES, LANES + 1])
def test_as_many_answers_come_as_were_asked_for_in_their_order(simulator: Simulator, inputs: Inputs, count: int) -> None:
    trials = [(drawn(simulator, seed), ()) for seed in range(count)]
    for answer, trial in zip(simulator.run_all(inputs, trials), trials, strict=True):
        assert difference(answer, simulator.run(inputs, *trial)) < 1e-7


def test_one_that_diverges_says_when_and_leaves_the_others_alone(simulator: Simulator, inputs: Inputs) -> None:
    wild, still = simulator.run_all(inputs, [(None, (UNSTABLE,)), (None, ())])
    with pytest.raises(BadAnswerError) as alone:
        simulator.run(inputs, None, (UNSTABLE,))
    assert isinstance(wild, BadAnswerError)
    assert "diverged at 0.0" in str(wild)
    assert "diverged at 0.0" in str(alone.value)
    assert difference(still, simulator.run(inputs)) < 1e-7


@pytest.mark.nightly
def test_one_that_diverges_in_its_last_sample_is_found_out(arm: Simulator, jogged: Inputs) -> None:
    unstable = EffectSetting("viscous_friction", "roll", {"Fv": -1e7})
    parts = (jogged.reference, jogged.excitation, jogged.feedforward)
    first = replace(jogged, **dict(zip(("reference", "excitation", "feedforward"), (part[:1] for part in parts), strict=True)))
    with pytest.raises(BadAnswerError, match="in its last sample"):
        arm.run(first, None, (unstable,))
    wild, _ = arm.run_all(first, [(None, (unstable,)), (None, ())])
    assert isinstance(wild, BadAnswerError)
    assert "in its last sample" in str(wild)


def test_one_that_cannot_stand_says_so_in_its_place(simulator: Simulator, inputs: Inputs) -> None:
    load = (EffectSetting("constant_load", "carriage", {"tau0": 1e6}),)
    _, answer, _ = simulator.run_all(inputs, [(None, ()), (None, load), (None, ())])
    assert isinstance(answer, (BenchError, EmulatorError))
    with pytest.raises(type(answer)) as alone:
        simulator.run(inputs, None, load)
    assert str(alone.value) == str(answer)


def test_an_imu_without_low_pass_is_run_alone_and_the_same(jogged: Inputs) -> None:
    imus = tuple(replace(imu, accelerometer_bandwidth_Hz=0.0) for imu in CARM.plant.imus)
    simulator = Simulator(replace(CARM, plant=replace(CARM.plant, imus=imus)))
    for answer in simulator.run_all(jogged, [(None, ()), (None, ())]):
        assert difference(answer, simulator.run(jogged)) == 0.0


def test_lattices_and_targets_are_rounded_as_alone(inputs: Inputs) -> None:
    simulator, (encoder, *_) = Simulator(SLIDE), SLIDE.plant.encoders
    alone = simulator.run(inputs)
    assert encoder.resolution > 0.0
    for answer in simulator.run_all(inputs, [(None, ()), (None, ())]):
        assert isinstance(answer, Outputs)
        for one, other in ((answer.position, alone.position), (answer.effort, alone.effort)):
            is_other = np.abs(one - other) > 1e-6 * encoder.resolution  # unrounded, nearly all of them
            assert np.mean(is_other) < 0.01  # a rounding error that falls on a step's edge is a step


@pytest.mark.parametrize("name", ["spring_mass", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("slider", "tilted_arm"))])
def test_machines_that_slide_or_have_no_imu_too(name: str) -> None:
    machine = smooth(load_machine(str(MACHINES / f"{name}.toml")))
    simulator, axes = Simulator(machine), len(machine.axes)
    time_s = np.arange(ROWS) / machine.sample_rate_Hz
    sweep = np.tile(0.02 * (1.0 - np.cos(2.0 * np.pi * 0.9 * time_s))[:, None], (1, axes))
    excitation = 0.01 * np.random.default_rng(5).standard_normal((ROWS, axes))
    friction = EffectSetting("coulomb_friction", machine.axes[0], {"Fc": 0.2})
    command = None if machine.controllers else excitation
    given = Inputs(None if command is not None else sweep, excitation, np.zeros((ROWS, axes)), command, np.zeros(axes))
    for trial in ((None, ()), (None, (friction,)), (drawn(simulator, 3), (friction,))):
        one, _ = simulator.run_all(given, [trial, (None, ())])
        assert difference(one, simulator.run(given, *trial)) < 1e-7


@pytest.mark.parametrize(
    ("name", "largest"),
    [
        (MACHINES / "spring_mass.toml", 0.5),
        (MACHINES / "spring_mass.toml", 500.0),
        *(pytest.param(*each, marks=pytest.mark.nightly) for each in (("emps", 0.05), ("emps", 20.0), ("coupled_electric_drives", 0.5))),
    ],
)
def test_an_open_loop_that_begins_in_motion_too_saturated_or_without_encoders(name: Path | str, largest: float) -> None:
    machine = smooth(load_machine(name))
    simulator = Simulator(replace(machine, controllers=()))
    time_s = np.arange(ROWS) / machine.sample_rate_Hz
    still = np.zeros((ROWS, len(machine.axes)))
    command = still + largest * np.sin(2.0 * np.pi * 3.0 * time_s)[:, None]
    given = Inputs(None, still, still, command, still[0], start_speed=still[0] + 0.1)
    trials = [(None, ()), (drawn(simulator, 1), ())]
    for answer, trial in zip(simulator.run_all(given, trials), trials, strict=True):
        assert difference(answer, simulator.run(given, *trial)) < 1e-7
