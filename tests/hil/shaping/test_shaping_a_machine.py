"""Shapers for the C-arm: what they are designed for is what the machine does, files, shaped plans, and the command."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.signal
from bench_machines import CARM, carm_text_in
from page_text import page_text, page_verdict

from controllers.errors import DesignError
from controllers.sections import response
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics
from controllers.shapers.filter import ReferenceShaper
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.cli import main
from hil.errors import ExperimentError, UnusableInputError
from hil.experiments import Scan
from hil.identification import write_frf
from hil.identification.result import FrequencyResponse
from hil.machine import Machine, load_machine, machine_from_text
from hil.recording import read_recording
from hil.shaping.aim import periodic, sweep
from hil.shaping.identified import subject_from_frf, subject_from_model
from hil.shaping.in_time import after_step
from hil.shaping.plans import BeyondLimitsError, Shaped, shape_plan, shaped
from hil.shaping.plants import closed_loop
from hil.shaping.poses import scheduled_poses, subject_at
from hil.shaping.shaper_design import Design, choose_delay, delay_map, design_all, poles_to_cancel, shaper_of
from hil.shaping.shaper_file import ShaperFile, read_shaper, write_shaper
from hil.shaping.verdict import Subject, judge, tracking_error, vibration_left
from hil.simulation import Inputs, Outputs, Simulator
from hil.simulation.linear import sampled_response
from virtual_bus.physics import Physics

RATE = 256.0


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("carm")


@pytest.fixture(scope="module")
def exact(machine: Machine) -> Machine:
    """The machine without quantisation: what a linear prediction can be held against."""
    plant = replace(
        machine.plant,
        drives=tuple(replace(each, resolution=0.0) for each in machine.plant.drives),
        encoders=tuple(replace(each, resolution=0.0) for each in machine.plant.encoders),
    )
    return replace(machine, plant=plant)


@pytest.fixture(scope="module")
def physics(machine: Machine) -> Physics:
    return Physics(machine.plant, noise=False)


@pytest.fixture(scope="module")
def nominal(machine: Machine, physics: Physics) -> dict[str, Subject]:
    return {axis: subject_at(machine, np.zeros(2), axis, "link", physics) for axis in machine.axes}


@pytest.fixture(scope="module")
def sweep_designs(nominal: dict[str, Subject]) -> tuple[Design, ...]:
    return design_all([nominal["roll"]], sweep(), RATE).designs


@pytest.fixture(scope="module")
def roll_file(sweep_designs: tuple[Design, ...]) -> ShaperFile:
    return ShaperFile((shaper_of(sweep_designs[0], "roll", RATE),), RATE, {"machine": "carm"})


def simulate(machine: Machine, reference: np.ndarray) -> Outputs:
    still = np.zeros_like(reference)
    return Simulator(machine).run(Inputs(reference, still, still, None, reference[0].copy()))


@pytest.mark.parametrize("axis", [0, 1])
def test_the_closed_loop_designed_for_is_the_machines(machine: Machine, exact: Machine, physics: Physics, axis: int) -> None:
    frequencies, samples = np.array([1.25, 5.0, 8.75]), 1024  # whole periods in 4 s
    times = np.arange(3 * samples) / RATE
    reference = np.zeros((len(times), 2))
    reference[:, axis] = 1e-4 * np.sin(2 * np.pi * np.outer(times, frequencies)).sum(axis=1)
    out = simulate(exact, reference).link_position[:, axis]
    moved = out - out[0]  # sag of the gear at rest
    lines = (frequencies * samples / RATE).astype(int)
    spectra = [np.fft.rfft(values[-samples:])[lines] for values in (moved, reference[:, axis])]
    # the loop's model is scaled to DC gain 1, which takes the sag of the gear out: less than 0.1 %
    predicted = closed_loop(machine, np.zeros(2), machine.axes[axis], "link", physics).response(2j * np.pi * frequencies)
    assert spectra[0] / spectra[1] == pytest.approx(predicted, rel=3e-3)


def test_the_eight_hertz_mode_and_the_detector_mode_are_cancelled(nominal: dict[str, Subject]) -> None:
    frequencies = [abs(pole) / 2 / np.pi for pole in poles_to_cancel([nominal["propeller"]], RATE)[0]]
    assert min(abs(f - 8.4) for f in frequencies) < 0.3
    assert min(abs(f - 14.05) for f in frequencies) < 0.3


def test_designs_come_with_the_recommended_one_first(sweep_designs: tuple[Design, ...]) -> None:
    assert not sweep_designs[0].verdict.against
    clean = [design.verdict.cost for design in sweep_designs if not design.verdict.against]
    assert clean == sorted(clean)
    assert {"none", "ZV", "ZV all", "notch", "hTDF", "hTDF robust", "hTDF quiet"} <= {design.name for design in sweep_designs}
    by_name = {design.name: design.verdict for design in sweep_designs}
    assert by_name["none"].vibration == 1.0
    assert "lags" in by_name["ZVD"].against
    assert abs(by_name["hTDF robust"].lag_s) < 1e-9
    assert by_name["hTDF robust"].vibration_at_10 < by_name["ZV"].vibration_at_10


def test_what_speaks_against_a_shaper_is_said(nominal: dict[str, Subject]) -> None:
    subject, aim = nominal["roll"], sweep(0.5)
    cases = {
        "gains sum to more than 3": [5.0, -4.0],
        "H(0) = 0.9": [0.5, 0.4],
        "the scan has time for 0.5 s": [0.6] + [0.0] * 199 + [0.4],
        "a ramp lags": [0.5, 0.5],
    }
    for text, gains in cases.items():
        shaper = DelayFilter(np.arange(len(gains)) / RATE, np.array(gains), None, "made")
        assert text in judge([shaper], [subject], aim, [()]).against


def test_what_is_left_out_is_listed(sweep_designs: tuple[Design, ...]) -> None:
    listed = sweep_designs[0].verdict.left_out
    assert any(each.frequency_Hz < 0.2 for each in listed)  # the integrator's slow pole
    assert all(each.residual > 0.0 for each in listed)


def test_a_periodic_design_tracks_its_harmonics_exactly(nominal: dict[str, Subject]) -> None:
    aim = periodic(3.0, (1, 3, 5))
    design = design_all([nominal["propeller"]], aim, RATE).named("hTDF quiet")
    assert tracking_error(design.filters[0], nominal["propeller"].dynamics, aim) < 1e-9
    assert vibration_left(design.filters[0], nominal["propeller"].ringing) < 0.01
    assert design.verdict.transient_s < 3.0


def test_a_schedule_serves_every_pose_better_than_one_pose_does(machine: Machine, physics: Physics) -> None:
    poses = scheduled_poses(machine, np.zeros(2), "roll")
    subjects = [subject_at(machine, pose, "propeller", "link", physics) for pose in poses]
    scheduled = design_all(subjects, sweep(), RATE).named("hTDF robust")
    alone = design_all(subjects[3:4], sweep(), RATE).named("hTDF robust")
    worst = max(vibration_left(alone.filters[0], each.ringing) for each in subjects)
    assert scheduled.verdict.vibration < 0.2 * worst
    shaper = shaper_of(scheduled, "propeller", RATE, poses[:, 1].tolist(), "roll")
    assert shaper.gains.shape == (len(poses), len(shaper.delays))
    ReferenceShaper(machine.axes, [shaper], machine.limits, RATE)


def test_the_map_shows_gains_growing_as_the_delay_shrinks(nominal: dict[str, Subject]) -> None:
    from controllers.shapers.harmonic_time_delay import harmonic_conditions

    subject = nominal["roll"]
    poles = poles_to_cancel([subject], RATE)[0]
    conditions = [harmonic_conditions(subject.dynamics, [0.0], poles, robust_forcing_rad_s=[0.0])]
    rows = delay_map(conditions, [subject], 1 / RATE, 0.4)
    assert rows[0].gain_sum > 100.0 * min(row.gain_sum for row in rows)
    chosen = choose_delay(rows, 0.4)
    assert chosen.gain_sum <= 3.0
    assert chosen.transient_s <= 0.4


@pytest.fixture(scope="module")
def frf(machine: Machine) -> FrequencyResponse:
    """The machine's response with 0.3 % noise, as an identification would write it."""
    lines = np.arange(3, 800, 4)
    outputs = ("position_propeller", "position_roll", "link_position_propeller", "link_position_roll", "imu_x", "imu_y", "imu_z")
    clean = sampled_response(machine, np.zeros(2), lines * 0.05, outputs)
    noise = np.random.default_rng(1).standard_normal((2, *clean.shape))
    response = clean * (1.0 + 0.003 * (noise[0] + 1j * noise[1]))
    return FrequencyResponse(
        lines, lines * 0.05, response, response, None, None, None, None, None, np.zeros(len(lines)), np.zeros(len(lines)), outputs,
        ("command_propeller", "command_roll"), ("",) * 7, ("A", "A"), RATE, 5120, "made",
    )  # fmt: skip


def test_a_frequency_response_gives_the_same_modes_as_the_machine_file(
    machine: Machine, nominal: dict[str, Subject], frf: FrequencyResponse
) -> None:
    found, error = subject_from_frf(machine, frf, "propeller")
    assert error < 0.02
    true = nominal["propeller"]
    for frequency in (8.37, 14.05):
        wanted = min((mode.pole for mode in true.ringing), key=lambda p: abs(abs(p) / 2 / np.pi - frequency))
        assert min(abs(mode.pole - wanted) for mode in found.ringing) < 0.01 * abs(wanted)
    s = 2j * np.pi * np.array([0.5, 1.0, 2.0])
    assert found.dynamics.response(s) == pytest.approx(true.dynamics.response(s), rel=0.03)
    with pytest.raises(DesignError, match="link or motor"):
        subject_from_frf(machine, frf, "propeller", "detector")


def test_a_file_comes_back_equal(tmp_path: Path, roll_file: ShaperFile) -> None:
    write_shaper(roll_file, tmp_path / "a.npz")
    back = read_shaper(tmp_path / "a.npz")
    assert back.sample_rate_Hz == RATE
    assert back.notes == roll_file.notes
    for name in ("delays", "gains", "positions", "tail"):
        assert (getattr(back.shapers[0], name) == getattr(roll_file.shapers[0], name)).all()
    assert back.shapers[0].axis == "roll"


@pytest.mark.parametrize("damage", ["missing", "text", "array", "delays", "format"])
def test_a_file_that_is_no_shaper_is_one_line(tmp_path: Path, roll_file: ShaperFile, damage: str) -> None:
    path = tmp_path / "a.npz"
    if damage == "text":
        path.write_text("no archive")
    elif damage != "missing":
        write_shaper(roll_file, path)
        arrays = dict(np.load(path))
        if damage == "array":
            del arrays["gains_roll"]
        elif damage == "delays":
            arrays["delays_roll"] = arrays["delays_roll"][::-1]
        else:
            arrays["format"] = np.array(99)
        np.savez(path, **arrays)
    with pytest.raises(UnusableInputError, match=r"a\.npz") as caught:
        read_shaper(path)
    assert "\n" not in str(caught.value)


def test_a_shaped_plan_is_the_raw_one_through_the_loops_filter(machine: Machine, roll_file: ShaperFile) -> None:
    plan = Shaped(Scan("roll", -0.8, 0.8, speed=np.radians(30), dwell_s=0.0), roll_file).plans(machine)[0]
    running = ReferenceShaper(machine.axes, roll_file.shapers, machine.limits, RATE)
    running.start(plan.start_pose)
    out = np.empty(2)
    for k in range(plan.rows):
        running.step(plan.reference_raw[k], out)
        assert (out == plan.reference[k]).all()
    assert (plan.reference[:, 0] == plan.reference_raw[:, 0]).all()
    assert plan.reference[-1] == pytest.approx(plan.reference_raw[-1], abs=1e-12)
    assert plan.metadata["shaper"] == {"roll": roll_file.shapers[0].name}
    assert plan.metadata["period_samples"] == plan.rows


def test_a_scan_at_full_limits_is_refused_shaped_and_planned_more_gently_when_asked(machine: Machine, roll_file: ShaperFile) -> None:
    scan = Scan("roll", -0.8, 0.8, speed=np.radians(30))
    with pytest.raises(BeyondLimitsError, match="the shaper adds"):
        shape_plan(scan.plans(machine)[0], roll_file, machine)
    plan = Shaped(scan, roll_file).plans(machine)[0]
    for order, most in ((2, machine.limits[1].acceleration), (3, machine.limits[1].jerk)):
        assert np.abs(np.diff(plan.reference[:, 1], order)).max() * RATE**order <= most * 1.0001
    assert any("planned with" in note for note in plan.notes)


def test_a_transient_longer_than_the_scans_period_is_refused(machine: Machine, nominal: dict[str, Subject]) -> None:
    design = design_all([nominal["roll"]], periodic(5.0), RATE).named("hTDF quiet")
    file = ShaperFile((shaper_of(design, "roll", RATE),), RATE)
    with pytest.raises(ExperimentError, match="its transient takes"):
        Shaped(Scan("roll", -0.1, 0.1, speed=0.2, sweeps=4, dwell_s=0.0), file).plans(machine)


def test_another_sample_rate_is_refused(machine: Machine, roll_file: ShaperFile) -> None:
    plan = Scan("roll", -0.3, 0.3, speed=0.3).plans(machine)[0]
    with pytest.raises(ExperimentError, match="designed for 512 Hz"):
        shape_plan(plan, replace(roll_file, sample_rate_Hz=512.0), machine)


def test_the_shaped_machine_rings_less_after_a_sweep(machine: Machine, exact: Machine, nominal: dict[str, Subject]) -> None:
    """Free run of the machine itself, not of the model the shaper was designed for."""
    design = design_all([nominal["propeller"]], sweep(), RATE).named("hTDF robust")
    gentle = replace(machine, limits=tuple(replace(each, acceleration=0.5 * each.acceleration, jerk=350.0) for each in machine.limits))
    scan = Scan("propeller", -0.5, 0.5, speed=0.5, dwell_s=1.0)
    raw = scan.plans(gentle)[0].reference_raw
    raw = np.vstack([raw, np.tile(raw[-1], (256, 1))])
    reference, _ = shaped(ReferenceShaper(machine.axes, [shaper_of(design, "propeller", RATE)], gentle.limits, RATE), raw, raw[0])
    arrived = np.flatnonzero(np.abs(np.diff(raw[:, 0])) > 0.0)[-1]
    swing = []
    for driven in (raw, reference):
        after = simulate(exact, driven).imu[arrived + 80 : arrived + 336, :3]
        spectrum = np.fft.rfft((after - after.mean(axis=0)) * np.hanning(256)[:, None], axis=0)
        swing.append(float(np.sqrt((np.abs(spectrum[6:13]) ** 2).sum())))
    assert swing[0] > 5.0 * swing[1]


@pytest.mark.slow
def test_over_the_bus_a_shaped_periodic_scan_vibrates_and_errs_several_times_less(
    machine: Machine, nominal: dict[str, Subject], tmp_path: Path
) -> None:
    """Closed loop over every CAN frame in lockstep: detector acceleration between 4 and 20 Hz from the emulator's truth."""
    gentle = replace(machine, limits=tuple(replace(e, acceleration=0.5 * e.acceleration, jerk=0.5 * e.jerk) for e in machine.limits))
    raw = Scan("propeller", -0.17, 0.17, speed=0.24, dwell_s=0.0, sweeps=6).plans(gentle)[0]
    period = int(raw.metadata["period_samples"])
    design = design_all([nominal["propeller"]], periodic(period / RATE), RATE).named("hTDF quiet")
    plan = shape_plan(raw, ShaperFile((shaper_of(design, "propeller", RATE),), RATE), machine)
    assert plan.metadata["settle_periods"] == 1
    vibration, error = [], []
    for number, each in enumerate((raw, plan)):
        path, truth = tmp_path / f"{number}.csv", tmp_path / f"{number}.truth.csv"
        with open_bench(machine, BenchOptions("lockstep:", noise=False, truth=truth), each.start_pose) as bench:
            bench.run(each, path)
        recording = read_recording(path)
        assert recording["reference_raw_propeller"] == pytest.approx(each.reference_raw[:, 0], abs=1e-12)
        assert recording["reference_propeller"] == pytest.approx(each.reference[:, 0], abs=1e-12)
        columns = [truth.read_text().split("\n", 1)[0].split(",").index(f"pose_detector_{axis} [m]") for axis in "xyz"]
        centre = np.loadtxt(truth, delimiter=",", skiprows=1, usecols=columns)
        sections = scipy.signal.butter(6, (4.0, 20.0), "bandpass", fs=RATE, output="sos")
        accelerations = scipy.signal.sosfiltfilt(sections, np.diff(centre, 2, axis=0) * RATE**2, axis=0)
        rows = slice(period, 2 * period)
        vibration.append(np.sqrt(np.mean(accelerations[rows] ** 2)))
        error.append(np.std((recording["link_position_propeller"] - each.reference_raw[:, 0])[rows]))
    assert vibration[0] > 5.0 * vibration[1]
    assert error[0] > 3.0 * error[1]


def test_a_scan_by_command_has_the_shaper_in_its_reference(tmp_path: Path, machine: Machine, roll_file: ShaperFile) -> None:
    write_shaper(roll_file, tmp_path / "roll.shaper.npz")
    scan = ["run", "scan", "-m", "carm", "-b", "lockstep:", "--axis", "roll", "--from", "30", "--to", "34", "--speed", "4"]
    with pytest.raises(SystemExit) as left:
        main([*scan, "--shaper", str(tmp_path / "roll.shaper.npz"), "-o", str(tmp_path / "scan.mf4")])
    assert left.value.code == 0
    recording = read_recording(tmp_path / "scan.mf4")
    raw = np.column_stack([recording[f"reference_raw_{axis}"] for axis in machine.axes])
    filtered, held = shaped(ReferenceShaper(machine.axes, roll_file.shapers, machine.limits, RATE), raw, raw[0])
    assert held == -1
    np.testing.assert_allclose(recording["reference_roll"], filtered[:, 1], atol=1e-12)
    assert np.abs(recording["reference_roll"] - recording["reference_raw_roll"]).max() > 1e-4
    assert np.nanmax(np.abs(recording["reference_roll"] - recording["position_roll"])) < np.radians(1.0)


def test_an_identified_model_closes_the_same_loop(machine: Machine, physics: Physics, nominal: dict[str, Subject]) -> None:
    found = subject_from_model(machine, physics.linearise(np.zeros(2)), "roll")
    s = 2j * np.pi * np.array([0.3, 3.0, 12.0])
    assert found.dynamics.response(s) == pytest.approx(nominal["roll"].dynamics.response(s), rel=1e-9)
    assert len(poles_to_cancel([found], RATE)[0]) == len(poles_to_cancel([nominal["roll"]], RATE)[0])


def test_the_command_judges_writes_and_answers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, table = tmp_path / "roll.npz", tmp_path / "roll.csv"
    arguments = ["shape", "carm", "--axis", "roll", "-o", str(out), "--csv", str(table), "--json", "-", "--figure", str(tmp_path / "a.png")]
    with pytest.raises(SystemExit) as left:
        main([*arguments, "--page", str(tmp_path / "a.html")])
    assert left.value.code == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["chosen"] == answer["recommended"] == answer["designs"][0]["name"]
    assert read_shaper(out).shapers[0].name == answer["chosen"]
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [design["name"] for design in answer["designs"]]
    for row, design in zip(rows, answer["designs"], strict=True):
        told = design["residual"] or dict.fromkeys(("low", "likely", "high", "rms"), float("nan"))
        for part in ("low", "likely", "high", "rms"):
            assert float(row[f"residual_{part}"]) == pytest.approx(told[part], nan_ok=True)
    assert page_verdict(tmp_path / "a.html").removeprefix("? ").startswith(f"{answer['chosen']} for roll of carm leaves ")
    assert all(design["name"] in page_text(tmp_path / "a.html") for design in answer["designs"])
    assert (tmp_path / "a.png").stat().st_size > 10_000
    assert answer["fit"] is True
    assert answer["in_time"]["shaped"]["settled_s"] < 0.5 * answer["in_time"]["without"]["settled_s"]


def test_what_the_command_prints_fits_a_hundred_columns_and_marks_the_recommended_design(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(["shape", "carm", "--axis", "roll", "-o", "roll.npz"])
    assert left.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 100
    name = read_shaper(tmp_path / "roll.npz").shapers[0].name
    assert lines[0].startswith(f"{name} for roll of carm leaves ")
    (marked,) = [number for number, line in enumerate(lines) if line.startswith("*")]
    assert lines[marked].split("  ")[0] == f"* {name}"
    assert lines[marked + 1].strip() == "recommended; written"
    assert [line for line in lines if line.startswith("  without shaper  up to ")]


def test_a_design_with_an_objection_is_written_and_exit_status_1_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["shape", "carm", "--axis", "roll", "--take", "ZV", "-o", str(tmp_path / "zv.npz")])
    assert left.value.code == 1
    assert capsys.readouterr().out.startswith("ZV is not fit to run on roll of carm: a ramp lags. Recommended is ")
    assert read_shaper(tmp_path / "zv.npz").shapers[0].name == "ZV"


def test_a_step_behind_a_shaper_is_what_scipy_makes_of_it(nominal: dict[str, Subject], sweep_designs: tuple[Design, ...]) -> None:
    loop, shaper = nominal["propeller"].dynamics, next(design for design in sweep_designs if design.name == "hTDF").filters[0]
    found = after_step(loop, shaper, RATE)
    taps = np.zeros(round(shaper.transient_s * RATE) + 1)
    np.add.at(taps, np.rint(shaper.delays_s * RATE).astype(int), shaper.gains)
    reference = np.cumsum(np.pad(taps, (0, 600)))[:512]
    _, expected, _ = scipy.signal.dlsim((loop.a, loop.b[:, None], loop.c[None, :], np.array([[loop.d]]), 1.0), reference)
    np.testing.assert_allclose(found.reference[:512], reference, atol=1e-12)
    np.testing.assert_allclose(found.output[:512], expected[:, 0], atol=1e-9)


def test_ringing_is_that_of_a_mode_after_a_step() -> None:
    """In closed form: a mode of 8 Hz, 2 % damped, rings about its static deflection as exp(-zeta w t) cos(w_d t), and ZV removes it."""
    omega, damping = 2.0 * np.pi * 8.0, 0.02
    mode = Dynamics.from_modes([(omega, damping, 1.0)])
    ringing = after_step(mode, DelayFilter(np.zeros(1), np.ones(1)), RATE)
    t, damped = ringing.time_s, omega * np.sqrt(1.0 - damping**2)
    expected = -np.exp(-damping * omega * t) * (np.cos(damped * t) + damping * omega / damped * np.sin(damped * t))
    np.testing.assert_allclose(ringing.ringing, expected, atol=1e-9)
    assert ringing.settled_s(0.05) == pytest.approx(np.log(20.0) / (damping * omega), abs=1.0 / 8.0)
    period = 1.0 / RATE
    half = round(np.pi / damped / period) * period
    gain = np.exp(-damping * omega * half)
    shaped_by_zv = after_step(mode, DelayFilter(np.array([0.0, half]), np.array([1.0, gain]) / (1.0 + gain)), RATE)
    assert shaped_by_zv.left < 0.02


def test_the_command_designs_from_an_identified_response(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], frf: FrequencyResponse
) -> None:
    write_frf(frf, tmp_path / "carm.frf.npz")
    with pytest.raises(SystemExit) as left:
        main(["shape", "carm", "--axis", "propeller", "--frf", str(tmp_path / "carm.frf.npz"), "-o", str(tmp_path / "a.npz")])
    assert left.value.code == 1  # a ramp lags behind each of them
    assert "fitted to 0." in capsys.readouterr().out
    assert read_shaper(tmp_path / "a.npz").shapers[0].axis == "propeller"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--axis", "yaw"], "--axis yaw: carm has propeller, roll"),
        (["--axis", "roll", "--take", "magic"], "design 'magic': must be one of"),
        (["--axis", "roll", "--period", "2", "--harmonics", "a"], "--harmonics a"),
        (["--axis", "roll", "--quiet", "20:4"], "--quiet 20:4: must be LOW:HIGH in Hz, ascending"),
        (["--axis", "propeller", "--period", "0.11946", "--harmonics", "1"], "lies on the pole"),
        (["--axis", "roll", "--longest", "0.01"], "allow a longer transient"),
    ],
)
def test_bad_input_is_one_line_and_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str) -> None:
    with pytest.raises(SystemExit) as left:
        main(["shape", "carm", "-o", str(tmp_path / "x.npz"), *options])
    assert left.value.code == 2
    (error,) = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("... ")]  # which says that it takes a while
    assert message in error


@pytest.mark.parametrize("mode", ["velocity", "position"])
def test_drives_with_loops_of_their_own_have_a_path_that_is_settled(mode: str) -> None:
    machine = machine_from_text(carm_text_in(mode))
    path = closed_loop(machine, np.zeros(2), "roll", "motor")
    lines = np.array([0.5, 2.0, 5.0, 9.0])
    plant = Physics(machine.plant, noise=False).linearise(np.zeros(2))
    period_s = 1.0 / CARM.sample_rate_Hz
    a, b, c, d, _ = scipy.signal.cont2discrete((plant.A, plant.B, plant.C, plant.D), period_s)
    rows = [plant.output_labels.index(f"position_{axis}") for axis in machine.axes]
    for line in lines:
        z = np.exp(2j * np.pi * line * period_s)
        g = ((c @ np.linalg.solve(z * np.eye(len(a)) - a, b) + d) / z)[rows][:, :2]
        c_y = np.diag([response(each.position_sections, [line], 256.0)[0] for each in machine.controllers])
        c_r = response(machine.controllers[1].reference_sections, [line], 256.0)[0]
        wanted = np.linalg.solve(np.eye(2) + g @ c_y, g)[1, 1] * c_r
        assert complex(path.response(2j * np.pi * line)) == pytest.approx(wanted, rel=2e-3)  # scaled to a static gain of 1
