"""Frames of the lean SocketCAN bus against python-can's own codec; over a real vcan0 it is tested in tests/vcan."""

from __future__ import annotations

import errno
import socket
import struct
from collections.abc import Iterator

import can
import pytest
from can.interfaces.socketcan import socketcan
from can.interfaces.socketcan.socketcan import build_can_frame, dissect_can_frame
from hypothesis import given
from hypothesis import strategies as st

from drivers import bus_url
from drivers.bus_url import open_bus
from drivers.socketcan_bus import PythonCanBus, SocketcanBus, message_of


@st.composite
def messages(draw: st.DrawFn) -> can.Message:
    extended, kind = draw(st.booleans()), draw(st.sampled_from(["data", "remote", "error"]))
    data = draw(st.binary(max_size=8))
    return can.Message(
        arbitration_id=draw(st.integers(0, (1 << (29 if extended else 11)) - 1)),
        is_extended_id=extended,
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        dlc=len(data),
        data=b"" if kind == "remote" else data,
    )


class Line(SocketcanBus):
    """That bus on one end of a pair of packet sockets: this kernel may know no CAN."""

    def __init__(self, end: socket.socket) -> None:
        self.socket = end
        self.socket.setblocking(False)
        self.channel, self._is_filtered, self._is_shutdown = "pair", False, True
        can.BusABC.__init__(self, "pair")

    def _apply_filters(self, filters: object) -> None:
        """Leave the filters to `recv`: this socket has none of the kernel's."""


def flood(bus: Line) -> None:
    for _ in range(1_000_000):
        bus.send_frame(0x181, bytes(8))


@pytest.fixture
def ends() -> Iterator[tuple[Line, socket.socket]]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        yield Line(ours), theirs


@given(messages())
def test_a_frame_is_read_as_python_can_writes_it(message: can.Message) -> None:
    read = message_of(build_can_frame(message))
    assert read.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)


def test_frames_go_out_as_python_can_reads_them(ends: tuple[Line, socket.socket]) -> None:
    bus, other = ends
    bus.send_frame(0x181, b"\x01\x02")
    assert dissect_can_frame(other.recv(100)) == (0x181, 2, 0, b"\x01\x02")
    bus.send(can.Message(arbitration_id=0x1ABCDEF, data=b"\x03"))
    assert dissect_can_frame(other.recv(100)) == (0x8000_0000 | 0x1ABCDEF, 1, 0, b"\x03")


def test_nothing_there_is_none_at_once_and_after_the_time_out(ends: tuple[Line, socket.socket]) -> None:
    bus, _ = ends
    assert bus.recv(0.0) is None
    assert bus.recv(0.001) is None


def test_what_the_filters_leave_out_does_not_come(ends: tuple[Line, socket.socket]) -> None:
    bus, other = ends
    bus.set_filters([{"can_id": 0x181, "can_mask": 0x7FF}])
    for identifier in (0x182, 0x181):
        other.send(build_can_frame(can.Message(arbitration_id=identifier, is_extended_id=False, data=b"\x07")))
    message = bus.recv(1.0)
    assert message is not None
    assert message.arbitration_id == 0x181
    assert bus.recv(0.0) is None


def test_a_full_queue_and_a_lost_interface_are_errors_of_python_can(ends: tuple[Line, socket.socket]) -> None:
    bus, other = ends
    with pytest.raises(can.CanOperationError, match="transmit buffer full"):
        flood(bus)
    other.close()
    with pytest.raises(can.CanOperationError, match="failed to send") as lost:
        bus.send_frame(0x181, bytes(8))
    assert lost.value.error_code in (errno.EPIPE, errno.ECONNRESET)


def test_it_is_python_cans_bus_in_all_else() -> None:
    assert issubclass(SocketcanBus, PythonCanBus)


class StampingSocket(socket.socket):
    """A packet socket whose messages the kernel has stamped long ago."""

    def recvmsg(self, *sizes: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:  # type: ignore[override]
        stamp = (socket.SOL_SOCKET, socketcan.constants.SO_TIMESTAMPNS, struct.pack("@ll", 1000, 250_000_000))
        return self.recv(sizes[0]), [stamp], 0, None


def test_a_stamped_bus_gives_the_kernels_time_of_a_frame_that_was_read_late(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    end = StampingSocket(ours.family, ours.type, ours.proto, ours.detach())
    monkeypatch.setattr(socketcan, "create_socket", lambda: end)
    monkeypatch.setattr(socketcan, "bind_socket", lambda sock, channel: None)
    monkeypatch.setattr(bus_url, "_check_socketcan", lambda *of: None)
    with theirs, open_bus("socketcan:pair", 1_000_000, stamped=True) as bus:
        theirs.send(build_can_frame(can.Message(arbitration_id=0x705, is_extended_id=False, data=b"\x05")))
        message = bus.recv(1.0)
    assert message is not None
    assert message.arbitration_id == 0x705
    assert message.timestamp == 1000.25
