"""Frames through the driver: the spool, the panel's clock against the loop's, and a run that receives them."""

from __future__ import annotations

import csv
import multiprocessing
from pathlib import Path

import numpy as np
import pytest
from commands import isocenter
from scipy.optimize import linprog

from drivers.imaging import ClocksDisagreeError, Frame, FrameSpool, PanelClock, SpoolError, write_frame
from hil.errors import BadAnswerError
from hil.imaging.detector import Detector
from hil.imaging.markers import MarkerProjection
from hil.imaging.scan_folder import read_scan
from hil.machine import load_machine
from hil.receiving.frames_beside import finished_scan, frames_beside
from hil.receiving.panel_frames import RemotePanel, RowSpan
from hil.receiving.receiver import ReceiverOrder
from hil.recording import Channel, Recording

PERIOD = 1.0 / 256.0


def stamps(count: int = 60, rate: float = 7.0, ppm: float = 20.0, epoch: float = 5000.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts in the loop's time, by the panel's clock, and the ticks at which their pulses were seen."""
    start = 0.1 + np.arange(count) / (rate * (1.0 + 1e-6 * ppm))
    return start, epoch + start * (1.0 + 1e-6 * ppm), PERIOD * np.ceil(start / PERIOD)


@pytest.mark.parametrize(("count", "rate", "limit_s"), [(60, 7.0, PERIOD / 7.0), (60, 7.31, PERIOD / 6.0), (300, 7.31, 0.06e-3)])
def test_the_panels_clock_is_known_to_a_small_part_of_a_tick(count: int, rate: float, limit_s: float) -> None:
    """Seven exposures a second meet 256 ticks in seven phases, and the clock is known to the distance of two of them."""
    start, panel, pulse = stamps(count, rate)
    clock = PanelClock(panel, pulse, PERIOD)
    assert np.abs(clock.to_loop(panel) - start).max() < limit_s
    assert abs(clock.residual_s - PERIOD / np.sqrt(12.0)) < 0.3 * PERIOD
    assert abs(1e6 * (1.0 / clock.rate - 1.0) - 20.0) < 1e6 * clock.rate_doubt <= 200.0


def test_who_does_not_wait_for_more_knows_the_time_to_half_a_tick_from_one_pulse() -> None:
    start, panel, pulse = stamps()
    for count in (1, 2):
        clock = PanelClock(panel[:count], pulse[:count], PERIOD, fewest=1)
        assert np.abs(clock.to_loop(panel[:count]) - start[:count]).max() <= 0.5 * PERIOD
        assert clock.doubt_s <= PERIOD / np.sqrt(12.0) + 1e-12
    assert PanelClock(panel[:1], pulse[:1], PERIOD, fewest=1).doubt_s == pytest.approx(PERIOD / np.sqrt(12.0))


def test_the_panels_clock_is_the_linear_programs_line() -> None:
    """Least largest distance, as SciPy's solver finds it."""
    random = np.random.default_rng(4)
    for count in (3, 10, 200):
        start = 0.1 + np.cumsum(random.uniform(0.02, 0.2, count))
        panel, middles = start * (1.0 + 3e-5), PERIOD * np.ceil(start / PERIOD) - 0.5 * PERIOD
        clock = PanelClock(5000.0 + panel, middles + 0.5 * PERIOD, PERIOD)
        sides = np.column_stack([np.ones(count), panel, -np.ones(count)])
        limits, bounds = np.concatenate([middles, -middles]), [(None, None), (1.0 - 1e-4, 1.0 + 1e-4), (0.0, None)]
        least = linprog([0.0, 0.0, 1.0], np.vstack([sides, sides * [-1.0, -1.0, 1.0]]), limits, bounds=bounds).fun
        assert np.abs(middles - clock.to_loop(5000.0 + panel)).max() == pytest.approx(least, abs=1e-9)
        assert abs(clock.rate - 1.0) <= 1e-4


def test_clocks_that_disagree_are_told() -> None:
    start, panel, pulse = stamps()
    with pytest.raises(ClocksDisagreeError, match=r"runs \+20\d\d ppm against the loop's"):
        PanelClock(start * 1.002, pulse, PERIOD)
    jumped = panel + np.where(np.arange(60) > 40, 0.02, 0.0)
    with pytest.raises(ClocksDisagreeError, match=r"clock was set meanwhile|ppm against"):
        PanelClock(jumped, pulse, PERIOD)
    with pytest.raises(ClocksDisagreeError, match=r"frames and pulses are not of the same exposures|ppm against"):
        PanelClock(panel[:-1], np.delete(pulse, 30), PERIOD)
    with pytest.raises(ClocksDisagreeError, match="2 exposures; the panel's clock needs 3"):
        PanelClock(panel[:2], pulse[:2], PERIOD)
    with pytest.raises(ClocksDisagreeError, match="clock was set meanwhile"):
        PanelClock(panel[[0, 2]], pulse[:2], PERIOD, fewest=1)
    for stands in ((np.full(60, 7.0), pulse), (panel, np.full(60, 7.0))):
        with pytest.raises(ClocksDisagreeError, match="60 exposures at one time"):
            PanelClock(*stands, PERIOD)
    with pytest.raises(ClocksDisagreeError, match="do not grow with the loop's pulses"):
        PanelClock(panel[::-1], pulse, PERIOD)


def frame(number: int) -> Frame:
    return Frame(number, 5000.0 + 0.1 * number, 0.008, 0.1 * number, np.full((4, 6), number, dtype=np.uint16))


def test_frames_come_in_order_once_whether_or_not_some_were_lost(tmp_path: Path) -> None:
    spool = FrameSpool(tmp_path)
    assert spool.poll() == []
    for number in (3, 4):
        write_frame(tmp_path, frame(number))
    (tmp_path / "frame_000005.partial").write_bytes(b"half a frame")
    assert [each.exposure_id for each in spool.poll()] == [3, 4]
    write_frame(tmp_path, frame(7))
    (taken,) = spool.poll()
    assert np.array_equal(taken.image, frame(7).image)
    assert (taken.panel_s, taken.width_s, taken.pulse_s) == (
        5000.7,
        0.008,
        0.7000000000000001,
    )
    assert spool.poll() == []
    write_frame(tmp_path, frame(2))
    with pytest.raises(SpoolError, match="frame 2 after frame 7; is an earlier run's still there"):
        spool.poll()


def test_what_is_no_frame_is_named(tmp_path: Path) -> None:
    with pytest.raises(SpoolError, match="no folder; the panel's software must write its frames there"):
        FrameSpool(tmp_path / "nowhere")
    (tmp_path / "frame_000000.npz").write_bytes(b"no frame")
    with pytest.raises(SpoolError, match=r"frame_000000\.npz: no frame of a panel"):
        FrameSpool(tmp_path).poll()
    with (tmp_path / "frame_000000.npz").open("wb") as file:
        np.save(file, np.zeros(3))  # one array, no archive
    with pytest.raises(SpoolError, match=r"frame_000000\.npz: no frame of a panel"):
        FrameSpool(tmp_path).poll()
    write_frame(tmp_path, Frame(0, 5000.0, 0.008, 0.0, np.zeros((4, 6))))
    with pytest.raises(SpoolError, match="the image is of float64; photon counts are uint16"):
        FrameSpool(tmp_path).poll()


@pytest.mark.slow
def test_frames_that_never_came_are_named_and_the_rest_is_a_scan(tmp_path: Path) -> None:
    machine = load_machine("carm")
    (tmp_path / "spool").mkdir()
    order = ReceiverOrder(tmp_path / "spool", tmp_path / "scan", Detector(6, 4, 1e-3), None, None)
    with frames_beside(order, None):
        for number in (3, 4, 7, 9):
            write_frame(order.panel, frame(number))
    time = np.arange(300) * PERIOD
    channels = {f"position_{axis}": Channel("rad", np.zeros(300)) for axis in machine.axes}
    got = finished_scan(machine, order, Recording({"time": Channel("s", time), **channels}, {}), {})
    assert got.lost == (5, 6, 8)
    assert got.exposures == 4
    assert list(read_scan(order.folder).exposure_id) == [3, 4, 7, 9]


@pytest.mark.parametrize("counts_syncs", [True, False])
def test_exposures_told_by_the_count_of_syncs_are_later_by_the_ticks_that_were_lost(tmp_path: Path, counts_syncs: bool) -> None:
    machine = load_machine("carm")
    source = RemotePanel("tcp:nowhere:1", 7.31, 1, PERIOD, RowSpan(multiprocessing.get_context("spawn")))
    order = ReceiverOrder(source if counts_syncs else tmp_path, tmp_path, Detector(6, 4, 1e-3), None, None)
    start, panel_s, pulse = stamps(12, 7.31)
    with (tmp_path / "stamps.csv").open("w", newline="") as file:
        csv.writer(file).writerows(zip(range(12), panel_s, np.full(12, 0.008), pulse, strict=True))
    time = np.arange(600) * PERIOD
    time[200:] += 30 * PERIOD
    channels = {"time": Channel("s", time)} | {f"position_{axis}": Channel("rad", time) for axis in machine.axes}
    assert finished_scan(machine, order, Recording(channels, {}), {}).exposures == 12
    with (tmp_path / "exposures.csv").open(newline="") as file:
        found = np.array([float(row["start [s]"]) for row in csv.DictReader(file)])
    late = np.where(start > 199 * PERIOD, 30 * PERIOD, 0.0) if counts_syncs else 0.0
    assert np.abs(found - (start + late)).max() < PERIOD / 2


@pytest.mark.slow
def test_a_receiver_that_dies_is_told(tmp_path: Path) -> None:
    (tmp_path / "spool").mkdir()
    nowhere = MarkerProjection(np.zeros(9))
    order = ReceiverOrder(tmp_path / "spool", tmp_path / "scan", Detector(6, 4, 1e-3), "no such plate", nowhere)
    with pytest.raises(BadAnswerError, match="the process that receives frames ended early"), frames_beside(order, None):
        write_frame(tmp_path / "spool", frame(0))


@pytest.mark.slow
def test_a_run_receives_its_frames_and_looks_for_the_marker_beside_the_loop(tmp_path: Path) -> None:
    sweep = ["--axis", "roll", "--from", "-5", "--to", "5", "--speed", "10", "--dwell", "0.3"]
    truth = ["--truth", tmp_path / "t.csv"]
    received = ["--images", tmp_path / "scan", "--scene", "clinical", "--image-rate", "4", "--image-binning", "8"]
    assert isocenter("run", "scan", "-m", "carm", "-b", "lockstep:", *sweep, "-o", tmp_path / "r.mf4", *truth, *received) == 0
    scan = read_scan(tmp_path / "scan")
    true = 0.1 + np.arange(len(scan)) / (4.0 * (1.0 + 20e-6))
    assert len(scan) >= 4
    assert np.abs(scan.start_s - true).max() < PERIOD / 2
    assert np.isfinite(scan.positions).all()
    with (tmp_path / "scan" / "markers.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(scan)
    assert all(abs(float(row["focal_length [m]"]) - 1.16) < 1e-3 for row in rows)
    # the same images afterwards, from the truth file: the same motion, exposed by the other way
    shown = [*truth, "--marker", "clinical", "--rate", "4", "--binning", "8", "-o", tmp_path / "again"]
    assert isocenter("expose", "carm", tmp_path / "r.mf4", *shown) == 0
    again = read_scan(tmp_path / "again")
    assert len(again) == len(scan)
    assert np.array_equal(again.frame(2), scan.frame(2))
