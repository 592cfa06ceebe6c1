"""Fits move parameters of light machines and orders over long ways; loads act on loops that have no integrator."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.optimize
import scipy.signal

from hil.diagnosis.fitting.coordinates import Coordinates
from hil.diagnosis.fitting.refit import Fitted, are_costly, bounded, polish, refit, sensitivities_to_effects
from hil.diagnosis.fitting.screening import screen
from hil.diagnosis.fitting.visited import Visited
from hil.diagnosis.judging.form import lost_form
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching import from_nominal
from hil.diagnosis.searching.bounded_noise import candidates_for
from hil.diagnosis.searching.harmonics import with_other_harmonics
from hil.diagnosis.searching.same_order import with_others_of_its_order
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import retune
from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata
from hil.simulation import simulate
from virtual_bus.effects.nonlinear_stiffness import effort
from virtual_bus.settings import EffectSetting

pytestmark = pytest.mark.nightly

EMPS = load_machine("emps")
SILVERBOX = load_machine("silverbox")
ROTOR = load_machine("laas_anti_cogging")


def driven(machine, command, **initial) -> Recording:
    units = machine.units[0]
    channels = {
        "time": Channel("s", np.arange(len(command)) / machine.sample_rate_Hz),
        f"command_{units.axis}": Channel(units.effort, command),
    }
    return Recording(channels, recording_metadata(machine, initial=initial))


def recorded(machine, inputs: Recording, *hidden: EffectSetting, finer: int = 1) -> Recording:
    """By plant steps so many times finer than the machine file's: a recording knows of none."""
    answer = simulate(replace(machine, plant=replace(machine.plant, substeps=finer * machine.plant.substeps)), inputs, hidden)
    return Recording({**inputs.channels, **answer.channels}, inputs.metadata)


def test_a_load_displaces_a_loop_without_an_integrator_by_load_over_its_stiffness():
    rows = 2000
    time = Channel("s", np.arange(rows) / EMPS.sample_rate_Hz)
    held = {"time": time, "reference_carriage": Channel("m", np.full(rows, 0.1)), "excitation_carriage": Channel("V", np.zeros(rows))}
    load = EffectSetting("constant_load", "carriage", {"tau0": 30.0})
    position = simulate(EMPS, Recording(held, {}), (load,))["position_carriage"]
    assert position[-1] - 0.1 == pytest.approx(30.0 / (35.15065 * 38995.821), abs=6e-8)


def test_a_fit_finds_the_cubic_spring_of_a_milligramme():
    """Only its ratio to the drive's constant shows: mass, springs and constant scaled alike move in the same way. How the spring bends does
    not: the fit may end with any bend and corner that cost less than a unit of noise. Plant steps as coarse as usual err by more, to fourth
    order.
    """
    command = 0.1 * np.random.default_rng(1).standard_normal(3000)
    hidden = EffectSetting("nonlinear_stiffness", "oscillator", {"k3": 4.0, "bend": 0.0, "corner": 0.0})
    recording = recorded(SILVERBOX, driven(SILVERBOX, command), hidden, finer=16)
    with FreeRuns({TRAIN: (found := mismatch(SILVERBOX, {"noise": recording}))}, found.noise) as runs:
        runs.refine(4)
        tuning = retune(runs)
        runs.correct(Trial(runs.nominal, (hidden,)))  # the error of the plant's steps, as it is near the end of a search
        tuning = replace(tuning, predicted=runs.run_one(Trial(tuning.values)))
        start = ((EffectAt("nonlinear_stiffness", "oscillator"),), (np.array([1.0, 1.0, 0.0]),))
        (fit,) = refit(runs, tuning, runs.measured(), [start])
        (fit,) = polish(runs, tuning, runs.measured(), polish(runs, tuning, runs.measured(), [fit]))
    constant = tuning.at(fit.offset)[[p.quantity for p in tuning.parameters].index("constant")]
    farthest = float(np.abs(recording["position_mass"]).max())
    force = effort(SimpleNamespace(deflection=farthest), *fit.values[0])
    assert fit.cost < 1.0
    assert force / constant == pytest.approx(-4.0 * farthest**3, rel=0.03)


def test_sensitivities_are_per_unit_where_a_fit_ends_that_ran_out_of_steps():
    """A load does twice as much where it is twice as large: its sensitivity is the same wherever it was taken."""
    load = EffectAt("constant_load", "mass")
    command = 0.1 * np.random.default_rng(1).standard_normal(3000)
    found = mismatch(
        SILVERBOX, {"noise": recorded(SILVERBOX, driven(SILVERBOX, command), EffectSetting("constant_load", "mass", {"tau0": 0.05}))}
    )
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        tuning = retune(runs)
        far = Fitted((load,), (np.array([1e-3]),), tuning.offset, tuning.predicted, np.inf, ((0, 0),), np.zeros((1, 1)), np.zeros(1))
        (fit,) = polish(runs, tuning, runs.measured(), [far], rounds=1)
        taken = sensitivities_to_effects(runs, tuning, fit, TRAIN)
    assert 0.004 < fit.values[0][0] < 0.02  # its steps ran out on the way
    assert np.linalg.norm(fit.jacobian - taken) < 0.05 * np.linalg.norm(taken)


def test_a_fit_starts_from_the_strength_that_the_recordings_want():
    command = 0.1 * np.random.default_rng(1).standard_normal(3000)
    recording = recorded(
        SILVERBOX, driven(SILVERBOX, command), EffectSetting("nonlinear_stiffness", "oscillator", {"k3": 4.0, "bend": 0.0, "corner": 0.0})
    )
    weak = Candidate(EffectAt("nonlinear_stiffness", "oscillator"), (np.array([0.004, 1.0, 0.0]),))
    with FreeRuns({TRAIN: (found := mismatch(SILVERBOX, {"noise": recording}))}, found.noise) as runs:
        tuning = retune(runs)
        (start,) = screen(runs, tuning, [weak], runs.measured() - tuning.predicted)
    assert start.values[0] == pytest.approx(4.0, rel=0.6)


def noisy_repeats(hidden: EffectSetting, noise_m: float, rows: int = 3000) -> dict[str, Recording]:
    """Four of one slow motion of the oscillator."""
    low_pass = scipy.signal.butter(2, 5.0, fs=SILVERBOX.sample_rate_Hz)
    command = scipy.signal.lfilter(*low_pass, np.random.default_rng(1).standard_normal(rows))
    inputs = driven(SILVERBOX, 0.1 * command / command.std())
    answer = simulate(SILVERBOX, inputs, (hidden,))
    metadata, repeats = recording_metadata(SILVERBOX, experiment={"start_pose": [0.0]}), {}
    for number in range(4):
        noise = noise_m * np.random.default_rng(100 + number).standard_normal(rows)
        measured = {"position_mass": Channel("m", answer["position_mass"] + noise)}
        repeats[str(number)] = Recording({**inputs.channels, **answer.channels, **measured}, metadata)
    return repeats


@pytest.mark.parametrize("start", [0.0025, 0.04])
def test_a_gap_keeps_one_where_recordings_do_not_show_how_wide_its_flanks_are(start):
    """Flanks of a tenth of the gap, a thousandth of the motion. Unbounded, they are fitted 21 and 27 gaps wide, for a gain of 1.5: a spring
    that hardens by a twentieth of its stiffness.
    """
    hidden = EffectSetting("backlash", "oscillator", {"b": 1e-4, "flank": 1e-5})
    repeats = noisy_repeats(hidden, noise_m=1e-3)
    with FreeRuns({TRAIN: (found := mismatch(SILVERBOX, repeats))}, found.noise) as runs:
        tuning, measured, own = retune(runs), runs.measured(), EffectAt("backlash", "oscillator")
        (fit,) = refit(runs, tuning, runs.measured(), [((own,), (np.array([start, start]),))])
        (fit,) = polish(runs, tuning, runs.measured(), [fit])
        without = float(np.sum((runs.measured() - tuning.predicted) ** 2) + tuning.offset @ tuning.offset)
        perfect = float(np.sum((runs.measured() - runs.run_one(Trial(runs.nominal, (hidden,)))) ** 2))
    b, flank = fit.values[0]
    assert flank <= 9.0 * b * (1.0 + 1e-12) and b == pytest.approx(1e-4, rel=0.3)
    assert fit.cost < perfect < without - 100.0
    assert lost_form(fit, {}, measured - fit.predicted) == ""


def test_a_spring_that_hardens_is_no_gap():
    """Flanks of thirty gaps leave it 0.97 of its stiffness. Held at nine, a fit ends at 1.4 times the noise and wants more."""
    own, hidden = EffectAt("backlash", "oscillator"), EffectSetting("backlash", "oscillator", {"b": 1e-3, "flank": 3e-2})
    repeats = noisy_repeats(hidden, noise_m=1e-3)
    with FreeRuns({TRAIN: (found := mismatch(SILVERBOX, repeats))}, found.noise) as runs:
        tuning, measured = retune(runs), runs.measured()
        (fit,) = refit(runs, tuning, measured, [((own,), (np.array([0.0025, 0.0025]),))])
        (fit,) = polish(runs, tuning, measured, [fit])
    assert "flank" in lost_form(fit, {}, measured - fit.predicted)


def test_no_point_of_a_fit_has_flanks_wider_than_they_may_be():
    own, start = EffectAt("backlash", "oscillator"), np.array([1e-5, 2e-3])
    tuning = SimpleNamespace(offset=np.zeros(0), at=lambda offset: offset)
    fitting = Coordinates(tuning, (own,), (start,), Visited(1.0))
    at = fitting.point(np.zeros(0), (start,))
    assert at.values[0] == pytest.approx([1e-5, 9e-5])
    low, high = fitting.reach(at, 1.0)
    assert (low <= 0.0).all() and (high >= 0.0).all()
    up, down, apart = fitting.around(at, np.array([0.01, 0.01]))[1]
    assert up.values[0][1] == pytest.approx(9e-5) and down.values[0][1] == pytest.approx(9e-5 - apart) and apart > 0.0


def test_fits_whose_numbers_were_bent_without_their_effects_start_from_nominal_again(monkeypatch):
    """A sensor without its sign: re-tuning follows what it says. A rival of nearly the same answer was bent alike, one that gains half as
    much is no rival, and another law is not what those numbers wait for.
    """
    monkeypatch.setattr(from_nominal, "are_costly", lambda tuning: True)
    hidden = EffectSetting("rectified_sensor", "position_mass", {"share": 1.0, "sign": 1.0})
    repeats, own = noisy_repeats(hidden, noise_m=1e-3), EffectAt("rectified_sensor", "position_mass")
    with FreeRuns({TRAIN: (found := mismatch(SILVERBOX, repeats))}, found.noise) as runs:
        tuning, measured = retune(runs), runs.measured()
        (fit,) = refit(runs, tuning, measured, [((own,), (np.array([1.0, 1.0]),))])
        bent = runs.run_one(Trial(tuning.values, (hidden,)))
        stuck = replace(fit, offset=tuning.offset, predicted=bent, cost=float(np.sum((measured - bent) ** 2)))
        base = 20.0 * stuck.cost
        rival = replace(stuck, values=(np.array([0.98, 1.0]),), cost=1.01 * stuck.cost)
        far = replace(stuck, cost=10.0 * stuck.cost)
        other = replace(rival, effects=(EffectAt("viscous_friction", "mass"),), values=(np.array([0.0]),), cost=1.02 * stuck.cost)
        assert runs.run_one(Trial(runs.nominal, other.settings)) is not None
        again, after, *rest = from_nominal.with_numbers_from_nominal(runs, tuning, measured, [other, far, rival, stuck], base)
        asked = runs.count
        (same,) = from_nominal.with_numbers_from_nominal(runs, tuning, measured, [again], base)
        assert same is again and runs.count == asked
    assert again.cost < 1.1 * len(measured) < 2.0 * len(measured) < stuck.cost
    assert after.effects == rival.effects and after.cost == pytest.approx(again.cost, rel=0.01)
    assert rest == [other, far]


def test_a_fit_asks_for_no_free_run_twice(monkeypatch):
    """A friction fitted to a hardening spring takes steps that bring less than expected."""
    command = 0.1 * np.random.default_rng(1).standard_normal(1500)
    recording = recorded(
        SILVERBOX, driven(SILVERBOX, command), EffectSetting("nonlinear_stiffness", "oscillator", {"k3": 40.0, "bend": 0.0, "corner": 0.0})
    )
    with FreeRuns({TRAIN: (found := mismatch(SILVERBOX, {"noise": recording}))}, found.noise) as runs:
        tuning, asked, begin = retune(runs), [], runs.begin

        def counted(trials, name=TRAIN):
            asked.extend((trial.values.tobytes(), trial.effects[0].parameters["Fv2"]) for trial in trials)
            return begin(trials, name)

        monkeypatch.setattr(runs, "begin", counted)
        refit(runs, tuning, runs.measured(), [((EffectAt("quadratic_friction", "mass"),), (np.array([1e-3]),))])
    assert len(asked) == len(set(asked)) > 10


def pieces(count=24, *others: EffectSetting, **cogging) -> dict[str, Recording]:
    """Pieces of 20 ms of a rotor with this cogging, at various places and speeds."""
    hidden = EffectSetting("cogging", "rotor", cogging)
    random = np.random.default_rng(3)
    found = {}
    for number in range(count):
        inputs = driven(ROTOR, np.full(20, 0.2), speeds=[float(random.uniform(4.0, 8.0))])
        start = {"position_rotor": Channel("rad", np.full(20, random.uniform(0.0, 30.0)))}
        found[str(number)] = recorded(ROTOR, Recording({**inputs.channels, **start}, inputs.metadata), hidden, *others)
    return found


def wave(order: float, amplitude: float, phase: float) -> EffectSetting:
    """A cogging of one order."""
    return EffectSetting("cogging", "rotor", {"Np": order, "A1": amplitude, "phi1": phase, "A2": 0.0, "phi2": 0.0})


def test_coggings_of_several_orders_at_one_place_add_up():
    """One law of two harmonics is two laws of one each."""
    both = {"Np": 36.0, "A1": 0.04, "phi1": -0.9, "A2": 0.1, "phi2": 0.4}
    inputs = driven(ROTOR, np.full(50, 0.2), speeds=[5.0])
    whole = recorded(ROTOR, inputs, EffectSetting("cogging", "rotor", both))["position_rotor"]
    apart = recorded(ROTOR, inputs, wave(36.0, 0.04, -0.9), wave(72.0, 0.1, 0.4))["position_rotor"]
    np.testing.assert_allclose(apart, whole, atol=1e-12)
    assert np.abs(whole - recorded(ROTOR, inputs, wave(36.0, 0.04, -0.9))["position_rotor"]).max() > 1e-3


@pytest.mark.slow
def test_a_cogging_of_another_order_is_found_beside_the_first():
    recordings = pieces(24, wave(96.0, 0.04, -1.1), Np=72.0, A1=0.1, phi1=0.4, A2=0.0, phi2=0.0)
    first, second = EffectAt("cogging", "rotor"), EffectAt("cogging", "rotor", 2)
    with FreeRuns({TRAIN: (found := mismatch(ROTOR, recordings))}, found.noise) as runs:
        tuning = retune(runs)
        candidates = candidates_for(runs, tuning)
        (one,) = refit(runs, tuning, runs.measured(), [((first,), (np.array([72.0, 0.1, 0.4, 0.0, 0.0]),))])
        offered = {candidate.effect: candidate for candidate in candidates(one)}
        assert first not in offered and {effect for effect in offered if effect.number > 1} == {second}
        nearest = min(offered[second].starts, key=lambda start: abs(start[0] - 96.0))
        assert nearest[0] == pytest.approx(96.0, abs=0.5)
        (two,) = polish(runs, tuning, runs.measured(), refit(runs, tuning, runs.measured(), [((first, second), (one.values[0], nearest))]))
        assert {effect.number for effect in (c.effect for c in candidates(two)) if effect.effect == "cogging"} == {3}
    orders = [values[0] for values in two.values]
    amplitudes = [values[1] for values in two.values]
    assert (*orders, *amplitudes) == pytest.approx((72.0, 96.0, 0.1, 0.04), rel=0.05)


def test_a_frequency_is_fitted_to_a_part_of_a_cycle_over_the_record():
    """It starts a fifth of a cycle off at the end; a hundredth of the frequency would be two cycles."""
    command = 0.1 * np.random.default_rng(3).standard_normal(6000)
    time_s = len(command) / SILVERBOX.sample_rate_Hz
    shaken = EffectSetting("base_motion", "mass", {"A": 2e-3, "f": 20.0, "phi": 0.3})
    recording = recorded(SILVERBOX, driven(SILVERBOX, command), shaken)
    start = np.array([1.5e-3, 20.0 + 0.2 / time_s, 0.0])
    with FreeRuns({TRAIN: (found := mismatch(SILVERBOX, {"1": recording}))}, found.noise) as runs:
        tuning = retune(runs)
        (fit,) = refit(runs, tuning, runs.measured(), [((EffectAt("base_motion", "mass"),), (start,))])
    assert fit.values[0][1] == pytest.approx(20.0, abs=0.01 / time_s)


@pytest.mark.slow
def test_an_order_is_guessed_from_pieces_together_and_fitted_to_a_thousandth():
    recordings = pieces(Np=72.0, A1=0.1, phi1=0.4, A2=0.0, phi2=0.0)
    with FreeRuns({TRAIN: (found := mismatch(ROTOR, recordings))}, found.noise) as runs:
        tuning = retune(runs)
        guessed = next(c for c in candidates_for(runs, tuning)(None) if c.effect.effect == "cogging")
        nearest = min(guessed.starts, key=lambda start: abs(start[0] - 72.0))
        assert nearest[0] == pytest.approx(72.0, abs=0.1)
        (fit,) = refit(runs, tuning, runs.measured(), [((guessed.effect,), (nearest,))])
    assert fit.values[0][0] == pytest.approx(72.0, abs=0.07)
    assert fit.values[0][1] == pytest.approx(0.1, rel=0.1)


@pytest.mark.slow
def test_a_law_whose_second_harmonic_is_larger_is_found_from_twice_its_order():
    recordings = pieces(8, Np=36.0, A1=0.04, phi1=-0.9, A2=0.1, phi2=0.4)
    with FreeRuns({TRAIN: (found := mismatch(ROTOR, recordings))}, found.noise) as runs:
        tuning = retune(runs)
        start = ((EffectAt("cogging", "rotor"),), (np.array([72.0, 0.1, 0.4, 0.0, 0.0]),))
        (fit,) = with_other_harmonics(runs, tuning, runs.measured(), refit(runs, tuning, runs.measured(), [start]))
    order, a1, _, a2, _ = fit.values[0]
    assert (order, a1, a2) == pytest.approx((36.0, 0.04, 0.1), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "start",
    [
        np.array([36.0, 0.005, 0.4, 0.1, 0.4]),  # from half the order, what it leaves has the first harmonic's name
        np.array([72.0, 0.1, 0.4, 0.0, 2.0 - np.pi]),  # at its own order, from the wrong phase
    ],
)
def test_a_law_is_not_left_at_half_its_order_nor_without_its_second_harmonic(start):
    recordings = pieces(8, Np=72.0, A1=0.1, phi1=0.4, A2=0.02, phi2=2.0)
    with FreeRuns({TRAIN: (found := mismatch(ROTOR, recordings))}, found.noise) as runs:
        tuning = retune(runs)
        fits = refit(runs, tuning, runs.measured(), [((EffectAt("cogging", "rotor"),), (start,))])
        (fit,) = with_other_harmonics(runs, tuning, runs.measured(), fits)
    order, a1, _, a2, _ = fit.values[0]
    assert (order, a1) == pytest.approx((72.0, 0.1), rel=0.02)
    assert a2 == pytest.approx(0.02, rel=0.3)


@pytest.mark.parametrize(("second", "phase"), [(0.02, 2.0 - np.pi), (0.0, -0.8)])
def test_an_amplitude_goes_through_zero_to_the_wave_half_a_cycle_on(second, phase):
    recordings = pieces(8, Np=72.0, A1=0.1, phi1=0.4, A2=0.02, phi2=2.0)
    with FreeRuns({TRAIN: (found := mismatch(ROTOR, recordings))}, found.noise) as runs:
        start = (EffectAt("cogging", "rotor"),), (np.array([72.0, 0.1, 0.4, second, phase]),)
        (fit,) = refit(runs, retune(runs), runs.measured(), [start])
    _, a1, _, a2, phi2 = fit.values[0]
    assert (a1, a2) == pytest.approx((0.1, 0.02), rel=0.1)
    assert np.cos(phi2 - 2.0) > 0.99


def test_a_step_through_zero_keeps_the_wave():
    own, start = EffectAt("base_motion", "rotor"), np.array([0.02, 2.0, 2.0])
    fitting = Coordinates(SimpleNamespace(offset=np.zeros(0), at=lambda offset: offset), (own,), (start,), Visited(1.0))
    at = fitting.point(np.zeros(0), (start,))
    waves = [fitting.moved(at, np.array([step, 0.0, 0.0])).values[0] for step in (0.1, 0.0, -0.1, -3.0)]
    sizes = [amplitude * np.cos(phase - 2.0) for amplitude, _, phase in waves]
    assert np.diff(sizes) == pytest.approx((sizes[1] - sizes[0]) * np.array([1.0, 1.0, 29.0]))  # in proportion to the step
    assert sizes[0] > sizes[1] == pytest.approx(0.02)
    assert sizes[3] < 0.0
    assert all(amplitude > 0.0 for amplitude, _, _ in waves)


@pytest.mark.parametrize(("numbers", "entries", "are"), [(27, 25_000, False), (27, 150_000, True), (49, 25_000, True), (3, 300_000, False)])
def test_sensitivities_are_costly_where_many_numbers_or_long_records_make_them_most_of_the_work(numbers, entries, are):
    tuning = SimpleNamespace(offset=np.zeros(numbers), jacobian=np.broadcast_to(0.0, (entries, numbers)))
    assert are_costly(tuning) is are


@pytest.mark.parametrize(("before", "turn", "after"), [(3.1, 0.5, 3.6 - 2.0 * np.pi), (-3.1, -0.5, 2.0 * np.pi - 3.6)])
def test_a_phase_turns_without_an_end(before, turn, after):
    own, start = EffectAt("base_motion", "rotor"), np.array([0.1, 2.0, before])
    fitting = Coordinates(SimpleNamespace(offset=np.zeros(0), at=lambda offset: offset), (own,), (start,), Visited(1.0))
    at = fitting.moved(fitting.point(np.zeros(0), (start,)), np.array([0.0, 0.0, turn]))
    assert at.values[0][2] == pytest.approx(after)
    low, high = fitting.reach(at, 1.0)
    assert (low[2], high[2]) == pytest.approx((-1.0, 1.0))


def test_a_cogging_is_found_at_the_order_of_what_stands_for_it():
    """A friction over position that was found at its order; its own starts were at orders that are none."""
    recordings = pieces(8, Np=72.0, A1=0.1, phi1=0.4, A2=0.0, phi2=0.0)
    friction, cogging = EffectAt("position_dependent_friction", "rotor"), EffectAt("cogging", "rotor")
    elsewhere = Candidate(cogging, (np.array([10.0, 0.1, 0.4, 0.0, 0.0]),))
    with FreeRuns({TRAIN: (found := mismatch(ROTOR, recordings))}, found.noise) as runs:
        tuning = retune(runs)
        fits = [fit for fit in refit(runs, tuning, runs.measured(), [((friction,), (np.array([0.1, 72.0, 0.0]),))]) if fit is not None]
        nothing = SimpleNamespace(effects=(), fitted=None, tuning=tuning, cost=float(np.sum((runs.measured() - tuning.predicted) ** 2)))
        found = with_others_of_its_order(runs, tuning, nothing, runs.measured(), fits, [elsewhere])
        once_more = with_others_of_its_order(runs, tuning, nothing, runs.measured(), found, [elsewhere])
    assert found[:1] == fits
    (fit,) = found[1:]
    assert fit.effects == (cogging,)
    assert fit.values[0][:2] == pytest.approx((72.0, 0.1), rel=0.1)
    assert fit.cost < 0.1 * fits[0].cost
    assert once_more == found  # what is there at that order is not fitted again


def test_a_step_is_found_where_singular_values_do_not_converge(monkeypatch):
    random = np.random.default_rng(9)
    root = random.standard_normal((12, 8))
    hessian, gradient, reach = root.T @ root, random.standard_normal(8), np.full(8, 0.1)
    expected = bounded(hessian, gradient, -reach, reach)
    assert np.any(np.abs(expected) > 0.0999) and np.any(np.abs(expected) < 0.099)
    lsq_linear = scipy.optimize.lsq_linear

    def failing(*problem, method, **options):
        if method == "bvls":
            raise np.linalg.LinAlgError("SVD did not converge in Linear Least Squares")
        return lsq_linear(*problem, method=method, **options)

    monkeypatch.setattr(scipy.optimize, "lsq_linear", failing)
    assert bounded(hessian, gradient, -reach, reach) == pytest.approx(expected, abs=1e-4)
