"""Claims: a run calibrates itself along with its images, and its recording replays it bit for bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.calibration.data_driven.data_file import read_data_file, write_data_file
from hil.calibration.data_driven.observed_beam import ObservedBeam
from hil.calibration.data_driven.quasi_static import QuasiStatic
from hil.calibration.data_driven.values import Calibration, Parameters
from hil.cli import main
from hil.emulated.beam import SPOT
from hil.emulated.images import true_beam, xray_side
from hil.imaging.geometry import DEVIATIONS
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine
from hil.observing import ObserverDesign, write_design
from hil.recording import read_recording


def isocenter(*arguments: object) -> int:
    """Exit status of a command."""
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


@pytest.fixture(scope="module")
def files(machine: Machine, design: ObserverDesign, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An observer's design, and a calibration that knows next to nothing but that there was an observer."""
    folder: Path = tmp_path_factory.mktemp("live")
    write_design(design, folder / "observer.npz")
    model, nothing = QuasiStatic.of(machine), np.zeros((2, 9))
    observed = ObservedBeam(np.arange(2.0), np.zeros((2, 2)), nothing, np.zeros((2, 3)), np.zeros(6), np.full((4, 9), 1e-12))
    known = Parameters(np.full(len(model.names), 1e-9), Parameters.unknown(model).covariance)
    write_data_file(model, observed, Calibration(nothing, nothing, np.zeros((2, 9, 9)), known), folder / "start.npz")
    return folder


SWEEP = ["scan", "--axis", "roll", "--from", "-3", "--to", "3", "--speed", "10", "--dwell", "0.4"]


def run(folder: Path, name: str, scene: str, experiment: list[str]) -> int:
    """One run with a live calibration."""
    live = ["--observer", folder / "observer.npz", "--data", folder / "start.npz", "--images", folder / name, "--scene", scene]
    kept = ["-o", folder / f"{name}.mf4", "--truth", folder / f"{name}.csv"]
    return isocenter("run", *experiment, "-m", "carm", "-b", "lockstep:", *live, "--image-rate", "4.3", "--seed", "3", *kept)


@pytest.mark.nightly
def test_a_run_knows_its_geometry_row_by_row_and_its_recording_replays_it(
    machine: Machine, files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(files, "phantom", "dodecahedron", SWEEP) == 0
    assert "seen live" in capsys.readouterr().out
    recording = read_recording(files / "phantom.mf4")
    images, deviation = recording["deviation_images"], recording.matrix([f"deviation_{name}" for name in DEVIATIONS])
    assert images[0] == 0
    assert images[-1] >= 3
    assert (np.diff(images) >= 0).all()
    first = 0.1 + 2 / 4.3 + 0.008 + 0.2  # the third exposure's image: the panel's clock is known
    assert np.flatnonzero(images)[0] == int(np.ceil(first * machine.sample_rate_Hz))
    assert np.abs(deviation[:100, 3:6]).max() < 1e-4
    assert recording["deviation_phantom_u_variance"][50] > 1e-6
    side = xray_side(machine, files / "phantom.csv", SPOT, 0.1)
    rows = np.arange(int(np.flatnonzero(images)[0]), recording.rows - 10, 10)
    true = true_beam(side, recording.time[rows], np.zeros(len(rows)))
    nominal = nominal_beam(machine, recording.matrix([f"estimate_link_position_{axis}" for axis in machine.axes])[rows])
    error = nominal.moved(deviation[rows]).deviation_from(true)
    sigma = np.sqrt(recording.matrix([f"deviation_{name}_variance" for name in DEVIATIONS])[rows])
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 1.5
    assert sigma[:, 3:6].max() < 0.2e-3
    assert np.linalg.norm(error[-1, 3:6]) < 0.15 * np.linalg.norm(nominal.deviation_from(true)[-1, 3:6])
    replay = ["--design", files / "observer.npz", "--data", files / "start.npz", "--images", files / "phantom"]
    assert isocenter("observe", "carm", files / "phantom.mf4", "-o", files / "again.npz", *replay) == 0
    assert "live estimates in the recording: the same" in capsys.readouterr().out
    assert isocenter("observe", "carm", files / "phantom.mf4", "-o", files / "other.npz", *replay[:2]) == 0
    assert "a calibration ran along, which levels what the observer reads; give --data and --images as well" in capsys.readouterr().out
    geometry = read_data_file(files / "phantom" / "geometry.npz")
    assert np.array_equal(geometry.live, deviation)
    assert len(geometry.beam(machine, recording.time[rows])) == len(rows)


@pytest.mark.nightly
def test_marker_plates_are_taken_in_too(files: Path) -> None:
    assert run(files, "plate", "clinical", ["static", "--seconds", "0.9"]) == 0
    recording = read_recording(files / "plate.mf4")
    assert recording["deviation_images"][-1] == 3
    variance, length = recording["deviation_rotation_u_variance"], recording["deviation_source_w_variance"]
    assert variance[-1] == pytest.approx(variance[50], rel=0.5)  # where tube and panel stand to the patient a plate does not tell
    assert length[-1] < 0.5 * length[50]
