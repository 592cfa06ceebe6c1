"""isocenter lpv: modes over poses from files of responses, held against a loop whose modes are known at every pose."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.signal
from simulated_loop import SAMPLE_RATE_HZ, experiment, plant_response, two_mode_loop

from hil.cli import main
from hil.identification import FrequencyResponse, periodic_records, read_frf, robust_bla, write_frf

PERIOD, SETTLE, LINES = 512, 4, np.arange(5, 160)
POSES = np.linspace(-1.0, 1.0, 7)


def frequencies_Hz(pose: float) -> tuple[float, float]:
    return 3.0 + 0.5 * pose**2, 7.0 + 0.2 * pose


def measured(pose: float, rng: np.random.Generator) -> FrequencyResponse:
    loop, noise = two_mode_loop(frequencies_Hz=frequencies_Hz(pose)), (0.05, 0.005, 0.005)
    data = experiment(loop, rng, realisations=3, periods=4, settle_periods=SETTLE, period=PERIOD, lines=LINES, noise=noise)
    records = periodic_records(
        **data,
        period_samples=PERIOD,
        sample_rate_Hz=SAMPLE_RATE_HZ,
        settle_periods=SETTLE,
        output_names=("imu_x", "position_propeller", "position_roll"),
        input_names=("command_propeller", "command_roll"),
        pose=(0.0, pose),
    )
    return robust_bla(records)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, rng = tmp_path_factory.mktemp("lpv"), np.random.default_rng(50)
    for number, pose in enumerate(POSES):
        write_frf(measured(float(pose), rng), folder / f"p{number}.frf.npz")
    return folder


def isocenter(*arguments: Path | str) -> int:
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    assert isinstance(left.value.code, int)
    return left.value.code


def test_modes_and_state_space_at_poses_between_are_those_of_the_machine(folder: Path, tmp_path: Path) -> None:
    files = sorted(folder.glob("*.npz"))
    figures = [tmp_path / name for name in ("modes.png", "surface.png", "variances.png")]
    between = np.array([-0.75, 0.25])
    options: list[Path | str] = [
        "--figure",
        figures[0],
        "--surface",
        figures[1],
        "--variances",
        figures[2],
        "--json",
        tmp_path / "model.json",
    ]
    assert isocenter("lpv", *reversed(files), "--at", ",".join(map(str, np.degrees(between))), *options) == 0
    answer = json.loads((tmp_path / "model.json").read_text())
    assert answer["pose_range"] == pytest.approx([-1.0, 1.0])
    for pose, found in zip(between, answer["poses"], strict=True):
        np.testing.assert_allclose(found["natural_frequency_Hz"], frequencies_Hz(pose), rtol=3e-3)
        np.testing.assert_allclose(found["damping"], (0.03, 0.02), rtol=0.1)
        # the state space, held from sample to sample and a tick late, is the loop's own response
        matrices = tuple(np.array(found[name]) for name in "ABCD")
        a, b, c, d, _ = scipy.signal.cont2discrete(matrices, 1.0 / SAMPLE_RATE_HZ)
        lines = np.array([2.0, 5.0, 9.0])
        truth = plant_response(two_mode_loop(frequencies_Hz=frequencies_Hz(pose)), lines)
        for line, expected in zip(lines, truth, strict=True):
            z = np.exp(2j * np.pi * line / SAMPLE_RATE_HZ)
            got = (c @ np.linalg.solve(z * np.eye(len(a)) - a, b) + d) / z
            assert np.abs(got - expected).max() < 0.02 * np.abs(expected).max()
    assert all(figure.stat().st_size > 10_000 for figure in figures)


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        ([(0.0, 0.0), (0.0, 0.0)], "no axis varies between the responses' poses"),
        ([(0.0, 0.0), (0.5, 0.5)], "2 poses: a model over two axes takes six or more"),
        ([(0.0, 0.0), (0.0, 0.5)], "2 poses: a model over the pose takes three or more"),
        ([(), ()], "the responses carry no poses"),
    ],
)
def test_poses_that_make_no_model_are_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], poses: list[tuple[float, ...]], message: str
) -> None:
    response = read_frf(folder / "p0.frf.npz")
    for number, pose in enumerate(poses):
        write_frf(replace(response, pose=pose), tmp_path / f"{number}.npz")
    assert isocenter("lpv", tmp_path / "0.npz", tmp_path / "1.npz") == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
