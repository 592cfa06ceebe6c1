"""isocenter calibrate model and scan: tables of a machine that is off its drawing (poses by MuJoCo) become a model that predicts others."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import isocenter
from flexible_machine import OFF, Statics, machine_file
from page_text import page_text, page_verdict

from hil.calibration.kinematic.geometric_model import read_calibration
from hil.calibration.use.lookup_table import LookUp, read_look_up, write_look_up
from hil.experiments import read_experiment
from hil.imaging import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.machine import load_machine, machine_from_text

NOISE = np.repeat([0.1e-3, 0.05e-3, 0.2e-3], 3)
CARM = load_machine("carm")


def sweep(axis: str, low: int, high: int, other: int, count: int = 40) -> np.ndarray:
    positions = np.full((count, 2), np.radians(other))
    positions[:, CARM.axes.index(axis)] = np.radians(np.linspace(low, high, count))
    return positions


def true_deviation(positions: np.ndarray) -> np.ndarray:
    """Of the machine that is off its drawing, from the nominal geometry."""
    machine = machine_from_text(machine_file(OFF), label="off")
    statics = Statics(machine, held=("propeller_gear", "roll_gear"))
    frames = [statics(row) for row in positions]
    panel, tube = (np.array([pair[k] for pair in frames]) for k in (0, 1))
    beam = ConeBeam.from_frames(tube[:, :3, 3], panel[:, :3, 3], panel[:, :3, :3])
    return beam.deviation_from(nominal_beam(CARM, positions))


def table(positions: np.ndarray, path: Path, seed: int, six: bool = False, **notes: object) -> Path:
    sigma = NOISE * np.repeat([0.0 if six else 1.0, 1.0, 1.0], 3)
    deviation = true_deviation(positions) + np.random.default_rng(seed).normal(0.0, 1.0, (len(positions), 9)) * sigma
    covariance = np.tile(np.diag(sigma**2), (len(positions), 1, 1))
    write_look_up(LookUp(CARM.axes, positions, deviation, covariance, {"machine": "carm", "six": six, **notes}), path)
    return path


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    table(sweep("roll", -85, 85, 0), folder / "roll.npz", 1)
    table(sweep("propeller", -105, 105, 0), folder / "propeller.npz", 2)
    table(sweep("roll", -80, 80, -40), folder / "other.npz", 3)
    return folder


@pytest.mark.slow
def test_two_sweeps_predict_poses_of_other_scans_within_the_covariance(tables: Path, tmp_path: Path) -> None:
    scans = [tables / "roll.npz", tables / "propeller.npz"]
    written = ["-o", tmp_path / "m.npz", "--json", tmp_path / "m.json", "--figure", tmp_path / "m.png"]
    written += ["--page", tmp_path / "m.html"]
    assert isocenter("calibrate", "model", "carm", *scans, "--held-out", tables / "other.npz", *written) == 0
    assert page_verdict(tmp_path / "m.html").startswith("✓ The model puts the isocentre of held-out scans right to ")
    assert "other.npz (held out)" in page_text(tmp_path / "m.html")
    model = read_calibration(tmp_path / "m.npz", CARM)
    positions = np.random.default_rng(4).uniform([-1.8, -1.4], [1.8, 1.4], (40, 2))
    true = true_deviation(positions)
    nominal = nominal_beam(CARM, positions)
    error = nominal.moved(true).deviation_from(nominal.moved(model.at(positions)))
    sigma = np.sqrt(np.diagonal(model.covariance_at(positions), axis1=1, axis2=2))
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 1.6
    assert np.sqrt(np.mean(np.sum(error[:, 3:6] ** 2, axis=1))) < 0.05e-3  # of 4 mm
    assert isocenter("geometry", "at", "carm", tmp_path / "m.npz", "--pose", "propeller=30,roll=-20", "--json", tmp_path / "at.json") == 0
    told = json.loads((tmp_path / "at.json").read_text())
    there = np.radians([[30.0, -20.0]])
    np.testing.assert_allclose(list(told["deviation"].values()), model.at(there)[0], atol=1e-12)
    np.testing.assert_allclose(
        list(told["parameters"].values()), nominal_beam(CARM, there).moved(model.at(there)).parameters[0], atol=1e-12
    )
    answer = json.loads((tmp_path / "m.json").read_text())
    judged = answer["scans"][str(tables / "other.npz")]
    assert judged["held_out"]
    assert judged["model"]["position_m"] < 0.12e-3 < 2e-3 < judged["nominal"]["position_m"]
    stiffness = 1.0 / answer["parameters"]["compliance_detector_mount"]["value"]
    assert stiffness == pytest.approx(0.85e4, rel=0.05)
    assert answer["frozen"] == ["beta_panel", "beta_phantom"]
    assert answer["chi2"] == pytest.approx(1.0, abs=0.15)
    assert (tmp_path / "m.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_panel_s_clock_that_lags_and_a_phantom_that_was_moved_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    there = np.concatenate([sweep("roll", -85, 85, 0, 30), sweep("roll", 85, -85, 0, 30), sweep("propeller", -100, 100, 30, 30)])
    truth = table(there, tmp_path / "all.npz", 8)
    assert isocenter("calibrate", "model", "carm", truth, "-o", tmp_path / "m.npz") == 0
    said = capsys.readouterr().out
    assert "panel's clock" not in said
    assert "do not fit" not in said
    late = read_look_up(truth)
    lag = 0.02  # of a period: the images show poses a little further on than the positions beside them
    nominal = nominal_beam(CARM, there - lag * np.gradient(there, axis=0))
    late = replace(
        late,
        positions=there - lag * np.gradient(there, axis=0),
        deviation=nominal_beam(CARM, there).moved(late.deviation).deviation_from(nominal),
    )
    write_look_up(late, tmp_path / "late.npz")
    assert isocenter("calibrate", "model", "carm", tmp_path / "late.npz", "-o", tmp_path / "m.npz", "--json", tmp_path / "m.json") == 0
    assert "later than their positions say: do the panel's clock and the loop's agree?" in capsys.readouterr().out
    found = json.loads((tmp_path / "m.json").read_text())["clock_lag_periods"]
    assert abs(found["value"] - lag) < 5.0 * found["sigma"]
    assert found["sigma"] < 0.2 * lag
    moved = read_look_up(truth)
    moved.deviation[60:, 3:6] += 2e-3
    write_look_up(moved, tmp_path / "moved.npz")
    assert isocenter("calibrate", "model", "carm", tmp_path / "moved.npz", "-o", tmp_path / "m.npz") == 0
    assert "was the phantom moved between scans" in capsys.readouterr().out


def test_six_parameters_hold_the_source_and_say_so(tables: Path, tmp_path: Path) -> None:
    scans = [
        table(sweep("roll", -85, 85, 0), tmp_path / "r.npz", 5, six=True),
        table(sweep("propeller", -105, 105, 0), tmp_path / "p.npz", 6, six=True),
    ]
    assert isocenter("calibrate", "model", "carm", *scans, "-o", tmp_path / "m.npz", "--json", tmp_path / "m.json") == 0
    answer = json.loads((tmp_path / "m.json").read_text())
    assert {"source_u", "source_v", "source_w"} <= set(answer["frozen"])
    assert isocenter("calibrate", "model", "carm", scans[0], tables / "roll.npz", "-o", tmp_path / "x.npz") == 2


@pytest.mark.parametrize(
    ("more", "line"),
    [
        (["--need", "beta_propeller"], "beta_propeller: these scans cannot show it"),
        (["--need", "d_roll"], "d_roll: these scans cannot tell it from others: "),
        (["--need", "beta_elbow"], "beta_elbow: no such parameter; carm has a_panel"),
        (["--freeze", "rubbish"], "rubbish: no such parameter"),
        (["--figure", "no/such.png"], "there is no folder no"),
    ],
)
def test_what_one_sweep_cannot_show_is_one_line(
    tables: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], line: str
) -> None:
    assert isocenter("calibrate", "model", "carm", tables / "roll.npz", "-o", tmp_path / "m.npz", *more) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not (tmp_path / "m.npz").exists()


def _spoilt(table: Path, folder: Path) -> dict[str, str]:
    """Files like a table that are none, and what is said of each."""
    (folder / "junk.npz").write_bytes(b"junk")
    (folder / "cut.npz").write_bytes(table.read_bytes()[:-200])
    with (folder / "one_array.npz").open("wb") as file:
        np.save(file, np.zeros(3))
    with np.load(table) as file:
        arrays = dict(file)
    np.savez(folder / "short.npz", **{**arrays, "deviation": arrays["deviation"][:5]})
    np.savez(folder / "no_axes.npz", **{name: value for name, value in arrays.items() if name != "axes"})
    return {
        "junk.npz": "not a look-up table",
        "cut.npz": "not a look-up table",
        "one_array.npz": "not a look-up table",
        "short.npz": "arrays do not belong together",
        "no_axes.npz": "'axes'",
    }


def test_files_that_are_no_calibration_of_this_machine_are_one_line(
    tables: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = table(sweep("roll", -85, 85, 0, 3), tmp_path / "few.npz", 7)
    assert isocenter("calibrate", "model", "carm", other, "-o", tmp_path / "m.npz") == 2
    assert "3 exposures give 27 equations for" in capsys.readouterr().err
    for name, line in _spoilt(tables / "roll.npz", tmp_path).items():
        assert isocenter("calibrate", "model", "carm", tmp_path / name, "-o", tmp_path / "m.npz") == 2
        error = capsys.readouterr().err
        assert name in error
        assert line in error
        assert error.count("\n") == 1
        assert isocenter("geometry", "at", "carm", tmp_path / name) == 2
        error = capsys.readouterr().err
        assert name in error
        assert error.count("\n") == 1
    assert isocenter("calibrate", "model", "emps", tables / "roll.npz", "-o", tmp_path / "m.npz") == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_the_proposed_scan_runs_and_shows_more_than_one_sweep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert isocenter("calibrate", "scan", "carm", "--sweeps", "3", "-o", tmp_path / "c.toml", "--json", tmp_path / "c.json") == 0
    answer = json.loads((tmp_path / "c.json").read_text())
    plan = read_experiment(tmp_path / "c.toml", CARM).plans(CARM)[0]
    assert plan.rows / 256.0 == answer["seconds"]
    assert (np.ptp(plan.reference, axis=0) > 2.5).all()
    assert isocenter("calibrate", "scan", "carm", "--sweeps", "1", "-o", tmp_path / "one.toml", "--json", tmp_path / "one.json") == 0
    one = json.loads((tmp_path / "one.json").read_text())
    assert one["rank"] < answer["rank"]
    assert one["position_sigma_m"] > 10.0 * answer["position_sigma_m"]
    assert len({"beta_roll", "beta_propeller"} & set(one["frozen"])) == 1  # of the axis that stands still in it
    assert isocenter("calibrate", "scan", "emps", "-o", tmp_path / "x.toml") == 2
    assert "emps: its file has no [geometry]" in capsys.readouterr().err
