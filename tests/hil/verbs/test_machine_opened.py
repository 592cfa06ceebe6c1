"""A machine opened: experiments on it, effects added to it, its linear parts; refusals name what would be right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import hil

LOCKSTEP = "lockstep:"


@pytest.fixture(scope="module")
def turntable() -> hil.OpenMachine:
    return hil.open_machine("turntable")


@pytest.fixture(scope="module")
def still(turntable: hil.OpenMachine) -> hil.Recording:
    return turntable.run(hil.Static(1.0), bus=LOCKSTEP)


def test_a_run_without_a_file_leaves_none(turntable: hil.OpenMachine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert turntable.run(hil.Static(0.5), bus=LOCKSTEP).rows == 100
    assert list(tmp_path.iterdir()) == []


def test_a_kept_run_is_what_was_returned_and_an_earlier_one_is_moved_aside(
    turntable: hil.OpenMachine, still: hil.Recording, tmp_path: Path
) -> None:
    out = tmp_path / "still.mf4"
    (tmp_path / "still.mf4").write_bytes(b"earlier")
    kept = turntable.run(hil.Static(1.0), bus=LOCKSTEP, out=out)
    read = hil.read_recording(out)
    assert (tmp_path / "still.earlier1.mf4").read_bytes() == b"earlier"
    assert all(np.array_equal(kept[name], read[name], equal_nan=True) for name in kept.channels)
    assert np.array_equal(kept["position_turn"], still["position_turn"])  # the same seed


def test_a_multisine_makes_recordings_in_order(turntable: hil.OpenMachine) -> None:
    rows: list[tuple[int, int]] = []
    experiment = hil.Multisine(period_s=4.0, periods=1, realisations=2, jog=hil.Jog(line=1))
    found = turntable.run(experiment, bus=LOCKSTEP, progress=lambda done, total: rows.append((done, total)))
    assert found.names == ("run_r1_e1", "run_r2_e1")
    assert [each.experiment["realisation"] for each in found] == [0, 1]
    assert found[1:].names == ("run_r2_e1",)
    assert rows[-1] == (3200, 3200)
    frame = found.frame()
    assert list(frame.index.names) == ["recording", "time"]
    assert np.array_equal(frame.loc["run_r2_e1", "position_turn"], found[1]["position_turn"])
    with pytest.raises(hil.RecordingError, match=r"2 recordings \(run_r1_e1, run_r2_e1\): give one"):
        hil.compare(found, found)
    frf = hil.identify(found)
    omega = 2.0 * np.pi * frf.frequencies_Hz
    assert frf.control.dt == 1 / 200
    assert np.allclose(frf.control(1j * omega), np.moveaxis(frf.G, 0, -1))


def test_a_frame_has_the_channels_over_time_and_makes_the_same_recording(turntable: hil.OpenMachine, still: hil.Recording) -> None:
    frame = still.frame()
    assert frame.index.name == "time"
    assert frame.attrs["units"]["current_turn"] == "A"
    degrees = frame.assign(position_turn=np.degrees(frame["position_turn"]))
    again = hil.recording_from_frame(degrees, turntable, {"position_turn": "deg"})
    assert np.allclose(again["position_turn"], still["position_turn"], rtol=0.0, atol=1e-15)
    assert again.channel("position_turn").unit == "rad"
    assert again.machine_hash == turntable.hash


def test_an_effect_changes_what_is_there_and_its_simulation_alike(turntable: hil.OpenMachine) -> None:
    loaded = turntable.with_effect("viscous_friction", at="turn", Fv_Nm_s_rad=8.0)
    jog = hil.JogOnly(jog=hil.Jog(line=1), period_s=8.0, periods=1)
    recorded = turntable.run(jog, bus=LOCKSTEP, emulated=loaded)
    assert recorded.machine_hash == turntable.hash
    without, with_it = (hil.compare(recorded, hil.simulate(machine, recorded))["command_turn"] for machine in (turntable, loaded))
    assert with_it.rms < 0.3 * without.rms


def test_an_effect_that_is_not_there_is_refused_with_what_there_is(turntable: hil.OpenMachine) -> None:
    with pytest.raises(hil.MachineFileError, match="did you mean coulomb_friction"):
        turntable.with_effect("coulomb_frction", at="turn", Fc_Nm=1.0)
    with pytest.raises(hil.MachineFileError, match="it takes Fc_Nm"):
        turntable.with_effect("coulomb_friction", at="turn", Fc=1.0)


def test_the_controller_is_the_machine_files_filter(turntable: hil.OpenMachine) -> None:
    z = np.exp(2j * np.pi * np.array([0.3, 3.0, 30.0]) / 200.0)
    _, wanted = signal.sosfreqz(turntable.controllers[0].position_sections, worN=np.angle(z))
    assert np.allclose(turntable.controller("turn")(z), wanted)
    with pytest.raises(hil.UnusableInputError, match="turntable has a controller of turn"):
        turntable.controller("roll")


def test_the_plant_at_a_pose_turns_by_its_inertia_and_damping(turntable: hil.OpenMachine) -> None:
    """The table of 7 kg m^2 and 0.6 of the rotor behind the gear, damped by 23 Nm s: a closed form."""
    plant = turntable.plant_at({"turn": 0.3})
    s = 2j * np.pi * 2.0
    torque_per_ampere = 0.095 * 100.0
    inertia = 7.0 + 6.0e-5 * 100.0**2
    response = plant[plant.output_labels.index("position_turn"), 0](s)
    assert response == pytest.approx(torque_per_ampere / (inertia * s**2 + 23.0 * s), rel=1e-9)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"bus": "udp:", "truth": "t.csv"}, "truth: only a run on lockstep: emulates"),
        ({"bus": LOCKSTEP, "emulated": "carm"}, "carm has propeller, roll at 256 Hz, turntable has turn at 200 Hz"),
        ({"bus": LOCKSTEP, "out": "a.txt"}, "a.txt"),
        ({"bus": "nowhere:0"}, "nowhere"),
    ],
)
def test_a_run_that_cannot_be_is_refused_in_one_line(turntable: hil.OpenMachine, options: dict[str, str], said: str) -> None:
    given = {name: hil.open_machine(value) if name == "emulated" else value for name, value in options.items()}
    with pytest.raises(hil.UnusableInputError, match=said) as refused:
        turntable.run(hil.Static(1.0), **given)  # type: ignore[arg-type]
    assert "\n" not in str(refused.value)


def test_what_was_recorded_before_a_fault_is_kept(turntable: hil.OpenMachine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "scratch"))
    (tmp_path / "scratch").mkdir()
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\nname = "drive_hangs"\nat = "turn_drive"\nwhen = "position_turn > 0.02"\n')
    with pytest.raises(hil.LoopAbortedError, match="no position") as stopped:
        turntable.run(hil.JogOnly(jog=hil.Jog(line=1), period_s=8.0, periods=1), bus=LOCKSTEP, faults=faults)
    (folder,) = (tmp_path / "scratch").iterdir()
    assert str(folder) in stopped.value.__notes__[-1]
    assert 0 < hil.read_recording(folder / "run.mf4").rows < 3200


def test_home_and_move_in_lockstep(turntable: hil.OpenMachine) -> None:
    assert any("homed" in line for line in turntable.home(LOCKSTEP))
    assert turntable.move({"turn": 0.2}, LOCKSTEP)["turn"] == pytest.approx(0.2, abs=1e-3)
    with pytest.raises(hil.UnusableInputError, match="roll: turntable has turn"):
        turntable.move({"roll": 0.2}, LOCKSTEP)
