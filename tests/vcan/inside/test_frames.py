"""Frames sent through python-can are on the wire as candump sees them, over vcan0 and through a serial adapter."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import can
import pytest
from witnesses import Candump, SlcanAdapter

pytestmark = pytest.mark.vcan

ECHO = """
import can, sys
with can.Bus(sys.argv[1], interface="socketcan") as bus:
    print("ready", flush=True)
    for _ in range(int(sys.argv[2])):
        frame = bus.recv(30.0)
        bus.send(can.Message(arbitration_id=frame.arbitration_id + 0x80, data=frame.data[::-1], is_extended_id=False))
"""


def test_two_processes_exchange_frames_and_candump_saw_each(interface: str, candump: Callable[[str], Candump]) -> None:
    witness = candump(interface)
    with subprocess.Popen([sys.executable, "-c", ECHO, interface, "20"], stdout=subprocess.PIPE, text=True) as echo:
        assert echo.stdout is not None
        assert echo.stdout.readline() == "ready\n"
        with can.Bus(interface, interface="socketcan") as bus:
            for number in range(20):
                bus.send(can.Message(arbitration_id=0x181, data=bytes([number, 1, 2]), is_extended_id=False))
                answer = bus.recv(30.0)
                assert answer is not None
                assert bytes(answer.data) == bytes([2, 1, number])
    expected = [frame for number in range(20) for frame in (f"181#{number:02X}0102", f"201#0201{number:02X}")]
    assert [frame for frame in witness.frames() if frame[:3] in ("181", "201")] == expected  # a supervisor may still be stopping a machine


def test_a_serial_adapter_carries_frames_both_ways(slcan_adapter: SlcanAdapter, candump: Callable[[str], Candump]) -> None:
    witness = candump(slcan_adapter.interface)
    with (
        can.Bus(slcan_adapter.pty, interface="slcan", bitrate=1_000_000) as laptop,
        can.Bus(slcan_adapter.interface, interface="socketcan") as machine,
    ):
        laptop.send(can.Message(arbitration_id=0x201, data=b"\x0f\x00\x10\x00", is_extended_id=False))
        down = machine.recv(30.0)
        assert down is not None
        assert (down.arbitration_id, bytes(down.data)) == (0x201, b"\x0f\x00\x10\x00")
        machine.send(can.Message(arbitration_id=0x181, data=bytes(range(8)), is_extended_id=False))
        up = laptop.recv(30.0)
        while up is not None and up.arbitration_id != 0x181:
            up = laptop.recv(30.0)
        assert up is not None
        assert bytes(up.data) == bytes(range(8))
    assert [frame for frame in witness.frames() if frame[:3] in ("201", "181")] == ["201#0F001000", "181#0001020304050607"]
