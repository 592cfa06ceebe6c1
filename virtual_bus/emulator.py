"""The emulated machine on a real bus and the wall clock: a process of its own, one thread, until it is told to stop."""

from __future__ import annotations

import contextlib
import gc
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Protocol

import can

from virtual_bus.canopen.node import Emit
from virtual_bus.machine import EmulatedMachine
from virtual_bus.modbus.servers import ModbusTcpServer
from virtual_bus.serial.pty import Pty

POLL_S = 0.001  # how long one look at the bus takes at most: the grain of time while nothing comes
SEND_ATTEMPTS = 20  # a full transmit queue empties within a few frame times; after that the frame is lost, as on a real controller
SEND_PAUSE_S = 0.0005
STOP_SIGNALS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGHUP", "SIGQUIT") if hasattr(signal, name))


class Emulated(Protocol):
    """Anything with a CAN connector: the whole machine, or one bare device."""

    def connect(self, emit: Emit) -> None: ...
    def power_on(self) -> None: ...
    def receive(self, can_id: int, data: bytes) -> None: ...
    def idle(self, seconds: float) -> None: ...


@dataclass(frozen=True)
class Ports:
    """Where the machine's other wires end on this host; "" where it has none."""

    imu_device: str = ""
    io_url: str = ""


def run_emulator(bus: can.BusABC, machine: EmulatedMachine, on_ready: Callable[[Ports], None], io_port: int = 0) -> None:
    """Emulate a machine until one of `STOP_SIGNALS` asks to end.

    Parameters
    ----------
    bus : can.BusABC
        Any python-can bus; it stays open.
    machine : EmulatedMachine
        Placed, not yet powered on.
    on_ready : callable
        Told once where IMU and I/O are reachable, when everything listens.
    io_port : int
        TCP port of the I/O device; 0 takes any.
    """
    with contextlib.ExitStack() as open_ports:
        line = None
        io_url = ""
        if machine.imu is not None:
            line = open_ports.enter_context(contextlib.closing(Pty()))
            machine.imu_out = line.write
        if machine.io is not None:
            server = open_ports.enter_context(contextlib.closing(ModbusTcpServer(machine.io, port=io_port)))
            io_url = server.url
        ports = Ports(imu_device=line.path if line is not None else "", io_url=io_url)
        _serve(bus, machine, lambda: on_ready(ports), _imu_listener(machine, line))


def run_device(bus: can.BusABC, device: Emulated, on_ready: Callable[[], None]) -> None:
    """Emulate one device until one of `STOP_SIGNALS` asks to end."""
    _serve(bus, device, on_ready, lambda: None)


def _imu_listener(machine: EmulatedMachine, line: Pty | None) -> Callable[[], None]:
    def listen() -> None:
        if line is not None and machine.imu is not None and (heard := line.read()):
            line.write(machine.imu.receive(heard))

    return listen


def _serve(bus: can.BusABC, device: Emulated, on_ready: Callable[[], None], listen: Callable[[], None]) -> None:
    device.connect(lambda can_id, data: _send(bus, can_id, data))
    with _stop_on_signals() as stopped, _long_lived_objects_frozen():
        device.power_on()
        on_ready()
        last_s = time.perf_counter()
        while not stopped():
            message = bus.recv(POLL_S)
            now_s = time.perf_counter()
            device.idle(now_s - last_s)
            last_s = now_s
            if message is not None and not (message.is_remote_frame or message.is_error_frame or message.is_extended_id):
                device.receive(message.arbitration_id, bytes(message.data))
            listen()


def _send(bus: can.BusABC, can_id: int, data: bytes) -> None:
    message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
    for _ in range(SEND_ATTEMPTS):
        try:
            bus.send(message)
            return
        except can.CanOperationError:  # the transmit queue is full
            time.sleep(SEND_PAUSE_S)


@contextlib.contextmanager
def _long_lived_objects_frozen() -> Iterator[None]:
    """Everything there is when the emulator starts is exempt from garbage collection: a full collection would take longer than a period."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextlib.contextmanager
def _stop_on_signals() -> Iterator[Callable[[], bool]]:
    """A flag that `STOP_SIGNALS` raise; the handlers found are put back."""
    stop = False

    def ask(signum: int, frame: FrameType | None) -> None:
        nonlocal stop
        stop = True

    before = {signum: signal.signal(signum, ask) for signum in STOP_SIGNALS}
    try:
        yield lambda: stop
    finally:
        for signum, handler in before.items():
            signal.signal(signum, handler)
