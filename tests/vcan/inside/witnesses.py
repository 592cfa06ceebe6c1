"""The witness on an interface, candump from can-utils, and where a serial adapter is."""

from __future__ import annotations

import select
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import can
import pytest

PROBE = 0x7FF
"""An identifier nobody on a CANopen bus uses; seen in candump's output, it proves that candump listens."""

START, END = b"\x01", b"\x02"
DEADLINE_S = 30.0
POLL_S = 0.05


@dataclass
class Candump:
    """A running candump, the independent witness of the frames on an interface. It writes to a file, so nobody has to keep reading."""

    process: subprocess.Popen[bytes]
    interface: str
    log: Path

    def frames(self) -> list[str]:
        """Stop listening; every frame since the start as `ID#DATA`, in order."""
        return [frame for _, frame in self.stamped_frames()]

    def stamped_frames(self) -> list[tuple[float, str]]:
        """The same, each with its time [s]."""
        _send_probe(self.interface, END)
        self.wait_for(END)
        self.process.terminate()
        self.process.wait(DEADLINE_S)
        seen = [line.split() for line in self.log.read_text().splitlines()]
        return [(float(time_s.strip("()")), frame) for time_s, _, frame in seen if not frame.startswith(f"{PROBE:03X}#")]

    def wait_for(self, mark: bytes) -> None:
        """Wait until a probe with this mark stands in the log."""
        text = f"{PROBE:03X}#{mark.hex().upper()}"
        deadline = time.monotonic() + DEADLINE_S
        while text not in self.log.read_text():
            if time.monotonic() > deadline:
                pytest.fail(f"candump has not seen {text} on {self.interface} within {DEADLINE_S:.0f} s")
            if mark == START:
                _send_probe(self.interface, mark)
            select.select([], [], [], POLL_S)


def _send_probe(interface: str, mark: bytes) -> None:
    with can.Bus(interface, interface="socketcan") as bus:
        bus.send(can.Message(arbitration_id=PROBE, data=mark, is_extended_id=False))


@dataclass(frozen=True)
class SlcanAdapter:
    """A service laptop's serial CAN adapter: a pty to open with python-can's slcan, and the CAN interface on its far side."""

    pty: str
    interface: str
