"""The calibration along with the loop gives in every row what the filter over a recording gives with the images that had come by then."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commands import isocenter

from controllers.observers.publish import estimate_channels
from hil.calibration.data_driven.calibrate import calibrate_data
from hil.calibration.data_driven.data_file import DataFile, read_data_file, write_data_file
from hil.calibration.data_driven.levelled import levelled
from hil.calibration.data_driven.live import LiveCalibration
from hil.calibration.data_driven.live_file import KeptSightings, write_live_geometry, write_sightings
from hil.calibration.data_driven.live_kernel import chain_of, pose_rows
from hil.calibration.data_driven.observed_beam import ObservedBeam
from hil.calibration.data_driven.quasi_static import QuasiStatic
from hil.calibration.data_driven.values import Calibration, Measurement, Parameters
from hil.errors import UnusableInputError
from hil.imaging.mailbox import Sighting
from hil.imaging.nominal import nominal_beam
from hil.machine import load_machine
from hil.recording import Channel, Recording

CARM = load_machine("carm")
MODEL = QuasiStatic.of(CARM)
RATE = CARM.sample_rate_Hz
ROWS, LATE_ROWS, EVERY = 700, 60, 40
DOWN = np.array([0.0, 0.0, -1.0])
SIGMA = np.repeat([1e-4, 3e-5, 1e-4], 3)
OBSERVER = SimpleNamespace(
    channels=estimate_channels(CARM.axes, ("rad", "rad")),
    model=SimpleNamespace(channels=lambda: [*"abcd", "imu_x", "imu_y", "imu_z", "gyro_x", "gyro_y", "gyro_z"]),
)
"""An observer by its channels alone."""


def test_a_row_of_the_compiled_kernel_is_the_models() -> None:
    chain, rows, nominal = chain_of(CARM), np.zeros((9, len(MODEL.names))), np.zeros((6, 3))
    for positions in np.random.default_rng(0).uniform(-1.8, 1.8, (20, 2)):
        pose_rows(*chain, DOWN, positions, rows, nominal)
        beam = nominal_beam(CARM, positions)
        assert np.abs(rows - MODEL.rows(positions[None], DOWN[None])[0]).max() < 1e-13
        assert np.abs(nominal[:3] - beam.rotation[0]).max() < 1e-14
        assert np.abs(nominal[3:] - [beam.source_m[0], beam.phantom_m[0], DOWN @ beam.rotation[0]]).max() < 1e-14


class Post:
    """Images by the row in which they come."""

    def __init__(self, sightings: list[tuple[int, Sighting]]) -> None:
        self.due = {}
        for row, sighting in sightings:
            self.due.setdefault(row, []).append(sighting)
        self.told = []

    def tell(self, row: int, time_s: float, positions: np.ndarray) -> None:
        self.told.append((row, time_s, *positions))

    def collect(self, row: int) -> list[object]:
        return self.due.get(row, [])


@pytest.fixture(scope="module")
def moving() -> SimpleNamespace:
    """A path, the observer's deviations of it, an earlier calibration, and images of a machine that differs from it."""
    generator = np.random.default_rng(6)
    time = np.arange(ROWS) / RATE
    positions = np.column_stack([0.4 + 0.2 * np.sin(time), -1.0 + 0.6 * time])
    nominal = nominal_beam(CARM, positions)
    static = 1e-4 * generator.standard_normal((4, 9))
    shaken = np.sin(2.0 * np.pi * 6.0 * time)[:, None] * np.repeat([1e-4, 3e-4], [6, 3])
    by_pose = np.column_stack([np.ones(ROWS), np.einsum("nij,i->nj", nominal.rotation, DOWN)])
    deviation = by_pose @ static + shaken
    known = Parameters(1e-4 * generator.standard_normal(len(MODEL.names)), np.diag((0.1 * MODEL.prior) ** 2))
    start = DataFile("carm", CARM.axes, MODEL.names, time, positions, shaken, shaken, shaken, known.values, known.covariance, static)
    # what a high-pass of 0.3 Hz leaves, by its own recursion: a scan's poses change in seconds, its modes swing from 8 Hz on
    low, share, fast = np.zeros(9), 1.0 - math.exp(-2.0 * math.pi * 0.3 / RATE), np.zeros((ROWS, 9))
    for k in range(ROWS):
        low = shaken[k].copy() if k == 0 else low + share * (shaken[k] - low)
        fast[k] = shaken[k] - low
    spread = np.repeat([10e-6, 100e-6], 3)  # m, rad: the least an observer is believed to be off by
    observed = ObservedBeam(time, positions, fast, np.tile(DOWN, (ROWS, 1)), spread)
    true = MODEL.rows(positions, observed.load) @ (known.values + generator.normal(size=len(MODEL.names)) * MODEL.between_scans) + fast
    sightings = []
    for number, row in enumerate(range(EVERY, ROWS - LATE_ROWS, EVERY)):
        at = time[row] + 0.3 / RATE
        here, expected, _ = observed.at(np.array([at]))
        near = 0.7 * true[row] + 0.3 * true[row + 1]
        seen = near + generator.normal(size=9) * SIGMA
        sightings.append((row + LATE_ROWS, Sighting(number, number, at, "phantom", here[0], seen, np.diag(SIGMA**2))))
        assert expected.shape == (1, 9)
    return SimpleNamespace(positions=positions, nominal=nominal, deviation=deviation, start=start, observed=observed, sightings=sightings)


def estimates(moving: SimpleNamespace) -> np.ndarray:
    """Rows of an observer that says these deviations."""
    beam = moving.nominal.moved(moving.deviation)
    names = [name for name, _ in OBSERVER.channels]
    still = nominal_beam(CARM, np.zeros((1, 2))).rotation[0]
    turned = type(beam)(beam.source_m, beam.phantom_m, still.T @ beam.rotation)
    rows = np.zeros((ROWS, len(names)))
    rows[:, [names.index(f"estimate_link_position_{axis}") for axis in CARM.axes]] = moving.positions
    first = names.index("estimate_source_x")
    rows[:, first : first + 9] = turned.parameters
    return rows


def live_run(
    moving: SimpleNamespace, inbox: KeptSightings | Post, until_m: float = 0.0, lost: tuple[int, ...] = ()
) -> tuple[LiveCalibration, np.ndarray]:
    live = LiveCalibration(CARM, moving.start, OBSERVER, inbox, until_m, moving.positions[::20])
    live.restart(ROWS)
    published = np.full((ROWS, 19), np.nan)
    for k, estimate in enumerate(estimates(moving)):
        if k not in lost:
            live.step(k, estimate)
            published[k] = live.values
    return live, published


def test_every_row_has_what_the_filter_over_the_recording_has_with_the_images_come_by_then(moving: SimpleNamespace) -> None:
    live, published = live_run(moving, Post(moving.sightings))
    measurements = [Measurement(each.time_s, each.values, each.covariance) for _, each in moving.sightings]
    start = moving.start.parameters(MODEL).aged(MODEL)
    for row in (10, 250, 699):
        come = [each for each, (arrives, _) in zip(measurements, moving.sightings, strict=True) if arrives <= row]
        offline = calibrate_data(MODEL, moving.observed, come, start, late_s=0.0)
        assert published[row, 18] == len(come)
        assert np.abs(published[row, :9] - offline.live[row]).max() < 1e-9
        assert np.abs(np.sqrt(published[row, 9:18]) / offline.sigma[row] - 1.0).max() < 1e-6
        spread = np.outer(offline.sigma[row], offline.sigma[row])
        assert np.abs((live.covariance[row] - offline.covariance[row]) / spread).max() < 1e-6
    assert [arrival.row for arrival in live.arrivals] == [row for row, _ in moving.sightings]


def test_what_it_leaves_is_replayed_bit_for_bit_and_read_as_a_calibration(moving: SimpleNamespace, tmp_path: Path) -> None:
    live, published = live_run(moving, Post(moving.sightings), until_m=1e-4, lost=(300, 301, 302))
    assert 0 < live.withdrawn_after < len(moving.sightings)
    assert live.summary["withdrawn"] > 0
    write_sightings(live, tmp_path / "sightings.npz")
    kept = KeptSightings(tmp_path / "sightings.npz")
    again, repeated = live_run(moving, kept, kept.until_m, lost=(300, 301, 302))
    assert np.array_equal(published, repeated, equal_nan=True)
    write_live_geometry(live, tmp_path / "geometry.npz")
    found = read_data_file(tmp_path / "geometry.npz")
    assert len(found.time_s) == ROWS - 3
    assert np.array_equal(found.values, again.filter.parameters.values)
    assert np.array_equal(found.live[-1], published[-1, :9])
    assert np.array_equal(found.static, moving.start.static)
    with np.load(tmp_path / "geometry.npz") as file:  # what deviations have in common, as docs/generated/file-formats.md lays it out
        sigma, correlation = file["sigma"][-1], file["correlation"][-1]
    together = np.diag(sigma**2)
    together[np.triu_indices(9, 1)] = correlation * np.outer(sigma, sigma)[np.triu_indices(9, 1)]
    assert np.allclose(np.triu(together), np.triu(live.covariance[-1]), rtol=1e-5, atol=1e-6 * sigma.max() ** 2)
    assert correlation.dtype == np.float32
    assert 0.5 < np.abs(correlation).max() <= 1.0


@pytest.mark.parametrize("name", ["row", "time_s", "positions", "covariance", "sightings_format"])
def test_sightings_of_another_shape_are_one_line(moving: SimpleNamespace, tmp_path: Path, name: str) -> None:
    live, _ = live_run(moving, Post(moving.sightings[:3]))
    path = tmp_path / "sightings.npz"
    write_sightings(live, path)
    arrays = dict(np.load(path))
    np.savez(path, **(arrays | {name: np.zeros((2, 7))}))
    with pytest.raises(UnusableInputError, match=r"sightings\.npz: (damaged: \w+ has shape|no sightings)"):
        KeptSightings(path)


def test_an_image_that_comes_before_an_earlier_ones_or_of_no_row_is_left_out(moving: SimpleNamespace) -> None:
    (row, first), (_, second), *_ = moving.sightings
    future = Sighting(9, 9, 100.0, "phantom", first.positions, first.values, first.covariance)
    live, _ = live_run(moving, Post([(row + 50, second), (row + 60, first), (row + 60, future)]))
    assert [arrival.fate for arrival in live.arrivals] == ["used", "late", "late"]


def test_an_inertial_reading_is_levelled_as_a_recording_is(moving: SimpleNamespace) -> None:
    live, _ = live_run(moving, Post([]))
    row = np.concatenate([moving.positions[100], moving.positions[100], np.random.default_rng(1).normal(size=6)])
    units = {"position_propeller": "rad", "position_roll": "rad"}
    units |= {f"imu_{axis}": "m/s^2" for axis in "xyz"} | {f"gyro_{axis}": "rad/s" for axis in "xyz"}
    read = np.delete(row, [2, 3])
    channels = {name: Channel(unit, np.array([value])) for (name, unit), value in zip(units.items(), read, strict=True)}
    channels["time"] = Channel("s", np.zeros(1))
    offline = levelled(CARM, Recording(channels, {}), MODEL, moving.start.values).matrix(list(units)[2:])[0]
    live.level(row)
    assert np.abs(row[4:] - offline).max() < 1e-12 < 1e-5 < np.abs(offline - read[2:]).max()
    row[0] = np.nan
    live.level(row)
    assert np.isnan(row[4:]).all()


def test_a_calibration_made_without_an_observer_is_refused(moving: SimpleNamespace, tmp_path: Path) -> None:
    seen = moving.observed.deviation
    quiet = Calibration(seen, seen, np.zeros((ROWS, 9, 9)), moving.start.parameters(MODEL))
    write_data_file(MODEL, moving.observed, quiet, tmp_path / "quiet.npz")
    with pytest.raises(UnusableInputError, match="was made without an observer; make it with isocenter calibrate data --design"):
        LiveCalibration(CARM, read_data_file(tmp_path / "quiet.npz"), OBSERVER, Post([]), 0.0, moving.positions[:2])


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--data", "a.npz"], "--data: takes the observer's estimate and images; give --observer FILE and --images DIR as well"),
        (["--until", "0.1"], "--until: withdraws images from a live calibration; give --data FILE as well"),
        (["--emulated", "emps"], "--emulated emps: has"),
    ],
)
def test_options_that_belong_together_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], line: str
) -> None:
    still = ("run", "static", "-m", "carm", "-b", "lockstep:", "--seconds", "0.5")
    assert isocenter(*still, "-o", tmp_path / "r.mf4", *arguments) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
