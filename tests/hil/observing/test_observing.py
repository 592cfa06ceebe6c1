"""Claims about the observer of the emulated C-arm: its model, its replay, its files and its command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from page_text import page_text, page_verdict

from controllers.models.modal import basis_values
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.cli import main
from hil.errors import BadAnswerError, RecordingError, UnusableInputError
from hil.experiments import Scan, Static
from hil.machine import Machine, load_machine
from hil.observing import (
    ObserverDesign,
    design_observer,
    observe,
    read_design,
    read_estimate,
    write_design,
    write_estimate,
)
from hil.observing.directions import shapes_at
from hil.observing.live import LiveObserver
from hil.observing.simulated_recordings import emulated_recording, emulated_responses
from hil.recording import Channel, Recording, read_recording
from hil.simulation import Simulator
from virtual_bus.physics import Physics


@pytest.fixture(scope="module")
def scan(machine: Machine) -> Recording:
    return emulated_recording(machine, Scan("roll", -0.5, 0.5, 0.5).plans(machine)[0], 61)


def test_identified_modes_are_the_emulated_machines_also_between_the_poses(machine: Machine, design: ObserverDesign) -> None:
    for roll in (0.0, 0.45):
        pose = np.array([0.0, roll])
        poles = np.linalg.eigvals(Physics(machine.plant, noise=False).linearise(pose).A)
        light = poles[(poles.imag > 2.0 * np.pi * 5.0) & (np.abs(poles) < 2.0 * np.pi * 24.0)]
        light = light[np.argsort(np.abs(light))]
        assert design.model.frequencies_Hz(pose) == pytest.approx(np.abs(light) / (2.0 * np.pi), rel=0.01)
        model = np.linalg.eigvals(design.model.frozen(pose)[0])  # modes and the drives' friction together
        found = model[(model.imag > 2.0 * np.pi * 5.0) & (np.abs(model) < 2.0 * np.pi * 24.0)]
        found = found[np.argsort(np.abs(found))]
        assert -found.real / np.abs(found) == pytest.approx(-light.real / np.abs(light), rel=0.08)


def test_a_design_says_what_it_knows_of_the_mounts_sag(design: ObserverDesign) -> None:
    """One position of the first axis tells none; `test_sag.py` has what more of them tell."""
    assert "the mount's sag is left out: the poses do not tell how it gives way" in design.notes


def test_what_pushes_at_gears_and_at_the_detector_finds_the_springs_there(machine: Machine, design: ObserverDesign) -> None:
    springs = {body.joint.name: body.joint.stiffness for body in machine.plant.tree.bodies if body.joint is not None}
    model, pose = design.model, np.array([0.0, 0.1])
    assert model.directions is not None
    basis = np.zeros(model.directions.shape[2])
    basis_values(np.array(model.harmonics), pose, basis)
    pushed, shapes = (model.directions @ basis)[2:], shapes_at(model, pose)
    rocking = shapes.relative[:, 3:] @ np.array([0.4, 0.916515138991168, 0.0])
    moved = {"propeller_gear": (2, shapes.link[:, 0] - shapes.motor[:, 0]), "detector_mount": (4, rocking)}
    for name, (place, shape) in moved.items():  # the modes' compliances add up to the spring's
        compliance = np.sum(pushed[:, place] * shape)
        assert 1.0 / abs(compliance) == pytest.approx(springs[name], rel=0.12), name


def test_at_rest_the_detector_is_where_the_link_sides_put_it(machine: Machine, design: ObserverDesign) -> None:
    still = emulated_recording(machine, Static(3.0, {"roll": 0.3}).plans(machine)[0], 91)
    estimate = observe(still, design.observer("ukf"))
    physics = Physics(machine.plant, noise=False)
    physics.place(np.array([0.0, 0.3]))
    q = dict(zip([joint.name for joint in machine.plant.tree.joints], physics.truth()["joint_position"], strict=True))
    wound = np.array([q["roll_gear"] * 0.35, -q["propeller_gear"] * 0.35 * np.cos(0.3), 0.0])  # gears turn the arc about the isocentre
    found = np.array([estimate[f"estimate_detector_{axis}"][-64:].mean() for axis in "xyz"])
    assert found == pytest.approx(wound, abs=3e-6)


def test_biases_and_gravity_are_told_apart(design: ObserverDesign) -> None:
    note = next(note for note in design.notes if "biases" in note)
    biases = [float(part) for part in note.split(": ")[1].split(",")]
    assert biases[:3] == pytest.approx([0.002, -0.001, 0.003], abs=7e-4)
    assert biases[3:] == pytest.approx([2e-4, -1e-4, 1e-4], abs=1e-4)


def test_the_tuned_filter_is_consistent_on_another_scan(design: ObserverDesign, scan: Recording) -> None:
    estimate = observe(scan, design.observer("ukf"))
    nis, measured = estimate["estimate_nis"][128:], estimate["estimate_measured"][128:]
    assert 0.8 < nis.sum() / measured.sum() < 1.3
    assert estimate["estimate_alarm"][128:].mean() < 0.02


def test_the_detectors_rocking_is_seen_though_no_encoder_sees_it(machine: Machine, design: ObserverDesign) -> None:
    plan = Scan("roll", -0.5, 0.5, 0.5).plans(machine)[0]
    recording = emulated_recording(machine, plan, 77)
    physics = Physics(machine.plant, noise=False)
    estimate = observe(recording, design.observer("ukf"))
    expected, found = [], []
    for rest, roll in ((slice(100, 200), -0.5), (slice(-100, None), 0.5)):  # before and after
        physics.place(np.array([0.0, roll]))
        q = dict(zip([joint.name for joint in machine.plant.tree.joints], physics.truth()["joint_position"], strict=True))
        rock = q["detector_mount"] * np.array([0.4, 0.916515138991168, 0.0]) + np.array([0.0, q["roll_gear"], 0.0])
        rock[0] += q["propeller_gear"] * np.cos(roll)
        expected.append(rock)
        found.append(np.array([estimate[f"estimate_detector_r{axis}"][rest].mean() for axis in "xyz"]))
    # an accelerometer's bias that standing records did not tell from tilt is in both
    rocked, seen = expected[1] - expected[0], found[1] - found[0]
    assert np.linalg.norm(seen - rocked) < 0.05 * np.linalg.norm(rocked), f"{seen} against {rocked}"
    left_open_rad = float(np.linalg.norm(design.noise.initial_bias[:2])) / 9.81
    for here, there in zip(found, expected, strict=True):
        assert np.linalg.norm(here - there) < left_open_rad, f"{here} against {there}"


def test_a_live_observer_and_its_replay_agree_to_the_bit(machine: Machine, design: ObserverDesign, tmp_path: Path) -> None:
    live = LiveObserver(design.observer("ukf"))
    plan = Scan("roll", -0.1, 0.1, 0.2, dwell_s=0.3).plans(machine)[0]
    with open_bench(machine, BenchOptions("lockstep:", seed=5), plan.start_pose, live) as bench:
        bench.run(plan, tmp_path / "live.mf4")
    recording = read_recording(tmp_path / "live.mf4")
    replayed = observe(recording, design.observer("ukf"))
    assert np.array_equal(recording.matrix(replayed.names), replayed.values, equal_nan=True)
    assert np.isfinite(replayed.values[-1]).all()


def test_a_design_file_keeps_every_bit(design: ObserverDesign, scan: Recording, tmp_path: Path) -> None:
    write_design(design, tmp_path / "carm.observer.npz")
    again = read_design(tmp_path / "carm.observer.npz")
    short = scan.part(slice(0, 100))
    assert np.array_equal(observe(short, design.observer()).values, observe(short, again.observer()).values, equal_nan=True)


def test_estimates_are_read_by_numpy_alone_and_join_a_recording(design: ObserverDesign, scan: Recording, tmp_path: Path) -> None:
    short = scan.part(slice(0, 100))
    estimate = observe(short, design.observer("ekf"))
    write_estimate(estimate, tmp_path / "run.est.npz")
    with np.load(tmp_path / "run.est.npz") as est:
        column = list(est["names"]).index("estimate_detector_ry")
        assert np.array_equal(est["values"][:, column], estimate["estimate_detector_ry"])
        assert est["units"][column] == "rad"
    assert np.array_equal(read_estimate(tmp_path / "run.est.npz").states, estimate.states)
    write_estimate(estimate, tmp_path / "run.mf4", short)
    joined = read_recording(tmp_path / "run.mf4")
    assert np.array_equal(joined["estimate_detector_ry_variance"], estimate["estimate_detector_ry_variance"])
    assert joined.channel("estimate_detector_ry_variance").unit == "rad^2"
    assert "position_roll" in joined


def test_a_recording_without_link_encoders_is_replayed_and_that_is_said(design: ObserverDesign, scan: Recording) -> None:
    bare = Recording({n: c for n, c in scan.channels.items() if not n.startswith("link_position")}, scan.metadata).part(slice(0, 300))
    estimate = observe(bare, design.observer("ukf"))
    assert np.isfinite(estimate.values).all()
    assert any("link_position_roll" in note for note in estimate.notes)
    whole = observe(scan.part(slice(0, 300)), design.observer("ukf"))
    ratio = estimate["estimate_detector_x_variance"][-1] / whole["estimate_detector_x_variance"][-1]
    assert ratio > 1.3  # any measurement makes a variance smaller: that would show nothing
    for k, axis in enumerate(design.model.axes):  # where the link side is, is then known as well as its motor's counter was set, no better
        bare_variance, variance = (e[f"estimate_link_position_{axis}_variance"][-1] for e in (estimate, whole))
        assert bare_variance == pytest.approx(design.noise.initial_offset[k] ** 2, rel=0.3)
        assert variance < design.noise.measurement[2 + k] ** 2


def test_what_cannot_be_observed_is_refused_in_one_line(machine: Machine, design: ObserverDesign, scan: Recording, tmp_path: Path) -> None:
    observer = design.observer("ekf")
    nothing = Recording({"time": scan.channels["time"], "temperature_roll": Channel("degC", np.zeros(scan.rows))}, {})
    with pytest.raises(RecordingError, match="none of the channels"):
        observe(nothing, observer)
    holes = dict(scan.channels)
    values = scan["command_roll"].copy()
    values[7] = np.nan
    holes["command_roll"] = Channel("A", values)
    with pytest.raises(RecordingError, match="missing in row 7"):
        observe(Recording(holes, scan.metadata), observer)
    with pytest.raises(UnusableInputError, match="frequency responses"):
        design_observer(machine, [], modes=4)
    (tmp_path / "other.npz").write_bytes(b"nothing")
    for read in (read_design, read_estimate):
        with pytest.raises(UnusableInputError, match="not an"):
            read(tmp_path / "other.npz")
        with pytest.raises(UnusableInputError, match="no such file"):
            read(tmp_path / "absent.npz")
    write_design(design, tmp_path / "made.npz")
    with np.load(tmp_path / "made.npz") as file:
        arrays = dict(file)
    for name in (
        "observer_format",
        "axes",
        "sample_rate_Hz",
        "coefficients",
        "directions",
        "chain_axes",
        "chain_points",
        "chain_revolute",
        "chain_gravity_m_s2",
        "sensor_body_end_m",
        "sensor_rotation",
        "source_end_m",
        "effort_limit",
        "noise_command",
        "noise_measurement",
    ):
        np.savez(tmp_path / "changed.npz", **{**arrays, name: np.full((3, 2), "x")})
        with pytest.raises(UnusableInputError, match=r"changed\.npz: .+") as refused:
            read_design(tmp_path / "changed.npz")
        assert len(str(refused.value).splitlines()) == 1, name
    bent = {
        "chain_points": (arrays["chain_points"][:1], r"chain: points has shape \(1, 3\), \(2, 3\) fits"),
        "chain_axes": (2.0 * arrays["chain_axes"], "chain: an axis is not a unit vector"),
        "chain_gravity_m_s2": (np.full(3, np.nan), "chain: a number of gravity_m_s2 is not finite"),
        "source_end_m": (np.zeros(2), "modal model: source_end_m has shape"),
        "sensor_rotation": (arrays["sensor_rotation"][:, :2], "inertial sensor: rotation has shape"),
    }
    for name, (values, line) in bent.items():
        np.savez(tmp_path / "changed.npz", **{**arrays, name: values})
        with pytest.raises(UnusableInputError, match=rf"changed\.npz: {line}"):
            read_design(tmp_path / "changed.npz")
    np.savez(tmp_path / "part.npz", **{name: values for name, values in arrays.items() if name != "notes"})
    with pytest.raises(UnusableInputError, match="the array 'notes' is missing"):
        read_design(tmp_path / "part.npz")
    np.savez(tmp_path / "part.npz", estimate_format=1, values=np.zeros((2, 3)))
    with pytest.raises(UnusableInputError, match="not an EST file: the array time_s is missing"):
        read_estimate(tmp_path / "part.npz")
    with pytest.raises(UnusableInputError, match="geometry"):
        design_observer(load_machine("emps"), emulated_responses_none(), modes=4)
    with pytest.raises(BadAnswerError, match="no further resonance"):
        design_observer(machine, emulated_responses(machine, [{"roll": 0.0}]), modes=9)


def emulated_responses_none() -> list:
    """Any list that is not empty: the geometry is asked first."""
    return [None]


def test_the_command_writes_estimates_and_says_whether_to_believe_them(
    design: ObserverDesign, scan: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from hil.recording import write_recording

    write_recording(scan.part(slice(0, 400)), tmp_path / "scan.mf4")
    write_design(design, tmp_path / "carm.observer.npz")
    arguments = ["observe", "carm", str(tmp_path / "scan.mf4"), "-o", str(tmp_path / "scan.est.npz")]
    with pytest.raises(SystemExit) as left:
        main([*arguments, "--design", str(tmp_path / "carm.observer.npz"), "--json", "-"])
    assert left.value.code == 0
    document = json.loads(capsys.readouterr().out)
    assert document["rows"] == 400
    assert 0.5 < document["mean_nis"] < 1.5
    assert document["alarm_share"] < 0.05
    assert len(read_estimate(tmp_path / "scan.est.npz").time_s) == 400
    for more, word in (
        (["--filter", "pf"], "kf, ekf, ukf"),
        (["--modes", "0"], "'--modes': Input should be greater than or equal to 1"),
        (["--adapt", "7"], "modes 1 to 3"),
        (["--design", "absent.npz"], "no such file"),
    ):
        extra = more if "--design" in more else [*more, "--design", str(tmp_path / "carm.observer.npz")]
        with pytest.raises(SystemExit) as left:
            main([*arguments, *extra])
        error = capsys.readouterr().err
        assert left.value.code == 2
        assert word in error
        assert len(error.strip().splitlines()) == 1


@pytest.mark.slow
def test_the_command_designs_from_multisines_and_standing_records(
    machine: Machine, scan: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from controllers.excitation_lines import Band
    from hil.experiments import Multisine
    from hil.recording import write_recording

    plans = Multisine(pose={"roll": 0.2}, lines=Band(1.0, 30.0), period_s=10.0, periods=2, jog=None).plans(machine)
    simulator, names = Simulator(machine), []
    for i, plan in enumerate(plans):
        names.append(tmp_path / f"roll_{i}.mf4")
        write_recording(emulated_recording(machine, plan, 90 + i, simulator), names[-1])
    write_recording(emulated_recording(machine, Static(2.0, {"roll": 0.2}).plans(machine)[0], 95, simulator), tmp_path / "still.mf4")
    write_recording(scan.part(slice(0, 256)), tmp_path / "scan.mf4")
    arguments = ["observe", "carm", str(tmp_path / "scan.mf4"), "-o", str(tmp_path / "scan.est.npz"), "--modes", "3", "--filter", "ekf"]
    with pytest.raises(SystemExit) as left:
        main(
            [
                *arguments,
                *("--multisine", str(names[0]), "--multisine", str(names[1]), "--standing", str(tmp_path / "still.mf4")),
                *("--save-design", str(tmp_path / "made.npz"), "--figure", str(tmp_path / "scan.png")),
                *("--page", str(tmp_path / "scan.html")),
            ]
        )
    said = capsys.readouterr()
    assert left.value.code == 0, said.err
    assert (tmp_path / "scan.png").stat().st_size > 10_000
    assert "1 poses" in said.out
    assert "The detector was off by up to" in page_verdict(tmp_path / "scan.html")
    assert "tuned on the recording itself" in page_text(tmp_path / "scan.html")
    assert "tuned on the recording itself" in said.out
    assert read_design(tmp_path / "made.npz").model.frequencies_Hz(np.array([0.0, 0.2]))[1] == pytest.approx(14.04, rel=0.01)
