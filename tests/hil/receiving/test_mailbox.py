"""Shared memory between the loop and who looks at images: what is told and sent comes whole, and what is lost is counted."""

import io
import multiprocessing
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import tifffile

from drivers.imaging import Frame, write_frame
from drivers.imaging.clock import FEWEST
from hil.imaging.detector import Detector
from hil.imaging.mailbox import LETTERS, POSES, LoopEnd, Mailbox, Sighting
from hil.imaging.marker_view import watched_marker
from hil.imaging.markers import MarkerPoints
from hil.imaging.nominal import nominal_detector
from hil.imaging.scan_folder import FRAMES
from hil.machine import load_machine
from hil.receiving import frame_measurements as watch_module
from hil.receiving import receiver as receiver_module
from hil.receiving.frame_measurements import Live, Watch
from hil.receiving.receiver import PIECE_BYTES, ReceiverOrder, serve

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

CONTEXT, PERIOD = multiprocessing.get_context("spawn"), 1.0 / 256.0


def test_a_lost_tick_shifts_the_loops_time_against_the_count_of_syncs() -> None:
    box = Mailbox(CONTEXT, 2)
    end = LoopEnd(box)
    for row in (0, 1, 2, 5, 6):  # two ticks were lost
        end.tell(row, row * PERIOD, np.zeros(2))
    assert box.loop_time(1.25 * PERIOD, PERIOD) == pytest.approx(1.25 * PERIOD)
    assert box.loop_time(3.5 * PERIOD, PERIOD) == pytest.approx(5.5 * PERIOD)
    assert np.isnan(box.loop_time(4.5 * PERIOD, PERIOD)), "of a row that has not been told"


def test_what_a_full_mailbox_has_no_place_for_is_counted_and_what_it_holds_is_whole() -> None:
    box = Mailbox(CONTEXT, 2)
    end = LoopEnd(box)
    for number in range(LETTERS + 3):
        box.send(Sighting(number, number, 0.1 * number, "phantom", np.zeros(2), np.full(9, number), np.eye(9)))
    assert end.lost == 3
    assert [(each.exposure_id, each.values[0]) for each in end.collect(0)] == [(k, k) for k in range(LETTERS)]
    box.send(Sighting(99, 99, 9.9, "phantom", np.zeros(2), np.zeros(9), np.eye(9)))
    assert [each.exposure_id for each in end.collect(1)] == [99]
    assert end.lost == 3


def test_the_first_image_is_not_kept_until_the_panels_clock_is_known_better() -> None:
    machine = load_machine("carm")
    box, panel = Mailbox(CONTEXT, 2), nominal_detector(machine, 8)
    plate, nominal = watched_marker(machine, "clinical")
    assert plate is not None
    assert nominal is not None
    end, watch = LoopEnd(box), Watch(Live(machine, box), panel, nominal)
    for row in range(100):
        end.tell(row, row * PERIOD, np.zeros(2))
    seen = nominal.values[:6] + 1e-3, np.eye(6), MarkerPoints(np.arange(0), np.zeros((0, 2)), np.zeros((0, 0)), {}, {})
    watch.take(Frame(0, 5000.0, 8e-3, 40 * PERIOD, np.zeros((panel.rows, panel.columns), dtype=np.uint16)), seen)
    (sighting,) = end.collect(99)
    assert sighting.time_s == pytest.approx(39.5 * PERIOD + 4e-3, abs=1e-6), "in the middle of the period in which its pulse came"


def test_an_image_of_a_row_that_is_kept_no_longer_is_counted_and_one_of_before_row_0_is_not() -> None:
    box, panel = Mailbox(CONTEXT, 2), Detector(16, 12, 20e-3)
    end, watch = LoopEnd(box), Watch(Live(load_machine("carm"), box), panel, None)
    for row in range(POSES + 200):
        end.tell(row, row * PERIOD, np.zeros(2))
    for number, exposed_s in enumerate((-0.05, 0.3, 0.4, 0.5, 1.0)):  # rows to 200 were written over
        start_s = exposed_s - 4e-3
        pulse_s = np.ceil(start_s / PERIOD) * PERIOD
        watch.take(Frame(number, 5000.0 + start_s, 8e-3, pulse_s, np.full((12, 16), 2000, dtype=np.uint16)), None)
    assert (end.unplaced, end.looked_at, end.lost) == (3, 5, 0)


@pytest.mark.parametrize("counts_syncs", [True, False])
def test_an_image_that_is_there_before_its_row_waits_for_it(monkeypatch: pytest.MonkeyPatch, counts_syncs: bool) -> None:
    machine = load_machine("carm")
    box, panel = Mailbox(CONTEXT, 2), nominal_detector(machine, 8)
    end, watch = LoopEnd(box), Watch(Live(machine, box, counts_syncs), panel, None)
    told = 0

    def tick(_seconds: float) -> None:
        nonlocal told
        end.tell(told, told * PERIOD, np.zeros(2))
        told += 1

    monkeypatch.setattr(watch_module.time, "sleep", tick)  # the loop goes on while the other process waits
    for number in range(FEWEST):
        pulse_s = (40 + 11 * number) * PERIOD
        watch.take(Frame(number, 5000.0 + pulse_s - 0.5 * PERIOD, 8e-3, pulse_s, np.full((240, 310), 2000, dtype=np.uint16)), None)
    assert (told, end.unplaced) == (64, 0), "the row after the middle of the last exposure, and no more"


@pytest.mark.parametrize(("skips", "looked_at"), [(True, 1), (False, 4)])
def test_of_frames_that_wait_only_the_newest_is_looked_at_unless_time_stands_still(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, skips: bool, looked_at: int
) -> None:
    machine = load_machine("carm")
    box, panel, is_over = Mailbox(CONTEXT, 2), nominal_detector(machine, 8), CONTEXT.Event()
    end = LoopEnd(box)
    for row in range(300):
        end.tell(row, row * PERIOD, np.zeros(2))
    for number in range(4):
        pulse_s = (40 + 11 * number) * PERIOD
        dark = np.arange(panel.rows * panel.columns, dtype=np.uint16).reshape(panel.rows, panel.columns) + np.uint16(number)
        write_frame(tmp_path, Frame(number, 5000.0 + pulse_s - 0.5 * PERIOD, 8e-3, pulse_s, dark))
    is_over.set()
    scan = tmp_path / "scan"
    scan.mkdir()
    written: list[int] = []

    class Noting(io.FileIO):
        def write(self, data: "ReadableBuffer") -> int:
            written.append(memoryview(data).nbytes)
            return super().write(data)

    class InPieces(receiver_module._InPieces, Noting):
        """As the receiver's, which hands its pieces to a file that notes their sizes."""

    monkeypatch.setattr(receiver_module, "_InPieces", InPieces)
    serve(ReceiverOrder(tmp_path, scan, panel, None, None, Live(machine, box, skips=skips)), is_over, CONTEXT.Event())
    assert (end.looked_at, end.skipped) == (looked_at, 4 - looked_at)
    kept = tifffile.imread(scan / FRAMES)
    assert kept.shape == (4, panel.rows, panel.columns), "all are kept"
    assert np.array_equal(kept, dark - np.uint16(3) + np.arange(4, dtype=np.uint16)[:, None, None]), "whole, though written in pieces"
    assert sum(written) > 4 * panel.rows * panel.columns * 2 > PIECE_BYTES >= max(written)


@pytest.mark.parametrize(("takes_s", "waits_s", "rests_s"), [(0.032, 0.0, [0.008] * 3), (0.032, 0.002, [0.006] * 3), (0.012, 0.02, [])])
def test_a_receiver_that_cannot_keep_up_leaves_some_time_to_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, takes_s: float, waits_s: float, rests_s: list[float]
) -> None:
    machine, is_over = load_machine("carm"), CONTEXT.Event()
    box, panel, scan = Mailbox(CONTEXT, 2), nominal_detector(machine, 8), tmp_path / "scan"
    scan.mkdir()
    for row in range(300):
        LoopEnd(box).tell(row, row * PERIOD, np.zeros(2))
    now_s, slept, polls = 0.0, [], 0

    class Frames:
        is_over = True

        def __init__(self, folder: Path) -> None:
            """Frames that come one by one, each as soon as the one before has been looked at, or later."""

        def poll(self) -> list[Frame]:
            nonlocal now_s, polls
            polls += 1
            if polls == 1:
                return []
            now_s += takes_s
            if polls == 4:
                is_over.set()
            at_s = 0.1 * polls
            return [Frame(polls, 5000.0 + at_s, 8e-3, at_s, np.zeros((panel.rows, panel.columns), dtype=np.uint16))]

        def wait(self, seconds: float) -> None:
            nonlocal now_s
            now_s += waits_s

    monkeypatch.setattr(receiver_module, "behind_the_loop", lambda: None)
    monkeypatch.setattr(receiver_module, "SpooledFrames", Frames)
    monkeypatch.setattr(receiver_module, "time", SimpleNamespace(monotonic=lambda: now_s, sleep=slept.append))
    serve(ReceiverOrder(tmp_path, scan, panel, None, None, Live(machine, box, skips=True, real_time=True)), is_over, CONTEXT.Event())
    assert not (scan / receiver_module.TROUBLE).exists()
    assert slept == pytest.approx(rests_s)
