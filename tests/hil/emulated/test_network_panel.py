"""A panel on the network: what its wire says, and what the emulated one sends of a machine that it only knows by SYNCs."""

from __future__ import annotations

import contextlib
import multiprocessing
import queue
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from queue import Queue

import numpy as np
import pytest

from drivers.errors import BusUnavailableError
from drivers.imaging import Frame, PanelClock, PanelError, PanelLink, panel_link
from drivers.imaging.panel_link import end_bytes, frame_bytes, read_command
from hil.emulated.beam import beam_of
from hil.emulated.network_panel import ServedPanel, serve
from hil.emulated.pose_board import KEPT, PoseBoard
from hil.errors import BadAnswerError
from hil.imaging.detector import Detector
from hil.imaging.nominal import body_frame, imaging_geometry, nominal_detector
from hil.machine import Machine as MachineSettings
from hil.machine import load_machine
from hil.receiving.frames_beside import frames_beside
from hil.receiving.panel_frames import PanelFrames, RemotePanel, RowSpan
from hil.receiving.receiver import ReceiverOrder, received
from virtual_bus.xray.motion import PoseTrack, XraySide

CARM = load_machine("carm")
PERIOD = 1.0 / CARM.sample_rate_Hz
CONTEXT = multiprocessing.get_context("spawn")
BEFORE, ROWS, RATE_Hz, BINNING = 400, 200, 7.31, 20
EARLIER_s = 1234.5
"""What the emulated machine's clock says at the first SYNC: nobody else knows it."""


def moving(rows: np.ndarray) -> np.ndarray:
    """Axis positions: a roll sweep at 30 deg/s."""
    return np.column_stack([np.full(len(rows), 0.4), -0.5 + np.radians(30.0) * PERIOD * rows])


def poses(rows: np.ndarray) -> list[np.ndarray]:
    """(N, 12) poses of tube and panel."""
    geometry, at = imaging_geometry(CARM), moving(rows)
    found = [body_frame(CARM, body, at) for body in (geometry.source_body, geometry.detector_body)]
    return [np.hstack([origin, np.reshape(rotation, (-1, 9))]) for origin, rotation in found]


class Machine:
    """SYNC after SYNC onto the board; rows are counted from the first one of the recording."""

    def __init__(self, period_s: float = PERIOD) -> None:
        self.board, self._next, self.period_s = PoseBoard(CONTEXT), 0, period_s
        self._tube, self._panel = poses(np.arange(-BEFORE, ROWS + 200))

    def sync(self, count: int) -> None:
        for _ in range(count):
            k = self._next
            self.board.put(k + 1, EARLIER_s + k * self.period_s, self._tube[k], self._panel[k])
            self._next += 1


GREETING = end_bytes(0)


class Ready:
    """Where the panel's process says its port."""

    def __init__(self) -> None:
        self._is_there, self.port = threading.Event(), 0

    def send(self, port: int) -> None:
        self.port = port
        self._is_there.set()

    def url(self) -> str:
        self._is_there.wait()
        return f"tcp:127.0.0.1:{self.port}"


@contextlib.contextmanager
def greeting(said: bytes = GREETING) -> Iterator[tuple[str, Queue]]:
    """What greets every caller so; yields its URL and a queue of the callers."""
    callers = queue.Queue()

    def greet() -> None:
        with contextlib.suppress(OSError):
            while True:
                caller, _ = listener.accept()
                caller.sendall(said)
                callers.put(caller)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=greet, daemon=True).start()
        yield f"tcp:127.0.0.1:{listener.getsockname()[1]}", callers


def served(machine: Machine, settings: MachineSettings = CARM) -> str:
    """URL of the emulated panel that follows this machine."""
    ready, order = Ready(), ServedPanel(settings, machine.board, beam_of(settings, "dodecahedron"))
    threading.Thread(target=serve, args=(order, ready), daemon=True).start()
    return ready.url()


@pytest.fixture(scope="module")
def acquired() -> tuple[list[Frame], Machine]:
    """Frames of a recording of ROWS rows, and the machine."""
    machine, span = Machine(), RowSpan(CONTEXT)
    source = PanelFrames(RemotePanel(served(machine), RATE_Hz, BINNING, PERIOD, span))
    machine.sync(BEFORE)
    assert source.poll() == [], "nobody has told it to expose"
    assert source.is_over, "nobody has told it to expose"
    span.begin(BEFORE)
    frames = []
    while not frames:  # the panel hears of it some time later, as it would
        machine.sync(1)
        frames += source.poll()
        source.wait(0.01)
    machine.sync(BEFORE + ROWS - machine._next)
    span.end(BEFORE + ROWS)
    machine.sync(100)
    while not source.is_over:
        frames += source.poll()
        source.wait(0.05)
    return frames, machine


def test_pulses_are_the_rows_in_which_they_were_seen_and_the_panels_clock_is_a_line_through_them(
    acquired: tuple[list[Frame], Machine],
) -> None:
    frames, _ = acquired
    assert [frame.exposure_id for frame in frames] == list(range(len(frames)))
    assert len(frames) >= 3
    rows = np.array([frame.pulse_s for frame in frames]) / PERIOD
    assert np.array_equal(rows, np.round(rows))
    assert rows[0] > 0.0
    assert rows[-1] <= ROWS
    panel = np.array([frame.panel_s for frame in frames])
    assert np.allclose(np.diff(panel), 1.0 / RATE_Hz, rtol=1e-9), "the rate is the panel's, by its own clock"
    clock = PanelClock(panel, rows * PERIOD, PERIOD)
    assert np.all(np.abs(clock.to_loop(panel) - (rows - 0.5) * PERIOD) <= 0.51 * PERIOD)


def test_an_image_is_of_where_the_machine_was_at_its_pulse(acquired: tuple[list[Frame], Machine]) -> None:
    """Rendered anew from the motion in closed form: 30 deg/s move the panel by a pixel within one tick."""
    frames, _ = acquired
    geometry, beam, detector = imaging_geometry(CARM), beam_of(CARM, "dodecahedron"), nominal_detector(CARM, BINNING)
    rows = np.arange(-BEFORE, ROWS + 200)
    tracks = [PoseTrack(rows * PERIOD, each[:, :3] - geometry.isocenter_m, each[:, 3:].reshape(-1, 3, 3)) for each in poses(rows)]
    side = XraySide(*tracks, geometry.source_position_m, geometry.detector_center_m, beam.spot, 0.0)
    frame = frames[-1]

    def difference(start_s: float) -> float:
        again = beam.image(side, start_s, frame.width_s, detector, np.random.default_rng(1)).astype(float)
        return np.sqrt(np.mean((np.clip(again, 0, 4000) - np.clip(frame.image, 0, 4000)) ** 2))

    found = {ticks: difference(frame.pulse_s + (ticks - 0.5) * PERIOD) for ticks in (-4, -2, 0, 2, 4)}
    assert min(found, key=found.get) == 0, found


def test_images_that_came_too_late_are_lost_and_no_other() -> None:
    machine = Machine()
    for k in range(KEPT + 100):
        machine.board.put(k, k * PERIOD, np.zeros(12), np.zeros(12))
    newest = (KEPT + 99) * PERIOD
    assert machine.board.now_s == newest
    assert machine.board.around(0.5, 0.51, 4) is None
    assert machine.board.around(newest, newest, 4) is None, "what follows is not known yet"
    span = machine.board.around(newest - 1.0, newest - 0.99, 4)
    assert span.time_s[4] >= newest - 1.0 > span.time_s[3]
    assert np.array_equal(span.sync * PERIOD, span.time_s)


def test_a_panel_is_one_hosts_and_the_next_ones_when_that_has_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    url = served(Machine())
    first = PanelLink(url, PERIOD)
    with monkeypatch.context() as impatient:
        impatient.setattr(panel_link, "GREETING_TIMEOUT_S", 0.1)
        with pytest.raises(BusUnavailableError, match=r"has not greeted within 0\.1 s; name a panel, and one that nobody else uses now"):
            PanelLink(url, PERIOD)
    first.close()
    PanelLink(url, PERIOD).close()


def test_exposures_end_where_the_machines_time_stands_still_and_at_a_slow_rate_none_is_lost() -> None:
    """At 50 Hz what an exposure's motion is interpolated through takes three times as long as at 256 Hz."""
    period_s = 0.02
    slow = replace(CARM, sample_rate_Hz=1.0 / period_s, plant=replace(CARM.plant, sample_period_s=period_s))
    machine, span, frames = Machine(period_s), RowSpan(CONTEXT), []
    source = PanelFrames(RemotePanel(served(machine, slow), RATE_Hz, BINNING, period_s, span))
    machine.sync(100)
    span.begin(100)
    while len(frames) < 3:
        machine.sync(1)
        frames += source.poll()
        source.wait(0.01)
    span.end(machine._next)  # the next exposure has begun, and no SYNC comes any more
    while not source.is_over:
        frames += source.poll()
        source.wait(0.01)
    assert [frame.exposure_id for frame in frames] == list(range(len(frames)))


def test_frames_of_before_row_0_and_of_after_the_last_are_left_out() -> None:
    span = RowSpan(CONTEXT)
    with greeting() as (url, callers):
        source = PanelFrames(RemotePanel(url, RATE_Hz, BINNING, PERIOD, span))
        span.begin(99)  # row 0 is the hundredth
        span.end(300)
        assert source.poll() == []
        assert not source.is_over
        with callers.get() as panel:
            image = np.ones((2, 3), np.uint16)
            syncs = (90, 100, 101, 298, 299, 310)
            sent = [frame_bytes(k, sync, 5000.0 + sync * PERIOD, 2.0 * PERIOD, image) for k, sync in enumerate(syncs)]
            panel.sendall(b"".join(sent) + end_bytes(len(sent)))
            frames = []
            while not source.is_over:
                source.wait(5.0)
                frames += source.poll()
    assert [round(frame.pulse_s / PERIOD) for frame in frames] == [1, 198]


@pytest.fixture
def wire() -> Iterator[tuple[PanelLink, socket]]:
    """A link and the panel's end of its line."""
    with greeting() as (url, callers):
        link = PanelLink(url, PERIOD)
        with callers.get() as other:
            yield link, other
        link.close()


def test_frames_come_whole_whatever_pieces_they_come_in(wire: tuple[PanelLink, socket]) -> None:
    link, panel = wire
    link.expose(7.236, 4, first_sync=1000)
    assert read_command(panel.recv(100).rstrip(b"\n")) == (7.236, 4)
    image = np.arange(24, dtype=np.uint16).reshape(4, 6)
    data = frame_bytes(3, 1064, 5000.25, 0.008, image) + end_bytes(4)
    found = []
    for piece in (data[:10], data[10:50], data[50:]):
        panel.sendall(piece)
        link.wait(5.0)
        found += link.poll()
    (frame,) = found
    assert (frame.exposure_id, frame.pulse_s, frame.panel_s, frame.width_s) == (3, 64 * PERIOD, 5000.25, 0.008)
    assert np.array_equal(frame.image, image)
    assert link.exposures == 4
    link.stop()
    assert read_command(panel.recv(100).rstrip(b"\n")) is None
    panel.close()
    assert link.poll() == [], "a panel that has said that it ended may go"
    waited: list[float] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(panel_link.time, "sleep", waited.append)
        link.wait(0.01)
    assert waited == [0.01], "whoever waits for one that is gone does not spin"


@pytest.mark.parametrize(("said", "line"), [(b"HTTP/1.1 400 Bad Request" * 3, "what it sends is no frame"), (b"", "it hung up")])
def test_what_is_no_panel_is_told(wire: tuple[PanelLink, socket], said: bytes, line: str) -> None:
    link, panel = wire
    panel.sendall(said)
    panel.shutdown(socket.SHUT_WR)
    link.wait(5.0)
    with pytest.raises(PanelError, match=line):
        link.poll()


@pytest.mark.slow
def test_a_panel_that_hangs_up_during_a_run_is_told_at_once_and_again_when_that_is_over(tmp_path: Path) -> None:
    span, told = RowSpan(CONTEXT), queue.Queue()
    with greeting() as (url, callers):
        order = ReceiverOrder(RemotePanel(url, RATE_Hz, BINNING, PERIOD, span), tmp_path, Detector(6, 4, 1e-3), None, None)
        with frames_beside(order, None, told.put):
            callers.get().close()  # who looked whether it is there
            with callers.get() as panel:
                span.begin(0)
                assert read_command(panel.recv(100).rstrip(b"\n")) == (RATE_Hz, BINNING)
            assert told.get(timeout=60.0) == f"panel {url} is gone: it hung up: no more images; the run goes on without"
            span.end(ROWS)
    with pytest.raises(BadAnswerError, match=f"panel {url} is gone: it hung up"):
        received(tmp_path, PERIOD)
    assert told.empty()


def test_an_address_where_no_panel_is_and_commands_that_are_none() -> None:
    for url in ("127.0.0.1", f"tcp:{'a' * 64}:4100", "tcp:a..b:4100"):
        with pytest.raises(BusUnavailableError, match="its address reads tcp:HOST:PORT"):
            PanelLink(url, PERIOD)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(BusUnavailableError, match="Connection refused; name a panel that is on"):
        PanelLink(f"tcp:127.0.0.1:{port}", PERIOD)
    with (
        greeting(b"+OK " * 9) as (url, _),
        pytest.raises(BusUnavailableError, match=r"what it sends is no frame \(2b 4f 4b 20 .*\); this version's begin with 49 58 46 31"),
    ):
        PanelLink(url, PERIOD)
    for line in (b"expose", b"expose 0 4", b"expose 7 0", b"expose nan 4", b"\xff", b"halt"):
        with pytest.raises(PanelError, match="a panel is told"):
            read_command(line)
