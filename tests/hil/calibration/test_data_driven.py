"""The data-driven filter on machines that are built askew by finite motions: parameters from images, late images, changes, withdrawal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.calibration.data_driven.calibrate import calibrate_data
from hil.calibration.data_driven.observed_beam import ObservedBeam
from hil.calibration.data_driven.quasi_static import QuasiStatic
from hil.calibration.data_driven.values import Measurement, Parameters
from hil.imaging.geometry import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.machine import load_machine

CARM = load_machine("carm")
MODEL = QuasiStatic.of(CARM)
DOWN = np.array([0.0, 0.0, -1.0])
SIGMA = np.full(9, 50e-6)
SMALL = 1e-6


def askew(positions: np.ndarray, shift: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 0.0), seed: int = 5) -> ConeBeam:
    """The geometry of a machine whose mount, arm and detector stand askew and whose detector sags: rigid motions of its bodies."""
    size = np.random.default_rng(seed).normal(0.0, 5e-4, (4, 6))
    nominal = nominal_beam(CARM, positions)
    panel, center, source = nominal.rotation, nominal.detector_in_phantom_m, nominal.source_in_phantom_m
    propeller = Rotation.from_rotvec(positions[:, :1] * [1.0, 0.0, 0.0]).as_matrix()
    for frame, (move, turn) in ((propeller, np.split(size[0], 2)), (np.eye(3)[None], np.split(size[1], 2))):
        by = frame @ Rotation.from_rotvec(turn).as_matrix() @ np.swapaxes(frame, 1, 2)
        moved = (frame @ move)[:, :]
        center, source = ((by @ point[..., None])[..., 0] + moved for point in (center, source))
        panel = by @ panel
    sag = np.einsum("nij,i->nj", panel, DOWN)[:, :1] * [0.0, 2e-3, 0.0]
    center = center + panel @ size[2, :3] + np.asarray(shift)
    source = source + panel @ size[3, :3] + np.asarray(shift)
    return ConeBeam.from_frames(source, center, panel @ Rotation.from_rotvec(size[2, 3:] + sag).as_matrix())


def path(rows: int = 400, seconds: float = 40.0) -> ObservedBeam:
    """A motion of both axes that crosses its whole range."""
    time = np.linspace(0.0, seconds, rows)
    positions = np.column_stack([1.8 * np.sin(2.0 * np.pi * 3.0 * time / seconds), 1.4 * np.sin(2.0 * np.pi * 2.0 * time / seconds + 0.4)])
    return ObservedBeam(time, positions, np.zeros((rows, 9)), np.tile(DOWN, (rows, 1)), np.repeat([5e-6, 5e-6], 3))


def images(
    observed: ObservedBeam,
    count: int,
    shift_after: float = np.inf,
    shift: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 0.0),
    seed: int = 1,
) -> list[Measurement]:
    """What the phantom's images say, with their noise."""
    noise = np.random.default_rng(seed).normal(size=(count, 9)) * SIGMA
    times = np.linspace(observed.time_s[5], observed.time_s[-20], count)
    positions, _, _ = observed.at(times)
    nominal = nominal_beam(CARM, positions)
    still, moved = askew(positions).deviation_from(nominal), askew(positions, shift).deviation_from(nominal)
    truth = np.where((np.arange(count) >= shift_after)[:, None], moved, still)
    return [Measurement(float(t), row, np.diag(SIGMA**2)) for t, row in zip(times, truth + noise, strict=True)]


def error(observed: ObservedBeam, deviation: np.ndarray, shift: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """(N, 9) of the geometry found."""
    return nominal_beam(CARM, observed.positions).moved(deviation).deviation_from(askew(observed.positions, shift))


def test_twenty_interleaved_images_tell_the_geometry_of_poses_never_imaged() -> None:
    observed = path()
    found = calibrate_data(MODEL, observed, images(observed, 20), Parameters.unknown(MODEL))
    poses = np.random.default_rng(3).uniform(-1.0, 1.0, (200, 2)) * [1.8, 1.4]
    unseen = ObservedBeam(np.arange(200.0), poses, np.zeros((200, 9)), np.tile(DOWN, (200, 1)), observed.displacement_std)
    held_out = calibrate_data(MODEL, unseen, [], found.parameters)
    left = error(unseen, held_out.final)
    assert np.sqrt(np.mean(left[:, :6] ** 2)) < 0.06e-3
    assert np.sqrt(np.mean(left[:, 6:] ** 2)) < 0.06e-3
    assert np.sqrt(np.mean(error(unseen, np.zeros((200, 9)))[:, :6] ** 2)) > 0.5e-3
    assert np.sqrt(np.mean((left / held_out.sigma) ** 2)) < 1.5  # and it knows how well it knows


def test_one_axis_alone_does_not_tell_the_other_axis_poses() -> None:
    rolling = path()
    rolling.positions[:, 0] = 0.0
    found = calibrate_data(MODEL, rolling, images(rolling, 20), Parameters.unknown(MODEL)).parameters
    there, away = path(), path()
    there.positions[:, 0] = 0.0
    away.positions[:, 0] = 1.5
    on, off = (calibrate_data(MODEL, each, [], found) for each in (there, away))
    assert np.sqrt(np.mean(error(there, on.final)[:, 3:6] ** 2)) < 0.1e-3
    assert np.sqrt(np.mean(error(away, off.final)[:, 3:6] ** 2)) > 0.15e-3
    assert np.median(off.sigma[:, 3:6]) > 3.0 * np.median(on.sigma[:, 3:6])


def test_an_image_that_comes_late_counts_for_what_it_would_have_in_time() -> None:
    observed = replace(path(), displacement_std=np.full(6, 3e-4))  # so that the displacement of another instant would count otherwise
    seen = images(observed, 40)
    prompt, late = (calibrate_data(MODEL, observed, seen, Parameters.unknown(MODEL), late_s=late) for late in (0.0, 1.5))
    assert np.abs(prompt.parameters.values - late.parameters.values).max() < 1e-9
    assert np.allclose(prompt.parameters.covariance, late.parameters.covariance, rtol=1e-6, atol=1e-16)
    assert np.abs(prompt.live[-1] - late.live[-1]).max() < 1e-9
    assert np.allclose(prompt.sigma[-1], late.sigma[-1], rtol=1e-6)
    row = int(np.searchsorted(observed.time_s, seen[0].time_s + 0.3))
    assert late.sigma[row, 3] > 2.0 * prompt.sigma[row, 3]  # but it is not known before it is there


def test_a_mount_that_is_bumped_is_found_anew_and_a_wrong_image_is_refused() -> None:
    observed, shift = path(), (1.5e-3, 2.0e-3, -1.0e-3)
    known = calibrate_data(MODEL, observed, images(observed, 20), Parameters.unknown(MODEL)).parameters
    seen = images(observed, 20, 8, shift, seed=2)
    wrong = seen[4]
    seen[4] = Measurement(wrong.time_s, wrong.values + np.r_[np.zeros(8), 0.05], wrong.covariance)
    found = calibrate_data(MODEL, observed, seen, known)
    assert found.changes == [8]
    assert found.refused == [4]
    assert np.sqrt(np.mean(error(observed, found.live, shift)[300:, 3:6] ** 2)) < 0.08e-3


def test_images_are_withdrawn_once_the_place_is_known() -> None:
    observed = path()
    found = calibrate_data(MODEL, observed, images(observed, 30), Parameters.unknown(MODEL), until_m=0.05e-3)
    assert found.converged is not None
    assert found.converged == len(found.used) < 30
    assert found.place_sigma_m[-1] < 0.05e-3 <= found.place_sigma_m[-2]
    assert len(calibrate_data(MODEL, observed, images(observed, 30), Parameters.unknown(MODEL), most=7).used) == 7


def test_an_observers_displacement_is_followed_and_does_not_drift() -> None:
    observed = path()
    swing = (
        3e-4
        * np.sin(2.0 * np.pi * 3.0 * observed.time_s)[:, None]
        * MODEL.rows(observed.positions, observed.load)[:, :, MODEL.names.index("detector_turn_x")]
    )
    swinging = ObservedBeam(observed.time_s, observed.positions, swing, observed.load, observed.displacement_std)
    known = calibrate_data(MODEL, observed, images(observed, 20), Parameters.unknown(MODEL)).parameters
    quiet, moved = (calibrate_data(MODEL, each, [], known) for each in (observed, swinging))
    assert np.abs(moved.live - quiet.live - swing).max() < 1e-12
    assert moved.sigma[-1, 7] < 1.5 * moved.sigma[0, 7]


@pytest.mark.parametrize("where", ["mount", "after_propeller", "detector"])
def test_every_offset_moves_the_geometry_as_its_body_does(where: str) -> None:
    positions = np.random.default_rng(0).uniform(-1.5, 1.5, (6, 2))
    rows = MODEL.rows(positions, np.tile(DOWN, (6, 1)))
    nominal = nominal_beam(CARM, positions)
    panel, center, source = nominal.rotation, nominal.detector_in_phantom_m, nominal.source_in_phantom_m
    propeller = Rotation.from_rotvec(positions[:, :1] * [1.0, 0.0, 0.0]).as_matrix()
    frame = {"mount": np.broadcast_to(np.eye(3), panel.shape), "after_propeller": propeller, "detector": panel}[where]
    for k in range(3):
        along = frame[:, :, k]
        turn = Rotation.from_rotvec(SMALL * along).as_matrix()
        pivot = center if where == "detector" else np.zeros_like(center)
        for kind, moved_panel, by in (("place", panel, None), ("turn", turn @ panel, turn)):

            def moved(point: np.ndarray, by: np.ndarray | None = by, pivot: np.ndarray = pivot, along: np.ndarray = along) -> np.ndarray:
                return point + SMALL * along if by is None else pivot + (by @ (point - pivot)[..., None])[..., 0]

            beam = ConeBeam.from_frames(source if where == "detector" else moved(source), moved(center), moved_panel)
            column = MODEL.names.index(f"{where}_{kind}_{'xyz'[k]}")
            assert np.abs(beam.deviation_from(nominal) / SMALL - rows[:, :, column]).max() < 1e-5


def test_slow_change_is_followed_from_scan_to_scan_by_three_images_each() -> None:
    observed = path()
    start = calibrate_data(MODEL, observed, images(observed, 20), Parameters.unknown(MODEL)).parameters
    followed, drift = start, np.array([0.1e-3, -0.15e-3, 0.05e-3])
    for scan in range(1, 11):
        shift = scan * drift
        now = calibrate_data(MODEL, observed, images(observed, 3, 0, shift, seed=scan), followed.aged(MODEL))
        followed = now.parameters
        left = np.sqrt(np.mean(error(observed, now.final, shift)[:, 3:6] ** 2))
        assert left < 0.1e-3, f"scan {scan}: {1e3 * left:.3f} mm"
    stale = calibrate_data(MODEL, observed, [], start)
    assert np.sqrt(np.mean(error(observed, stale.final, shift)[:, 3:6] ** 2)) > 0.8e-3
