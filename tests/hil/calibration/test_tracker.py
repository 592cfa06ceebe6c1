"""A tracker's poses: frames and mountings that nobody knows are found, and what is left is what changes from pose to pose."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import Isocenter
from scipy.spatial.transform import Rotation

from hil.calibration.use.lookup_table import LookUp, read_look_up, write_look_up
from hil.calibration.use.tracker import Registered, TrackedPoses, read_tracker, tracked_table
from hil.errors import UnusableInputError
from hil.imaging.geometry import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.machine import load_machine
from hil.recording import Channel, Recording, write_recording

CARM = load_machine("carm")
ROWS, RATE_Hz = 201, 20.0
SIGMA_m, SIGMA_rad = 5e-5, 1e-4
PARTS = [*(f"{letter} [mm]" for letter in "xyz"), *(f"q{letter}" for letter in "xyzw")]
HEADER = ["time [s]", *(f"{target}_{part}" for target in ("detector", "source") for part in PARTS)]


def positions(only_roll: bool = False) -> np.ndarray:
    turn = np.linspace(0.0, 1.0, ROWS)
    propeller = np.zeros(ROWS) if only_roll else np.radians(25.0) * np.sin(4.0 * np.pi * turn)
    return np.column_stack([propeller, np.radians(40.0) * np.sin(2.0 * np.pi * turn)])


def recording(where: np.ndarray) -> Recording:
    channels = {"time": Channel("s", np.arange(ROWS) / RATE_Hz)}
    for axis, column in zip(CARM.axes, where.T, strict=True):
        channels[f"position_{axis}"] = channels[f"link_position_{axis}"] = Channel("rad", column)
    return Recording(channels, {})


def sagging(where: np.ndarray) -> np.ndarray:
    """Deviations (N, 9) from nominal that change with the pose and have no mean."""
    found = np.zeros((ROWS, 9))
    found[:, 1], found[:, 3], found[:, 7] = 2e-3 * np.cos(where[:, 1]), 1e-3 * np.sin(where[:, 1]), 1e-3 * np.sin(2.0 * where[:, 1])
    return found


def seen_by_tracker(beam: ConeBeam, seed: int = 0, noise: float = 1.0) -> TrackedPoses:
    """Of targets somewhere on panel and tube, in a frame somewhere in the room; the tube turns with the panel."""
    random = np.random.default_rng(seed)
    world, mounting, tube = (Rotation.from_rotvec(each).as_matrix() for each in ([1.0, -2.0, 0.5], [0.3, 1.5, -0.7], [2.0, 0.1, 0.4]))
    panel, spot = beam.detector_in_phantom_m, beam.source_in_phantom_m
    turned = {"detector": beam.rotation @ mounting, "source": beam.rotation @ tube}
    centres = {"detector": (panel, np.array([0.2, -0.1, 0.05])), "source": (spot, np.array([-0.1, 0.15, 0.3]))}
    places, rotations = {}, {}
    for target, (centre, offset) in centres.items():
        place = (centre + turned[target] @ offset) @ world + np.array([1.0, 2.0, -0.5])
        places[target] = place + noise * SIGMA_m * random.standard_normal((ROWS, 3))
        shaken = Rotation.from_rotvec(noise * SIGMA_rad * random.standard_normal((ROWS, 3))).as_matrix()
        rotations[target] = world.T @ turned[target] @ shaken
    return TrackedPoses(np.arange(ROWS) / RATE_Hz, places, rotations)


def table(where: np.ndarray, poses: TrackedPoses, against: LookUp | None = None) -> tuple[LookUp, Registered]:
    return tracked_table(CARM, recording(where), poses, position_sigma_m=SIGMA_m, rotation_sigma_rad=SIGMA_rad, against=against)


def test_against_the_calibration_that_is_true_nothing_is_left() -> None:
    """Of a sweep of one axis, which shows no place along it."""
    where = positions(only_roll=True)
    true = LookUp(CARM.axes, where, sagging(where), np.zeros((ROWS, 9, 9)), {"machine": CARM.name})
    _, found = table(where, seen_by_tracker(nominal_beam(CARM, where).moved(sagging(where)), noise=0.0), true)
    assert np.abs(found.difference).max() < 1e-8


def test_what_a_reference_lacks_shows_but_for_what_a_mounting_would_make_of_it() -> None:
    """The difference between two geometries is what their tables, each laid on the same tracker, differ by."""
    where = positions()
    beam = nominal_beam(CARM, where)
    still, moving = (table(where, seen_by_tracker(each, noise=0.0))[0].deviation for each in (beam, beam.moved(sagging(where))))
    assert np.abs(still).max() < 1e-8
    swing = moving[:, 7] - moving[:, 7].mean()
    assert np.corrcoef(swing, sagging(where)[:, 7])[0, 1] > 0.95


def test_the_stated_covariance_is_the_scatter_over_trackers() -> None:
    print("seeds 0 to 7")
    where = positions()
    beam = nominal_beam(CARM, where)
    drawn = [table(where, seen_by_tracker(beam, seed))[0] for seed in range(8)]
    scatter = np.mean([each.deviation**2 for each in drawn], axis=(0, 1))
    stated = np.mean(np.diagonal(drawn[0].covariance, axis1=1, axis2=2), axis=0)
    assert np.sqrt(scatter / stated) == pytest.approx(1.0, abs=0.1)


def write(poses: TrackedPoses, path: Path, later_s: float = 0.0) -> None:
    columns = [poses.time_s + later_s]
    for target in ("detector", "source"):
        columns += [*(1e3 * poses.place_m[target]).T, *Rotation.from_matrix(poses.rotation[target]).as_quat().T]
    rows = [[f"{value:.10g}" for value in row] for row in np.column_stack(columns)]
    rows[3][2] = ""  # a target that was hidden
    path.write_text("\n".join(",".join(row) for row in [HEADER, *rows]) + "\n", encoding="utf-8")


def test_the_command_reads_the_table_and_says_how_far_a_calibration_is_off(isocenter: Isocenter, tmp_path: Path) -> None:
    where = positions(only_roll=True)
    true = LookUp(CARM.axes, where, sagging(where), np.tile(1e-10 * np.eye(9), (ROWS, 1, 1)), {"machine": CARM.name})
    wrong = LookUp(CARM.axes, where, 0.5 * sagging(where), true.covariance, {"machine": CARM.name})
    for each, name in ((true, "true"), (wrong, "wrong")):
        write_look_up(each, tmp_path / f"{name}.npz")
    write_recording(recording(where), tmp_path / "scan.csv")
    write(seen_by_tracker(nominal_beam(CARM, where).moved(sagging(where))), tmp_path / "poses.csv", later_s=7.0)
    common = ("calibrate", "tracker", "carm", tmp_path / "scan.csv", tmp_path / "poses.csv", "--later", "7", "--json", "-")
    off = {}
    for name in ("true", "wrong"):
        done = isocenter(*common, "--against", tmp_path / f"{name}.npz", "-o", tmp_path / "out.npz")
        off[name] = json.loads(done.out)
    assert off["true"]["poses"] == ROWS - 1
    assert off["true"]["lost"] == 1
    assert off["true"]["rms"]["source_m"] < 4.0 * off["true"]["noise"]["source_m"]
    assert off["true"]["rms"]["rotation_rad"] == pytest.approx(off["true"]["noise"]["rotation_rad"], rel=0.2)
    assert off["wrong"]["rms"]["rotation_rad"] > 1.5 * off["true"]["rms"]["rotation_rad"]
    assert read_look_up(tmp_path / "out.npz").axes == CARM.axes


@pytest.mark.parametrize(("unit", "factor"), [("", 1.0), (" [ms]", 1e3), (" [us]", 1e6)])
def test_the_unit_of_time_is_read(tmp_path: Path, unit: str, factor: float) -> None:
    lines = [",".join(HEADER).replace(" [s]", unit), *(f"{factor * time_s:g}," + ",".join(["1,2,3,0,0,0,1"] * 2) for time_s in (0.5, 0.75))]
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    np.testing.assert_allclose(read_tracker(tmp_path / "poses.csv").time_s, [0.5, 0.75])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time [s],detector_x [mm]\n0,1\n", "no column"),
        (",".join(HEADER).replace("[mm]", "[in]") + "\n" + "0," + ",".join(["1,2,3,0,0,0,1"] * 2) + "\n", "must be in m or mm"),
        (",".join(HEADER).replace("[s]", "[min]") + "\n" + "0," + ",".join(["1,2,3,0,0,0,1"] * 2) + "\n", "must be in s, ms or us"),
        (",".join(HEADER) + "\n" + "0," + ",".join(["1,2,3,0,0,0,2"] * 2) + "\n", "length 1"),
        (",".join(HEADER) + "\n" + "0," + ",".join(["1,2,x,0,0,0,1"] * 2) + "\n", "line 2"),
    ],
)
def test_a_table_that_is_none_is_told(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "poses.csv").write_text(text, encoding="utf-8")
    with pytest.raises(UnusableInputError, match=said):
        read_tracker(tmp_path / "poses.csv")
