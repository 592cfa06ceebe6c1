"""The emulated machine on a real bus and the wall clock: one process with one thread, until it is told to stop."""

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
from virtual_bus.special_frames import FLAGS, message_of

AWAKE_SHARE = 0.65
"""Share of a period before an expected SYNC during which the emulator stays awake. Where the kernel cannot be preempted, a process that
sleeps wakes up some milliseconds late one time in a thousand, while a system call has its processor; this leaves time for that."""
PREPARE_S = 400e-6
"""Time before an expected SYNC at which the emulator measures what it will be asked for, which takes a quarter of that."""
LATE_SHARE = 0.5
"""Share of a period for which the emulator goes on waiting awake after a SYNC was expected."""
STAY_SHARE = 0.1
"""Share of a period after a SYNC for which the emulator stays awake for the commands that answer it: to wake it would cost their sender
time."""
LATE_WEIGHT = 0.125
"""Share of a SYNC's lateness by which the next one is expected later: ticks are absolute, so one that is late says little of the next."""
POLL_S = 0.001  # longest wait for a frame on the bus, and how often the other wires are polled
POLL_AT_LEAST_S = 0.02  # the other wires are polled this often even when SYNCs leave no time for it
LOOK_S = 0.02
"""When a wait for a frame takes longer than this, this process was halted and the bus was not silent: the frames wait in the queue. So no
more than this counts as silence, and a loaded computer does not let the machine's time run on between two frames."""
SEND_ATTEMPTS = 20  # a full transmit queue empties within a few frame times; after that the frame is lost, as on a real controller
SEND_PAUSE_S = 0.0005
STOP_SIGNALS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGHUP", "SIGQUIT") if hasattr(signal, name))


class Emulated(Protocol):
    """Anything with a CAN connector: the whole machine, or one bare device."""

    def connect(self, emit: Emit) -> None:
        """Set where frames go."""

    def power_on(self) -> None:
        """Boot every device."""

    def receive(self, can_id: int, data: bytes) -> None:
        """Take one data frame from the bus."""

    def receive_remote(self, can_id: int) -> None:
        """Take one remote frame from the bus."""

    def idle(self, seconds: float) -> None:
        """Let that much time pass."""


@dataclass(frozen=True)
class Ports:
    """Where the machine's other wires end on this host; "" where it has none.

    The IMU's serial line ends in a pseudo terminal and in a TCP port.
    """

    imu_device: str = ""
    imu_url: str = ""
    io_url: str = ""
    io_line: str = ""


class SerialLine(Protocol):
    """The I/O device's end of a serial line."""

    @property
    def path(self) -> str:
        """The port's path."""

    def read(self) -> bytes:
        """Return all bytes that have arrived, or none."""

    def write(self, data: bytes) -> None:
        """Send bytes without waiting."""


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
        Called once, when everything listens, with the ports of IMU and I/O.
    io_line : SerialLine, optional
        A serial line on which the I/O device answers Modbus RTU beside its TCP port; it stays open.
    punctual : bool
        Wait for each SYNC awake; set it to False where bench and emulator have to share one processor.

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
        rehearse: Callable[[], None] = getattr(bus, "rehearse", lambda: None)  # some buses have it

        def prepare() -> None:
            machine.prepare()
            rehearse()

        tick: Tick | ProducedTick | None = None
        if machine.bus.produces_sync:
            tick = ProducedTick(machine, prepare)
        elif punctual:
            tick = Tick(machine.bus.sync_cob_id, machine.period_s, prepare)
        _serve(bus, machine, lambda: on_ready(ports), polls, tick, math.inf if machine.bus.by_the_wall else LOOK_S)


def run_device(bus: can.BusABC, device: Emulated, on_ready: Callable[[], None]) -> None:
    """Emulate one device until one of `STOP_SIGNALS` asks to end."""
    _serve(bus, device, on_ready, [], None)


def _connect_imu(machine: EmulatedMachine, imu: EmulatedImu, server: TcpLine, pty: Pty | None) -> Callable[[], None]:
    """Connect the IMU to its lines and return the function that polls them.

    What the IMU sends goes to whoever is connected to the TCP port, else to the pseudo terminal; both are listened to.
    """

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
    """The time at which the next SYNC is expected, and the work to do shortly before it."""

    sync_cob_id: int
    period_s: float
    prepare: Callable[[], None]
    _due_s: float = -math.inf
    _stay_s: float = -math.inf
    _prepared: bool = True

    def heard(self, can_id: int, now_s: float) -> None:
        """Take note of a frame that has come and been answered."""
        if can_id == self.sync_cob_id:
            late_s = now_s - self._due_s
            awaited = 0.0 < late_s < LATE_SHARE * self.period_s
            self._stay_s = now_s + STAY_SHARE * self.period_s
            self._due_s = (self._due_s + LATE_WEIGHT * late_s if awaited else now_s) + self.period_s
            self._prepared = False

    def is_near(self, now_s: float) -> bool:
        """Return whether a SYNC is due or was just answered: nothing else may take time then."""
        return now_s < self._stay_s or -AWAKE_SHARE * self.period_s <= now_s - self._due_s < LATE_SHARE * self.period_s

    def patience(self, now_s: float) -> float:
        """Return how long to sleep for a frame at most.

        0 around the time when a SYNC is due, for which the process waits awake, and shortly after.
        """
        if not self._prepared and now_s >= self._due_s - PREPARE_S:
            self._prepared = True
            self.prepare()
        if self.is_near(now_s):
            return 0.0
        ahead_s = self._due_s - AWAKE_SHARE * self.period_s - now_s
        return min(ahead_s, POLL_S) if ahead_s > 0.0 else POLL_S


@dataclass
class ProducedTick:
    """The time at which the machine's own producer sends the next SYNC, and the work to do shortly before it."""

    machine: EmulatedMachine
    prepare: Callable[[], None]
    _prepared: bool = False

    def heard(self, can_id: int, now_s: float) -> None:
        """Do nothing: frames do not move this tick."""

    def is_near(self, now_s: float) -> bool:
        """Return whether a SYNC is due: nothing else may take time then."""
        return self.machine.until_sync_s < PREPARE_S

    def patience(self, now_s: float) -> float:
        """Return how long to sleep for a frame at most; 0 shortly before a SYNC."""
        ahead_s = self.machine.until_sync_s - PREPARE_S
        if ahead_s > 0.0:
            self._prepared = False
            return min(ahead_s, POLL_S)
        if not self._prepared:
            self._prepared = True
            self.prepare()
        return 0.0


def _serve(
    bus: can.BusABC,
    device: Emulated,
    on_ready: Callable[[], None],
    polls: list[Callable[[], None]],
    tick: Tick | ProducedTick | None,
    look_s: float = LOOK_S,
) -> None:
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
            device.idle(min(now_s - last_s, look_s))
            last_s = now_s
            if message is None or message.is_error_frame or message.is_extended_id or message.is_fd:
                pass
            elif message.is_remote_frame:
                device.receive_remote(message.arbitration_id)
            else:
                device.receive(message.arbitration_id, bytes(message.data))
                if tick is not None:
                    tick.heard(message.arbitration_id, now_s)
            unpolled_s = now_s - polled_s
            if unpolled_s >= POLL_AT_LEAST_S or (unpolled_s >= POLL_S and not (tick is not None and tick.is_near(now_s))):
                polled_s = now_s
                for poll in polls:
                    poll()


def _sender(bus: can.BusABC) -> Emit:
    """Return the function that puts a frame on this bus and bridges a transmit queue that is full for a moment."""

    def send_message(can_id: int, data: bytes) -> None:
        bus.send(message_of(can_id, data))

    send_frame = getattr(bus, "send_frame", send_message)  # some buses do without the message object

    def send(can_id: int, data: bytes) -> None:
        for _ in range(SEND_ATTEMPTS):
            try:
                (send_message if can_id & FLAGS else send_frame)(can_id, data)
                return
            except can.CanOperationError:  # the transmit queue is full
                time.sleep(SEND_PAUSE_S)

    return send


@contextlib.contextmanager
def _long_lived_objects_frozen() -> Iterator[None]:
    """Exempt everything that exists when the emulator starts from garbage collection.

    A full collection would take longer than a sample period.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextlib.contextmanager
def _stop_on_signals() -> Iterator[Callable[[], bool]]:
    """Yield a function that says whether one of `STOP_SIGNALS` has come; the handlers found are put back."""
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
