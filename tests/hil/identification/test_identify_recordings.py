"""Claims about going from recordings to a frequency response, its file, and its figure."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, experiment, plant_response, two_mode_loop

from hil.errors import UnusableInputError
from hil.figures.frf import frf_figure
from hil.figures.frf_over_poses import surface_figure, variance_figure
from hil.identification import IdentificationError, PoseModel, identify, identify_poses, read_frf, write_frf
from hil.recording.recording import Channel, Recording

PERIOD, SETTLE, LINES = 256, 6, np.arange(1, 100, 2)
AXES = ("propeller", "roll")


def recordings(
    seed: int = 1,
    realisations: int = 3,
    periods: int = 4,
    pose: tuple[float, float] = (0.0, 0.5),
    noise: tuple[float, float, float] = (0.1, 0.01, 0.01),
) -> list[Recording]:
    data = experiment(
        two_mode_loop(),
        np.random.default_rng(seed),
        realisations=realisations,
        periods=periods,
        settle_periods=SETTLE,
        lines=LINES,
        noise=noise,
    )
    made = []
    for m in range(realisations):
        for e in range(2):
            y, u, w = (data[kind][m, e] for kind in ("outputs", "inputs", "excitation"))
            columns = {"time": ("s", np.arange(len(y)) / SAMPLE_RATE_HZ), "imu_x": ("m/s^2", y[:, 0])}
            for i, axis in enumerate(AXES):
                columns |= {
                    f"excitation_{axis}": ("A", w[:, i]),
                    f"command_{axis}": ("A", u[:, i]),
                    f"position_{axis}": ("rad", y[:, 1 + i]),
                    f"current_{axis}": ("A", np.concatenate(([0.0], u[:-1, i]))),  # the drive applies command k one tick later
                }
            details = {
                "kind": "multisine",
                "period_samples": PERIOD,
                "settle_periods": SETTLE,
                "periods": periods,
                "realisation": m,
                "experiment": e,
                "excited_lines": LINES.tolist(),
                "start_pose": list(pose),
            }
            made.append(Recording({name: Channel(unit, values) for name, (unit, values) in columns.items()}, {"experiment": details}))
    return made


def altered(
    recording: Recording, rows: np.ndarray | slice = slice(None), channels: dict[str, Channel] | None = None, **details: int | list[float]
) -> Recording:
    kept = {name: Channel(channel.unit, channel.values[rows]) for name, channel in recording.channels.items()}
    return Recording({**kept, **(channels or {})}, {"experiment": {**recording.experiment, **details}})


@pytest.fixture(scope="module")
def made() -> list[Recording]:
    return recordings()


def test_the_response_runs_from_the_command_and_counts_the_tick_it_waits(made: list[Recording]) -> None:
    response = identify(made)
    truth = plant_response(two_mode_loop(), response.frequencies_Hz)
    assert response.output_names == ("imu_x", "position_propeller", "position_roll")
    assert response.input_names == ("command_propeller", "command_roll")
    assert response.input_units == ("A", "A")
    assert response.pose == (0.0, 0.5)
    assert np.mean(np.abs(response.G - truth) <= response.bound(0.95, "noise")) == pytest.approx(0.95, abs=0.05)


def test_from_the_measured_current_the_tick_is_absent() -> None:
    response = identify(recordings(noise=(0.0, 0.0, 0.0)), plant_input="measured")
    ahead = np.exp(2j * np.pi * response.frequencies_Hz / SAMPLE_RATE_HZ)[:, None, None]
    np.testing.assert_allclose(response.G, ahead * plant_response(two_mode_loop(), response.frequencies_Hz), rtol=1e-2)


def test_the_order_of_the_recordings_does_not_matter(made: list[Recording]) -> None:
    np.testing.assert_array_equal(identify(made).G, identify(made[::-1]).G)


def test_one_axis_alone_is_identified_with_the_other_loop_closed(made: list[Recording]) -> None:
    single = [
        altered(r, channels={"excitation_roll": Channel("A", np.zeros(r.rows))})
        for r in recordings(seed=2)
        if r.experiment["experiment"] == 0
    ]
    response = identify(single)
    assert response.input_names == ("command_propeller",)
    assert "roll not excited" in " ".join(response.notes)


def test_lost_rows_cost_their_period_only(made: list[Recording]) -> None:
    gap = np.r_[0 : (SETTLE + 1) * PERIOD + 20, (SETTLE + 1) * PERIOD + 25 : made[0].rows]
    response = identify([altered(made[0], rows=gap), *made[1:]])
    assert "1 of 24 periods have missing samples" in " ".join(response.notes)
    truth = plant_response(two_mode_loop(), response.frequencies_Hz)
    assert np.mean(np.abs(response.G - truth) <= response.bound(0.95, "noise")) == pytest.approx(0.95, abs=0.05)


def test_a_recording_cut_short_shortens_all_and_says_so(made: list[Recording]) -> None:
    response = identify([altered(made[0], rows=slice(0, (SETTLE + 3) * PERIOD + 100)), *made[1:]])
    assert response.settings["periods"] == 3
    assert "differ in length" in " ".join(response.notes)


def test_a_saturated_command_is_said(made: list[Recording]) -> None:
    clipped = Channel("A", np.clip(made[0]["command_roll"], -5.0, 5.0))
    response = identify([altered(made[0], channels={"command_roll": clipped}), *made[1:]])
    assert "command_roll saturates in 1 of 6 recordings" in " ".join(response.notes)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: [altered(r[0], period_samples=128), *r[1:]], "do not belong together: period_samples is 128 and 256"),
        (lambda r: [altered(r[0], start_pose=[0.0, 0.0]), *r[1:]], "do not belong together: start_pose"),
        (lambda r: [r[0], *r], "both realisation 0, experiment 0"),
        (lambda r: r[1:], "realisation 0 lacks experiment 0"),
        (lambda r: [Recording(x.channels, {}) for x in r], "not periodic"),
        (
            lambda r: [altered(x, channels={f"excitation_{a}": Channel("A", np.zeros(x.rows)) for a in AXES}) for x in r],
            "no axis is excited",
        ),
        (lambda r: [], "no recordings"),
    ],
)
def test_recordings_that_do_not_fit_get_one_clear_line(made: list[Recording], spoil: Callable[..., object], message: str) -> None:
    with pytest.raises(UnusableInputError, match=message) as raised:
        identify(spoil(made))
    assert "\n" not in str(raised.value)


def test_an_unknown_method_is_answered_with_the_known_ones(made: list[Recording]) -> None:
    with pytest.raises(IdentificationError, match="robust_bla"):
        identify(made, "welch")


def test_an_frf_file_gives_back_the_response(made: list[Recording], tmp_path: Path) -> None:
    response = identify(made)
    write_frf(response, tmp_path / "a.npz")
    again = read_frf(tmp_path / "a.npz")
    for name in ("lines", "G", "noise_covariance", "total_covariance", "nonlinear_covariance", "noise_dof"):
        np.testing.assert_array_equal(getattr(again, name), getattr(response, name))
    assert (again.method, again.output_units, again.pose, again.settings) == (
        response.method,
        response.output_units,
        response.pose,
        response.settings,
    )


def test_numpy_alone_reads_an_frf_file_as_documented(made: list[Recording], tmp_path: Path) -> None:
    """The example of docs/generated/file-formats.md: standard deviation of the element from the second input to the third output."""
    response = identify(made)
    write_frf(response, tmp_path / "a.npz")
    file = np.load(tmp_path / "a.npz")
    n_y = file["G"].shape[1]
    i, j = list(file["output_names"]).index("position_roll"), list(file["input_names"]).index("command_roll")
    deviation = np.sqrt(file["noise_covariance"][:, j * n_y + i, j * n_y + i].real)
    np.testing.assert_array_equal(deviation, response.standard_deviation("noise")[:, 2, 1])


@pytest.mark.parametrize("content", [b"", b"not an archive", b"PK\x03\x04 torn"])
def test_a_file_that_is_no_frf_gets_one_clear_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad.npz").write_bytes(content)
    with pytest.raises(IdentificationError, match=r"bad\.npz: not an FRF file"):
        read_frf(tmp_path / "bad.npz")


def test_an_archive_without_the_arrays_names_what_is_missing(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", lines=np.arange(3))
    with pytest.raises(IdentificationError, match="the array frequencies_Hz is missing"):
        read_frf(tmp_path / "other.npz")


def test_the_figure_labels_every_axis_with_its_unit(made: list[Recording]) -> None:
    response = identify(made)
    figure = frf_figure(response, over_poses=[response], compared=[("model", response.frequencies_Hz, response.G)])
    figure.savefig(io.BytesIO(), dpi=40)
    texts = [axes.get_ylabel() for axes in figure.axes] + [axes.get_title() for axes in figure.axes]
    assert any("position_roll" in text and "rad/A" in text for text in texts)
    assert any("imu_x" in text and "m/(s^2 A)" in text for text in texts)
    assert any("command_roll [A]" in text for text in texts)
    assert figure.axes[-1].get_xlabel() == "Frequency [Hz]"


@pytest.mark.slow
def test_figures_over_poses_name_axes_and_methods(made: list[Recording]) -> None:
    poses = [replace(identify(recordings(seed=s, pose=(0.0, angle))), pose=(0.0, angle)) for s, angle in ((1, -0.5), (2, 0.5))]
    surface = surface_figure(poses, 1)
    surface.savefig(io.BytesIO(), dpi=40)
    assert surface.axes[0].get_ylabel() == "pose [°]"
    compared = variance_figure({"one": poses, "other": poses})
    compared.savefig(io.BytesIO(), dpi=40)
    assert {text.get_text() for text in compared.legends[0].get_texts()} >= {"one, noise", "other, nonlinear"}


def test_every_pose_is_identified_and_neighbours_help_if_asked() -> None:
    made = [r for s, angle in ((1, -0.5), (2, 0.0), (3, 0.5)) for r in recordings(seed=s, pose=(0.0, angle))]
    apart = identify_poses(made, "robust_bla")
    assert [response.pose for response in apart] == [(0.0, -0.5), (0.0, 0.0), (0.0, 0.5)]
    together = identify_poses(made, "nd_lrm", over_poses=PoseModel((1,), (1,), (1,)))
    assert together[1].method == "nd_lrm"
    assert together[1].settings["poses"] == 3
    with pytest.raises(IdentificationError, match="use identify_poses"):
        identify(made[:6], "nd_lrm")
