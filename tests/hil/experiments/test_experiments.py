"""Experiments become plans that repeat, start from standstill, say what they are, and are refused when they would break a limit."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from controllers.excitation_lines import Band
from hil.errors import ExperimentError
from hil.experiments import Experiment, Jog, JogOnly, Move, Multisine, Scan, Static
from hil.machine import load_machine
from hil.simulation import Inputs, Simulator
from virtual_bus.physics import Physics

CARM = load_machine("carm")
PERIOD_S, PERIOD = 5.0, 1280
SHORT = Multisine(period_s=PERIOD_S, periods=2, amplitude_A=0.2, jog=Jog(amplitude_rad=0.01, line=1))
KEYS = {
    "kind",
    "period_samples",
    "settle_periods",
    "periods",
    "realisation",
    "realisations",
    "experiment",
    "experiments",
    "excited_lines",
    "seed",
    "amplitude",
    "crest_factor",
    "jog",
    "start_pose",
    "odd_even_split",
}
USED = 0.9  # share of a drive's limit that a prediction may use: a tenth is left to transients, noise and what the model lacks


def replaced(**changes: object) -> Multisine:
    return dataclasses.replace(SHORT, **changes)


def test_a_multisine_is_one_plan_per_realisation_and_experiment() -> None:
    plans = replaced(realisations=3).plans(CARM)
    assert [(p.metadata["realisation"], p.metadata["experiment"]) for p in plans] == [(m, e) for m in range(3) for e in range(2)]
    assert all(set(p.metadata) == KEYS for p in plans)
    for plan in plans:
        assert plan.rows == 3 * PERIOD == len(plan.excitation)
        assert np.array_equal(plan.excitation[:PERIOD], plan.excitation[PERIOD : 2 * PERIOD])
        assert np.array_equal(plan.reference[PERIOD : 2 * PERIOD], plan.reference[2 * PERIOD :])
        assert np.array_equal(plan.reference[0], plan.start_pose)
        np.testing.assert_allclose(np.sqrt(np.mean(plan.excitation**2, axis=0)), 0.2)
        peak = np.abs(plan.excitation).max(axis=0)
        np.testing.assert_allclose(plan.metadata["crest_factor"], peak / 0.2)
        lines = np.flatnonzero(np.abs(np.fft.rfft(plan.excitation[:PERIOD, 0])) > 1e-6)
        assert lines.tolist() == plan.metadata["excited_lines"]
        assert (lines % 2 == 1).all()
        assert 1 not in lines
        assert plan.metadata["odd_even_split"]
        assert "predicted peak command" in plan.notes[0]


def test_the_default_multisine_is_the_corrected_theses_jog() -> None:
    plan = Multisine(amplitude_A=0.1, periods=1).plans(CARM)[0]
    assert plan.metadata["jog"] == {"axes": ["propeller", "roll"], "amplitude_rad": np.radians(2.0), "line": 1, "frequency_Hz": 0.05}
    assert plan.metadata["period_samples"] == 5120
    kept = plan.reference[-5120:] - plan.start_pose
    assert np.abs(kept).max() == pytest.approx(np.radians(2.0))


def test_the_experiments_of_a_realisation_are_orthogonal() -> None:
    first, second = replaced(amplitude_A={"propeller": 0.2, "roll": 0.1}).plans(CARM)
    lines = first.metadata["excited_lines"]
    w = np.stack([np.fft.rfft(p.excitation[:PERIOD], axis=0)[lines] for p in (first, second)], axis=2)
    product = w @ w.conj().transpose(0, 2, 1)
    assert np.abs(product[:, 0, 1]).max() < 1e-9 * np.abs(product).max()
    np.testing.assert_allclose(product[:, 0, 0] / product[:, 1, 1], 4.0)


def test_single_axis_experiments_leave_the_other_axis_alone() -> None:
    propeller, roll = replaced(experiments="single").plans(CARM)
    assert not propeller.excitation[:, 1].any()
    assert not roll.excitation[:, 0].any()
    assert propeller.metadata["amplitude"] == [0.2, 0.0]
    assert propeller.metadata["crest_factor"][1] == 0.0
    (only,) = replaced(axes=("roll",)).plans(CARM)
    assert only.metadata["experiments"] == 1
    assert not only.excitation[:, 0].any()
    assert only.metadata["jog"]["axes"] == ["roll"]
    assert (only.reference[:, 0] == only.start_pose[0]).all()


def test_an_even_jog_line_forfeits_the_split_and_says_so() -> None:
    plan = replaced(jog=Jog(amplitude_rad=0.01, line=2)).plans(CARM)[0]
    assert not plan.metadata["odd_even_split"]
    assert "even line 2 forfeits the odd/even split" in plan.notes[1]


def test_the_jogs_line_is_left_out_of_a_band_and_refused_among_explicit_lines() -> None:
    plan = replaced(lines=Band(0.2, 20.0), jog=Jog(amplitude_rad=0.005, line=3)).plans(CARM)[0]
    assert plan.metadata["excited_lines"][:3] == [1, 5, 7]
    with pytest.raises(ExperimentError, match="line 3 carries the jog"):
        replaced(lines=(3, 5), jog=Jog(amplitude_rad=0.005, line=3)).plans(CARM)


def test_a_jog_off_the_grid_is_refused_with_the_nearest_on_it() -> None:
    with pytest.raises(ExperimentError, match=r"off the grid of 0\.2 Hz.*nearest frequency on it is 0\.2 Hz"):
        replaced(jog=Jog(frequency_Hz=0.13)).plans(CARM)


@pytest.mark.parametrize("phases", ["random", "optimised"])
@pytest.mark.parametrize("experiments", ["orthogonal", "single"])
def test_a_saturating_excitation_is_refused_and_the_amplitude_named_would_do(phases: str, experiments: str) -> None:
    asked = replaced(amplitude_A=50.0, phases=phases, experiments=experiments, realisations=2, pose={"roll": 0.5}, jog=None)
    with pytest.raises(ExperimentError, match="would reach") as refusal:
        asked.plans(CARM)
    named = float(re.search(r"at most ([\d.e+-]+) A", str(refusal.value)).group(1))
    dataclasses.replace(asked, amplitude_A=named).plans(CARM)
    with pytest.raises(ExperimentError):
        dataclasses.replace(asked, amplitude_A=named * 1.02).plans(CARM)


def test_amplitudes_by_axis_are_refused_with_the_factor_that_would_do() -> None:
    asked = replaced(amplitude_A={"propeller": 20.0, "roll": 10.0}, jog=None)
    with pytest.raises(ExperimentError) as refusal:
        asked.plans(CARM)
    factor = float(re.search(r"at most ([\d.e+-]+) times", str(refusal.value)).group(1))
    dataclasses.replace(asked, amplitude_A={"propeller": 20.0 * factor, "roll": 10.0 * factor}).plans(CARM)


def test_the_prediction_counts_the_holding_effort() -> None:
    # without excitation the predicted peak is what gravity takes
    pose = np.array([0.0, 0.8])
    plan = JogOnly(pose={"roll": 0.8}, jog=Jog(amplitude_rad=1e-6, line=1)).plans(CARM)[0]
    holding = Physics(CARM.plant, noise=False).holding_effort(pose)
    named = [float(value) for value in re.findall(r"([\d.]+) of", plan.notes[0])]
    np.testing.assert_allclose(named, np.abs(holding), atol=0.006)


def test_the_predicted_peaks_are_those_of_the_nonlinear_simulation() -> None:
    asked = Multisine(period_s=PERIOD_S, periods=2, amplitude_A=0.5, jog=Jog(amplitude_rad=0.01, line=1), pose={"roll": 0.4})
    simulator = Simulator(CARM)
    for plan in asked.plans(CARM):
        still = np.zeros_like(plan.reference)
        simulated = simulator.run(Inputs(plan.reference, plan.excitation, still, None, plan.start_pose))
        peaks = np.abs(simulated.command[-PERIOD:]).max(axis=0)
        np.testing.assert_allclose([float(value) for value in re.findall(r"([\d.]+) of", plan.notes[0])], peaks, rtol=0.02)


def test_a_scan_that_would_ask_too_much_of_the_drive_is_refused() -> None:
    scan = Scan("roll", -1.2, 1.2, np.radians(55.0))
    peak = float(re.search(r"roll ([\d.]+) of", scan.plans(CARM)[0].notes[0]).group(1))
    enough = [dataclasses.replace(each, limit=peak / USED * 1.02) for each in CARM.controllers]
    assert scan.plans(dataclasses.replace(CARM, controllers=tuple(enough)))
    weaker = [dataclasses.replace(each, limit=peak / USED * 0.98) for each in CARM.controllers]
    with pytest.raises(ExperimentError, match=r"scan: command of roll would reach.*lower speed or acceleration"):
        scan.plans(dataclasses.replace(CARM, controllers=tuple(weaker)))
    tighter = [dataclasses.replace(each, tracking_error=1e-4) for each in CARM.limits]
    with pytest.raises(ExperimentError, match=r"scan: tracking error of .* would reach"):
        scan.plans(dataclasses.replace(CARM, limits=tuple(tighter)))


def test_a_pose_that_gravity_holds_only_at_the_limit_is_refused() -> None:
    pose = {"propeller": 0.9}
    holding = np.abs(Physics(CARM.plant, noise=False).holding_effort(np.array([0.9, 0.0])))
    axis = int(holding.argmax())
    enough = [dataclasses.replace(each, limit=holding[axis] / USED * 1.01) for each in CARM.controllers]
    assert Static(pose=pose).plans(dataclasses.replace(CARM, controllers=tuple(enough)))
    weak = [dataclasses.replace(each, limit=holding[axis] / USED * 0.99) for each in CARM.controllers]
    with pytest.raises(ExperimentError, match=f"holding {CARM.axes[axis]}"):
        Static(pose=pose).plans(dataclasses.replace(CARM, controllers=tuple(weak)))


def test_a_jog_without_time_to_grow_in_is_refused() -> None:
    with pytest.raises(ExperimentError, match=r"acceleration.*settle_periods = 1"):
        Multisine(settle_periods=0, amplitude_A=0.1).plans(CARM)


@pytest.mark.parametrize("speed_deg_s", [30.0, 55.0])
def test_a_scan_dwells_sweeps_and_dwells(speed_deg_s: float) -> None:
    plan = Scan("roll", -1.2, 1.2, np.radians(speed_deg_s), pose={"propeller": 0.1}, dwell_s=0.5).plans(CARM)[0]
    roll, dwell = plan.reference[:, 1], 128
    assert (plan.reference[:, 0] == 0.1).all()
    assert (roll[:dwell] == -1.2).all()
    assert roll[-dwell:] == pytest.approx(1.2)
    assert np.abs(np.diff(roll)).max() * 256.0 == pytest.approx(np.radians(speed_deg_s))
    assert plan.metadata["periods"] == 1
    assert plan.metadata["period_samples"] == plan.rows


def test_scans_there_and_back_are_periods() -> None:
    plan = Scan("roll", 0.0, 1.0, 0.4, acceleration=0.3, dwell_s=0.5, sweeps=4).plans(CARM)[0]
    samples = plan.metadata["period_samples"]
    assert plan.metadata["periods"] == 2
    assert plan.rows == 2 * samples
    np.testing.assert_allclose(plan.reference[:samples], plan.reference[samples:], atol=1e-12)
    assert np.abs(np.diff(plan.reference[:, 1])).max() * 256.0 == pytest.approx(0.4)
    assert np.abs(np.diff(plan.reference[:, 1], 2)).max() * 256.0**2 == pytest.approx(0.3)


def test_a_move_ends_at_its_goal_and_a_static_stays() -> None:
    move = Move({"roll": -0.3}, {"roll": 0.5, "propeller": 0.2}).plans(CARM)[0]
    np.testing.assert_allclose(move.reference[-1], [0.2, 0.5])
    static = Static(2.0, {"roll": 0.5}).plans(CARM)[0]
    assert static.rows == 512
    assert (static.reference == [0.0, 0.5]).all()
    assert not static.excitation.any()


def test_gravity_feedforward_follows_the_reference_on_the_axes_that_ask() -> None:
    asking = dataclasses.replace(CARM.controllers[1], gravity_feedforward=True)
    machine = dataclasses.replace(CARM, controllers=(CARM.controllers[0], asking))
    plan = Move({"roll": -0.8}, {"roll": 0.8}).plans(machine)[0]
    physics = Physics(CARM.plant, noise=False)
    assert not plan.feedforward[:, 0].any()
    for row in (0, plan.rows // 2, plan.rows - 1):
        assert plan.feedforward[row, 1] == pytest.approx(physics.holding_effort(plan.reference[row])[1], abs=1e-9)
    assert Static().plans(CARM)[0].feedforward is None


@pytest.mark.parametrize(
    ("experiment", "says"),
    [
        (replaced(pose={"rol": 0.1}), "no axis 'rol'; it has propeller, roll"),
        (replaced(axes=("tilt",)), "no axis 'tilt'"),
        (Static(pose={"roll": 4.0}), "roll = 229.18 deg is outside"),
        (replaced(period_s=5.001), r"5\.001.*holds whole"),
        (replaced(period_s=-1.0), "period_s"),
        (replaced(periods=0), "periods = 0"),
        (replaced(settle_periods=-1), "settle_periods = -1"),
        (replaced(realisations=0), "realisations = 0"),
        (replaced(amplitude_A=-1.0), "positive"),
        (replaced(amplitude_A={"roll": 1.0}), "given for roll; excited are propeller, roll"),
        (replaced(lines=(3, 640)), "line 640"),
        (replaced(lines=(3, 5), weights=(1.0,)), "weights"),
        (replaced(weights=(1.0,)), "weights go with explicit lines"),
        (replaced(jog=Jog(amplitude_rad=0.0, line=1)), "amplitude_rad"),
        (replaced(jog=Jog(line=1, frequency_Hz=0.2)), "both given"),
        (replaced(jog=Jog(line=640)), "jog on line 640"),
        (replaced(jog=Jog(amplitude_rad=3.0, line=1)), "the reference of propeller"),
        (Scan("roll", 0.0, 3.0), "outside the range"),
        (Scan("roll", 0.0, 0.02), "too short"),
        (Scan("roll", 0.0, 1.0, acceleration=100.0), "acceleration = 100"),
        (Scan("roll", 0.0, 1.0, sweeps=0), "sweeps = 0"),
        (Scan("roll", 0.0, 1.0, dwell_s=-1.0), "dwell_s"),
        (Scan("roll", 0.0, 1.0, speed=1e-6), "takes 1e.06 s at least with 1 sweeps of 1e.06 s, standstill included: a day at most"),
        (replaced(period_s=1e6), "takes 6e.06 s at least with 2 recordings of 3 periods of 1e.06 s: a day at most"),
        (replaced(realisations=10**6), "2000000 recordings of 3 periods of 5 s: a day at most"),
        (replaced(period_s=np.inf), "at least 4 samples"),
        (JogOnly(periods=10**8), "takes 2e.09 s at least with 100000001 periods of 20 s: a day at most"),
        (Static(seconds=0.0), "seconds = 0"),
        (Move({}, {"roll": 9.0}), "roll = 515.66 deg is outside"),
    ],
)
def test_an_experiment_that_cannot_be_is_refused_in_one_line(experiment: Experiment, says: str) -> None:
    with pytest.raises(ExperimentError, match=says) as refusal:
        experiment.plans(CARM)
    assert "\n" not in str(refusal.value)


def test_a_machine_without_a_controller_is_not_run() -> None:
    with pytest.raises(ExperimentError, match="no controller"):
        Static().plans(dataclasses.replace(CARM, controllers=()))
