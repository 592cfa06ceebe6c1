"""A bus that only one process can open: what passes is passed on, and what the supervisor sends is sent."""

from __future__ import annotations

import socket

import can
import pytest

from drivers.shared_memory.supervisor_blocks import FRAME
from drivers.supervisor_link.tapped_bus import TappedBus


def test_data_frames_of_both_directions_are_passed_on_and_the_supervisors_are_sent() -> None:
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    there.setblocking(False)
    here.settimeout(10.0)
    with can.Bus("tapped", interface="virtual") as other, can.Bus("tapped", interface="virtual") as owned:
        bus = TappedBus(owned, there)
        other.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=b"\x01\x02"))
        other.send(can.Message(arbitration_id=0x181, is_extended_id=True, data=b"\x09"))
        other.send(can.Message(arbitration_id=0x181, is_extended_id=False, is_remote_frame=True))
        other.send(can.Message(arbitration_id=0x181, is_extended_id=False, is_error_frame=True))
        assert [bus.recv(0.0) is not None for _ in range(5)] == [True] * 4 + [False]
        here.send(FRAME.pack(0x601, 2, b"\x02\x01"))
        bus.send(can.Message(arbitration_id=0x080, is_extended_id=False, data=b""))
        heard = [FRAME.unpack(here.recv(FRAME.size)) for _ in range(2)]
        assert [(can_id, data[:length]) for can_id, length, data in heard] == [(0x181, b"\x01\x02"), (0x080, b"")]
        sent = [other.recv(0.0), other.recv(0.0)]
        assert [(m.arbitration_id, bytes(m.data)) for m in sent if m is not None] == [(0x080, b""), (0x601, b"\x02\x01")]
        assert not any(message.is_extended_id for message in sent if message is not None)
        assert bus.recv(0.0) is None
        here.settimeout(0.0)
        with pytest.raises(BlockingIOError):
            here.recv(FRAME.size)
        bus.shutdown()
    here.close()
