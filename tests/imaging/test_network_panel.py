"""A panel on the network: what its wire says, and what the emulated one sends of a machine that it only knows by SYNCs."""

import multiprocessing
import socket
import threading

import numpy as np
import pytest
from calibration.commands import isocenter

from drivers.errors import BusUnavailable
from drivers.imaging import PanelClock, PanelError, PanelLink
from drivers.imaging.panel_link import end_bytes, frame_bytes, read_command
from hil.imaging.beam import beam_of
from hil.imaging.mailbox import LETTERS, LoopEnd, Mailbox, Sighting
from hil.imaging.network_panel import ServedPanel, serve
from hil.imaging.nominal import body_frame, imaging_geometry, nominal_detector
from hil.imaging.panel_frames import PanelFrames, RemotePanel, RowSpan
from hil.imaging.pose_board import KEPT, PoseBoard
from hil.machine import load_machine
from virtual_bus.xray.motion import PoseTrack, XraySide

CARM = load_machine("carm")
PERIOD = 1.0 / CARM.sample_rate_Hz
CONTEXT = multiprocessing.get_context("spawn")
BEFORE, ROWS, RATE_Hz, BINNING = 400, 200, 7.31, 20
EARLIER_s = 1234.5
"""What the emulated machine's clock says at the first SYNC: nobody else knows it."""


def moving(rows):
    """Axis positions: a roll sweep at 30 deg/s."""
    return np.column_stack([np.full(len(rows), 0.4), -0.5 + np.radians(30.0) * PERIOD * rows])


def poses(rows):
    """(N, 12) poses of tube and panel."""
    geometry, at = imaging_geometry(CARM), moving(rows)
    found = [body_frame(CARM, body, at) for body in (geometry.source_body, geometry.detector_body)]
    return [np.hstack([origin, np.reshape(rotation, (-1, 9))]) for origin, rotation in found]


class Machine:
    """SYNC after SYNC onto the board; rows are counted from the first one of the recording."""

    def __init__(self):
        self.board, self._next = PoseBoard(CONTEXT), 0
        self._tube, self._panel = poses(np.arange(-BEFORE, ROWS + 200))

    def sync(self, count):
        for _ in range(count):
            k = self._next
            self.board.put(k + 1, EARLIER_s + k * PERIOD, self._tube[k], self._panel[k])
            self._next += 1


class Ready:
    """Where the panel's process says its port."""

    def __init__(self):
        self._is_there, self.port = threading.Event(), 0

    def send(self, port):
        self.port = port
        self._is_there.set()

    def url(self):
        self._is_there.wait()
        return f"tcp:127.0.0.1:{self.port}"


@pytest.fixture(scope="module")
def acquired():
    """Frames of a recording of ROWS rows, and the machine."""
    machine, ready, span = Machine(), Ready(), RowSpan(CONTEXT)
    threading.Thread(target=serve, args=(ServedPanel(CARM, machine.board, beam_of(CARM, "dodecahedron")), ready), daemon=True).start()
    source = PanelFrames(RemotePanel(ready.url(), RATE_Hz, BINNING, PERIOD, span))
    machine.sync(BEFORE)
    assert source.poll() == [] and source.is_over, "nobody has told it to expose"
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


def test_pulses_are_the_rows_in_which_they_were_seen_and_the_panels_clock_is_a_line_through_them(acquired):
    frames, _ = acquired
    assert [frame.exposure_id for frame in frames] == list(range(len(frames))) and len(frames) >= 3
    rows = np.array([frame.pulse_s for frame in frames]) / PERIOD
    assert np.array_equal(rows, np.round(rows)) and rows[0] > 0.0 and rows[-1] <= ROWS
    panel = np.array([frame.panel_s for frame in frames])
    assert np.allclose(np.diff(panel), 1.0 / RATE_Hz, rtol=1e-9), "the rate is the panel's, by its own clock"
    clock = PanelClock(panel, rows * PERIOD, PERIOD)
    assert np.all(np.abs(clock.to_loop(panel) - (rows - 0.5) * PERIOD) <= 0.51 * PERIOD)


def test_an_image_is_of_where_the_machine_was_at_its_pulse(acquired):
    """Rendered anew from the motion in closed form: 30 deg/s move the panel by a pixel within one tick."""
    frames, _ = acquired
    geometry, beam, detector = imaging_geometry(CARM), beam_of(CARM, "dodecahedron"), nominal_detector(CARM, BINNING)
    rows = np.arange(-BEFORE, ROWS + 200)
    tracks = [PoseTrack(rows * PERIOD, each[:, :3] - geometry.isocenter_m, each[:, 3:].reshape(-1, 3, 3)) for each in poses(rows)]
    side = XraySide(*tracks, geometry.source_position_m, geometry.detector_center_m, beam.spot, 0.0)
    frame = frames[-1]

    def difference(start_s):
        again = beam.image(side, start_s, frame.width_s, detector, np.random.default_rng(1)).astype(float)
        return np.sqrt(np.mean((np.clip(again, 0, 4000) - np.clip(frame.image, 0, 4000)) ** 2))

    found = {ticks: difference(frame.pulse_s + (ticks - 0.5) * PERIOD) for ticks in (-4, -2, 0, 2, 4)}
    assert min(found, key=found.get) == 0, found


def test_images_that_came_too_late_are_lost_and_no_other():
    machine = Machine()
    for k in range(KEPT + 100):
        machine.board.put(k, k * PERIOD, np.zeros(12), np.zeros(12))
    newest = (KEPT + 99) * PERIOD
    assert machine.board.now_s == newest and machine.board.around(0.5, 0.51, 4) is None
    assert machine.board.around(newest, newest, 4) is None, "what follows is not known yet"
    span = machine.board.around(newest - 1.0, newest - 0.99, 4)
    assert span.time_s[4] >= newest - 1.0 > span.time_s[3] and np.array_equal(span.sync * PERIOD, span.time_s)


def test_a_lost_tick_shifts_the_loops_time_against_the_count_of_syncs():
    box = Mailbox(CONTEXT, 2)
    end = LoopEnd(box)
    for row in (0, 1, 2, 5, 6):  # two ticks were lost
        end.tell(row, row * PERIOD, np.zeros(2))
    assert box.loop_time(1.25 * PERIOD, PERIOD) == pytest.approx(1.25 * PERIOD)
    assert box.loop_time(3.5 * PERIOD, PERIOD) == pytest.approx(5.5 * PERIOD)
    assert np.isnan(box.loop_time(4.5 * PERIOD, PERIOD)), "of a row that has not been told"


def test_what_a_full_mailbox_has_no_place_for_is_counted_and_what_it_holds_is_whole():
    box = Mailbox(CONTEXT, 2)
    end = LoopEnd(box)
    for number in range(LETTERS + 3):
        box.send(Sighting(number, number, 0.1 * number, "phantom", np.zeros(2), np.full(9, number), np.eye(9)))
    assert end.lost == 3
    assert [(each.exposure_id, each.values[0]) for each in end.collect(0)] == [(k, k) for k in range(LETTERS)]
    box.send(Sighting(99, 99, 9.9, "phantom", np.zeros(2), np.zeros(9), np.eye(9)))
    assert [each.exposure_id for each in end.collect(1)] == [99] and end.lost == 3


@pytest.fixture
def wire():
    """A link and the panel's end of its line."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        link = PanelLink(f"tcp:127.0.0.1:{listener.getsockname()[1]}", PERIOD)
        other, _ = listener.accept()
        with other:
            yield link, other
        link.close()


def test_frames_come_whole_whatever_pieces_they_come_in(wire):
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
    assert np.array_equal(frame.image, image) and link.exposures == 4
    link.stop()
    assert read_command(panel.recv(100).rstrip(b"\n")) is None
    panel.close()
    assert link.poll() == [], "a panel that has said that it ended may go"


@pytest.mark.parametrize(("said", "line"), [(b"HTTP/1.1 400 Bad Request" * 3, "what it sends is no frame"), (b"", "it hung up")])
def test_what_is_no_panel_is_told(wire, said, line):
    link, panel = wire
    panel.sendall(said)
    panel.shutdown(socket.SHUT_WR)
    link.wait(5.0)
    with pytest.raises(PanelError, match=line):
        link.poll()


def test_an_address_where_no_panel_is_and_commands_that_are_none():
    with pytest.raises(BusUnavailable, match="its address reads tcp:HOST:PORT"):
        PanelLink("127.0.0.1", PERIOD)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(BusUnavailable, match="Connection refused; name a panel that is on"):
        PanelLink(f"tcp:127.0.0.1:{port}", PERIOD)
    for line in (b"expose", b"expose 0 4", b"expose 7 0", b"expose nan 4", b"\xff", b"halt"):
        with pytest.raises(PanelError, match="a panel is told"):
            read_command(line)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["-b", "lockstep:", "--panel", "tcp:127.0.0.1:1"], "--panel: on lockstep: the emulated panel has its own; leave it out"),
        (["-b", "udp:239.74.163.99"], "--images: nobody says where the panel of udp:239.74.163.99 is"),
        (["-b", "udp:", "--panel", "tcp:127.0.0.1:1", "--spool", "."], "--spool and --panel: frames come from one of them"),
        (["-b", "udp:", "--panel", "tcp:127.0.0.1:1", "--scene", "nothing"], "scene nothing: there are dodecahedron, "),
        (["-b", "udp:", "--panel", "there"], "panel there: its address reads tcp:HOST:PORT"),
    ],
)
def test_nobody_moves_before_it_is_known_where_frames_come_from(tmp_path, capsys, arguments, line):
    static = ["run", "static", "-m", "carm", "--seconds", "0.5", "-o", tmp_path / "r.mf4", "--images", tmp_path / "s"]
    assert isocenter(*static, *arguments) == 2
    error = capsys.readouterr().err
    assert line in error and error.count("\n") == 1
