"""The emulated machine on a real bus and the wall clock: a process of its own, one thread, until it is told to stop."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Protocol

import can

from virtual_bus.canopen.node import Emit
from virtual_bus.errors import BusLostError
from virtual_bus.machine import EmulatedMachine
from virtual_bus.modbus.servers import ModbusRtuServer, ModbusTcpServer
from virtual_bus.serial.pty import Pty
from virtual_bus.serial.tcp_line import TcpLine
from virtual_bus.serial.xsens_imu import EmulatedImu

AWAKE_SHARE = 0.65
"""Of a period, for so long before a SYNC is expected the emulator stays awake. A process that sleeps waits for whatever system call has its
processor, some milliseconds one time in a thousand where the kernel cannot be preempted; it has then time to be late."""
PREPARE_S = 400e-6
"""So long before a SYNC is expected the emulator measures what it will be asked for, which takes a fourth of that."""
LATE_SHARE = 0.5
"""Of a period, for so long after a SYNC was expected it goes on waiting awake."""
STAY_SHARE = 0.1
"""Of a period, for so long after a SYNC it stays awake for the commands that answer it: waking it would cost their sender as much time."""
LATE_WEIGHT = 0.125
"""How far a SYNC that comes late moves when the next one is expected: ticks are absolute, and one that is late says little of the next."""
POLL_S = 0.001  # how long one look at the bus takes at most, and how often the other wires are looked at
POLL_AT_LEAST_S = 0.02  # the other wires are looked at so often even when SYNCs leave no time between them
LOOK_S = 0.02
"""A look at the bus that took longer was this process standing still, not the bus: what has come meanwhile lies in the queue. No more than
that passes as silence, so that a loaded computer does not let the machine's time run on between two frames."""
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
    """Where the machine's other wires end on this host; "" where it has none. The IMU's serial line is a pseudo terminal and a TCP port."""

    imu_device: str = ""
    imu_url: str = ""
    io_url: str = ""
    io_line: str = ""


class SerialLine(Protocol):
    """The I/O device's end of a serial line; `path` is the port."""

    @property
    def path(self) -> str: ...
    def read(self) -> bytes: ...
    def write(self, data: bytes) -> None: ...


def run_emulator(
    bus: can.BusABC,
    machine: EmulatedMachine,
    on_ready: Callable[[Ports], None],
    *,
    io_line: SerialLine | None = None,
    punctual: bool = True,
) -> None:
    """Emulate a machine until one of `STOP_SIGNALS` asks to end.

    Parameters
    ----------
    bus : can.BusABC
        Any python-can bus; it stays open.
    machine : EmulatedMachine
        Placed, not yet powered on.
    on_ready : callable
        Told once where IMU and I/O are reachable, when everything listens.
    io_line : SerialLine, optional
        A serial line on which the I/O device answers Modbus RTU beside its TCP port; it stays open.
    punctual : bool
        Await each SYNC awake; not where bench and emulator have to share one processor.

    Raises
    ------
    BusLostError
        The bus cannot be read any more.
    """
    with contextlib.ExitStack() as open_ports:
        imu_device = imu_url = io_url = ""
        polls: list[Callable[[], None]] = []
        if machine.imu is not None:
            server = open_ports.enter_context(contextlib.closing(TcpLine()))
            pty = open_ports.enter_context(contextlib.closing(Pty())) if hasattr(os, "openpty") else None
            imu_device, imu_url = pty.path if pty is not None else "", server.url
            polls.append(_connect_imu(machine, machine.imu, server, pty))
        if machine.io is not None:
            modbus = open_ports.enter_context(contextlib.closing(ModbusTcpServer(machine.io)))
            io_url = modbus.url
            polls.append(modbus.poll)
            if io_line is not None:
                polls.append(ModbusRtuServer(machine.io, io_line).poll)
        ports = Ports(imu_device, imu_url, io_url, io_line.path if io_line is not None else "")
        rehearse: Callable[[], None] = getattr(bus, "rehearse", lambda: None)  # some buses can

        def prepare() -> None:
            machine.prepare()
            rehearse()

        tick = Tick(machine.bus.sync_cob_id, machine.period_s, prepare) if punctual else None
        _serve(bus, machine, lambda: on_ready(ports), polls, tick)


def run_device(bus: can.BusABC, device: Emulated, on_ready: Callable[[], None]) -> None:
    """Emulate one device until one of `STOP_SIGNALS` asks to end."""
    _serve(bus, device, on_ready, [], None)


def _connect_imu(machine: EmulatedMachine, imu: EmulatedImu, server: TcpLine, pty: Pty | None) -> Callable[[], None]:
    """What the IMU says goes to whoever is connected to the TCP port, else to the pseudo terminal; both are listened to."""

    def say(data: bytes) -> None:
        if server.connected:
            server.write(data)
        elif pty is not None:
            pty.write(data)

    def listen() -> None:
        if heard := server.read():
            server.write(imu.receive(heard))
        if pty is not None and (heard := pty.read()):
            pty.write(imu.receive(heard))

    machine.imu_out = say
    return listen


@dataclass
class Tick:
    """When the next SYNC is expected, and what is done shortly before."""

    sync_cob_id: int
    period_s: float
    prepare: Callable[[], None]
    _due_s: float = -math.inf
    _stay_s: float = -math.inf
    _prepared: bool = True

    def heard(self, can_id: int, now_s: float) -> None:
        """A frame has come and been answered."""
        if can_id == self.sync_cob_id:
            late_s = now_s - self._due_s
            awaited = 0.0 < late_s < LATE_SHARE * self.period_s
            self._stay_s = now_s + STAY_SHARE * self.period_s
            self._due_s = (self._due_s + LATE_WEIGHT * late_s if awaited else now_s) + self.period_s
            self._prepared = False

    def is_near(self, now_s: float) -> bool:
        """A SYNC is due, or just answered: nothing else may take time now."""
        return now_s < self._stay_s or -AWAKE_SHARE * self.period_s <= now_s - self._due_s < LATE_SHARE * self.period_s

    def patience(self, now_s: float) -> float:
        """How long to sleep for a frame at most; 0 around the time when a SYNC is due, which is awaited spinning, and shortly after."""
        if not self._prepared and now_s >= self._due_s - PREPARE_S:
            self._prepared = True
            self.prepare()
        if self.is_near(now_s):
            return 0.0
        ahead_s = self._due_s - AWAKE_SHARE * self.period_s - now_s
        return min(ahead_s, POLL_S) if ahead_s > 0.0 else POLL_S


def _serve(bus: can.BusABC, device: Emulated, on_ready: Callable[[], None], polls: list[Callable[[], None]], tick: Tick | None) -> None:
    device.connect(_sender(bus))
    with _stop_on_signals() as stopped, _long_lived_objects_frozen():
        device.power_on()
        on_ready()
        last_s = polled_s = time.perf_counter()
        while not stopped():
            patience_s = tick.patience(last_s) if tick is not None else POLL_S
            try:
                message = bus.recv(patience_s)
            except (can.CanError, OSError) as error:
                raise BusLostError(f"{bus.channel_info}: the bus is gone: {error}; the emulated devices are off") from error
            now_s = time.perf_counter()
            device.idle(min(now_s - last_s, LOOK_S))
            last_s = now_s
            if message is not None and not (message.is_remote_frame or message.is_error_frame or message.is_extended_id):
                device.receive(message.arbitration_id, bytes(message.data))
                if tick is not None:
                    tick.heard(message.arbitration_id, now_s)
            unpolled_s = now_s - polled_s
            if unpolled_s >= POLL_AT_LEAST_S or (unpolled_s >= POLL_S and not (tick is not None and tick.is_near(now_s))):
                polled_s = now_s
                for poll in polls:
                    poll()


def _sender(bus: can.BusABC) -> Emit:
    """What puts a frame on this bus, bridging a transmit queue that is full for a moment."""

    def send_message(can_id: int, data: bytes) -> None:
        bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    send_frame = getattr(bus, "send_frame", send_message)  # some buses do without the message object

    def send(can_id: int, data: bytes) -> None:
        for _ in range(SEND_ATTEMPTS):
            try:
                send_frame(can_id, data)
                return
            except can.CanOperationError:  # the transmit queue is full
                time.sleep(SEND_PAUSE_S)

    return send


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
