"""isocenter calibrate chain: from Table 2.1 to poses of Table 2.2, by files alone."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from chains import IDENTIFIED, JOINTS, NOMINAL, poses
from scipy.spatial.transform import Rotation

from hil.calibration.kinematic.chain_file import read_chain, write_chain
from hil.cli import main


def isocenter(*arguments: Path | str) -> int:
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    assert isinstance(left.value.code, int)
    return left.value.code


def write_poses(path: Path, count: int, seed: int) -> None:
    angles, position, rotation = poses((1, 2, 3, 4), count, seed)
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(
            ["j1 [deg]", *(f"{joint} [rad]" for joint in JOINTS[1:]), "x [m]", "y [m]", "z [m]", "rx [rad]", "ry [rad]", "rz [rad]"]
        )
        turned = Rotation.from_matrix(rotation).as_rotvec()
        rows.writerows([np.degrees(q[0]), *q[1:], *place, *turn] for q, place, turn in zip(angles.tolist(), position, turned, strict=True))


@pytest.fixture
def files(tmp_path: Path) -> Path:
    write_chain(NOMINAL, tmp_path / "arm.toml")
    write_poses(tmp_path / "poses.csv", 400, 31)
    write_poses(tmp_path / "others.csv", 100, 32)
    return tmp_path


def test_the_fitted_chain_tells_poses_of_the_machine_it_was_not_fitted_to(files: Path) -> None:
    out = files / "fitted.toml"
    options: list[Path | str] = ["--held-out", files / "others.csv", "--json", files / "said.json"]
    assert isocenter("calibrate", "chain", files / "arm.toml", files / "poses.csv", "-o", out, *options) == 0
    said = json.loads((files / "said.json").read_text())
    angles = poses((1, 2, 3, 4), 200, seed=33)[0]
    model, true = read_chain(out).poses(angles)[0], IDENTIFIED.poses(angles)[0]
    assert np.sqrt(np.mean(np.sum((model - true) ** 2, axis=1))) < 0.03e-3
    held = said["poses"]["others.csv"]
    assert held["nominal"]["position_rms_m"] > 5e-3
    assert held["fitted"]["position_rms_m"] == pytest.approx(np.sqrt(3.0) * 0.05e-3, rel=0.15)  # the noise of a pose
    assert said["misfit"] == pytest.approx(1.0, abs=0.05)
    assert said["rank"] == 24
    assert abs(said["parameters"]["beta_j4"] - 0.9876) < 4.0 * said["deviations"]["beta_j4"]


def test_a_chain_reads_back_equal(files: Path) -> None:
    write_chain(IDENTIFIED, files / "a.toml")
    back = read_chain(files / "a.toml")
    assert back.joints == JOINTS
    np.testing.assert_array_equal(back.values, IDENTIFIED.values)


@pytest.mark.parametrize(
    ("old", "new", "options", "line"),
    [
        ("alpha_rad", "alpha", [], "arm.toml: joint 1: unknown key alpha; there are name, a_m"),
        ('name = "j2"', 'name = "j1"', [], "joint 2: name = 'j1': must be a text of its own"),
        ('name = "j2"', 'name = "elbow"', [], "poses.csv: column elbow [rad] or elbow [deg] is missing; there are j1 [deg], j2 [rad]"),
        ("", "", ["--freeze", "d_j9"], "unknown parameters d_j9"),
        ("", "", ["--angle-noise", "0"], "--position-noise, --angle-noise: must be positive numbers"),
    ],
)
def test_what_cannot_be_used_is_one_line(
    files: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, options: list[str], line: str
) -> None:
    path = files / "arm.toml"
    path.write_text(path.read_text().replace(old, new, 1) if old else path.read_text())
    assert isocenter("calibrate", "chain", path, files / "poses.csv", "-o", files / "x.toml", *options) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not (files / "x.toml").exists()
