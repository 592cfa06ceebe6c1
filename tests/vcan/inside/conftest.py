"""Witnesses for the tests on vcan0: candump from can-utils, and the kernel's own slcan driver behind a pty."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import threading
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import can
import pytest

LISTENING_PROBE = 0x7FF
"""An identifier nobody on a CANopen bus uses; seen in candump's output, it proves that candump listens."""

DEADLINE_S = 30.0


@dataclass
class Candump:
    """A running candump, the independent witness of the frames on an interface."""

    process: subprocess.Popen[str]
    interface: str

    def frames(self) -> list[str]:
        """Stop listening; every frame since the start as `ID#DATA`, in order."""
        with can.Bus(self.interface, interface="socketcan") as bus:
            bus.send(can.Message(arbitration_id=LISTENING_PROBE, data=b"\x02", is_extended_id=False))
        assert self.process.stdout is not None
        seen = []
        for line in self.process.stdout:
            frame = line.split()[2]
            if frame == f"{LISTENING_PROBE:03X}#02":
                break
            if not frame.startswith(f"{LISTENING_PROBE:03X}#"):
                seen.append(frame)
        self.process.terminate()
        self.process.wait(DEADLINE_S)
        return seen


@pytest.fixture
def interface() -> str:
    """The SocketCAN interface under test."""
    return os.environ["ISOCENTER_VCAN"]


@pytest.fixture
def candump() -> Iterator[Callable[[str], Candump]]:
    """Start candump on an interface; it is known to listen when this returns."""
    running: list[Candump] = []

    def start(interface: str) -> Candump:
        process = subprocess.Popen(["candump", "-L", interface], stdout=subprocess.PIPE, text=True, bufsize=1)
        assert process.stdout is not None
        with can.Bus(interface, interface="socketcan") as bus:
            for _ in range(1000):
                bus.send(can.Message(arbitration_id=LISTENING_PROBE, data=b"\x01", is_extended_id=False))
                if select.select([process.stdout], [], [], 0.05)[0]:
                    break
            else:
                pytest.fail(f"candump saw nothing on {interface}")
        running.append(Candump(process, interface))
        return running[-1]

    yield start
    for witness in running:
        witness.process.kill()
        witness.process.wait(DEADLINE_S)


@dataclass(frozen=True)
class SlcanAdapter:
    """A service laptop's serial CAN adapter: a pty to open with python-can's slcan, and the CAN interface on its far side."""

    pty: str
    interface: str


@pytest.fixture
def slcan_adapter() -> Iterator[SlcanAdapter]:
    """The kernel's slcan driver behind a pair of ptys. Needs the slcan module and root, as the user-mode kernel has."""
    laptop_master, laptop_slave = os.openpty()
    kernel_master, kernel_slave = os.openpty()
    for terminal in (laptop_slave, kernel_slave, laptop_master, kernel_master):
        with contextlib.suppress(OSError):
            tty.setraw(terminal)
    attach = subprocess.Popen(["slcand", "-F", os.ttyname(kernel_slave), "slcan0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    stop_read, stop_write = os.pipe()

    def bridge() -> None:
        other = {laptop_master: kernel_master, kernel_master: laptop_master}
        while True:
            ready = select.select([laptop_master, kernel_master, stop_read], [], [])[0]
            if stop_read in ready:
                return
            for terminal in ready:
                with contextlib.suppress(OSError):
                    os.write(other[terminal], os.read(terminal, 4096))

    worker = threading.Thread(target=bridge, daemon=True)
    worker.start()
    try:
        for _ in range(int(DEADLINE_S / 0.05)):
            if subprocess.run(["ip", "link", "set", "slcan0", "up"], capture_output=True, check=False).returncode == 0:
                break
            select.select([], [], [], 0.05)
        else:
            pytest.fail("slcan0 did not appear: " + (attach.stdout.read() if attach.stdout and attach.poll() is not None else "slcand is silent"))
        yield SlcanAdapter(os.ttyname(laptop_slave), "slcan0")
    finally:
        attach.terminate()
        os.write(stop_write, b"x")
        worker.join(DEADLINE_S)
        attach.wait(DEADLINE_S)
        for descriptor in (laptop_master, laptop_slave, kernel_master, kernel_slave, stop_read, stop_write):
            os.close(descriptor)
