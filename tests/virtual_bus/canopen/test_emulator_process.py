"""The emulator on a python-can bus and the wall clock, with a client in another thread, until a signal comes."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable

import can
import numpy as np
import pytest
from device_wires import DRIVE_EDS, PERIOD_S, SpinningMasses, two_axis_bus
from pyModbusTCP.client import ModbusClient
from test_lockstep_machine import LAYOUT

from virtual_bus.canopen.bare import BareMachine
from virtual_bus.emulator import Ports, run_device, run_emulator
from virtual_bus.machine import EmulatedMachine
from virtual_bus.modbus.io_device import EmulatedIo
from virtual_bus.serial.xsens_imu import EmulatedImu

WAIT_S = 10.0  # a bound for a loaded machine, not an expectation


def ask(bus: can.BusABC, can_id: int, data: bytes, answer_id: int) -> bytes:
    bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
    while True:
        message = bus.recv(WAIT_S)
        assert message is not None, f"no {answer_id:03X}"
        if message.arbitration_id == answer_id:
            return bytes(message.data)


class Client(threading.Thread):
    """Runs the master's side, then ends the emulator by signal whatever happened."""

    def __init__(self, work: Callable[[], None], end_with: int) -> None:
        super().__init__()
        self._work, self._end_with = work, end_with
        self.failure: BaseException | None = None

    def run(self) -> None:
        try:
            self._work()
        except BaseException as failure:
            self.failure = failure
        os.kill(os.getpid(), self._end_with)


def emulate(channel: str, serve: Callable[[can.BusABC, Callable[..., None]], None], work: Callable[..., None], end_with: int) -> None:
    before = {signum: signal.getsignal(signum) for signum in {signal.SIGTERM, signal.SIGINT, end_with}}
    with can.Bus(channel, interface="virtual") as theirs, can.Bus(channel, interface="virtual") as ours:
        clients: list[Client] = []

        def ready(*ports: Ports) -> None:
            clients.append(Client(lambda: work(ours, *ports), end_with))
            clients[0].start()

        serve(theirs, ready)
        clients[0].join()
        if clients[0].failure is not None:
            raise clients[0].failure
    assert {signum: signal.getsignal(signum) for signum in before} == before, "the handlers found are put back"


STOPS = [getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGHUP", "SIGQUIT") if hasattr(signal, name)]


@pytest.mark.slow
@pytest.mark.parametrize("end_with", STOPS)
def test_a_bare_device_serves_until_it_is_told_to_stop(end_with: int) -> None:
    def work(bus: can.BusABC) -> None:
        answer = ask(bus, 0x605, bytes.fromhex("40 18 10 02 00 00 00 00"), 0x585)
        assert answer == bytes.fromhex("43 18 10 02 01 4F 53 49")
        ask(bus, 0x605, bytes.fromhex("2B 17 10 00 14 00 00 00"), 0x585)  # heartbeat every 20 ms
        heartbeats = 0
        while heartbeats < 3:
            message = bus.recv(WAIT_S)
            assert message is not None
            heartbeats += message.arbitration_id == 0x705

    emulate(f"bare{end_with}", lambda bus, ready: run_device(bus, BareMachine(DRIVE_EDS, 5), ready), work, end_with)


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo terminals here")
def test_the_whole_machine_has_its_bus_its_serial_port_and_its_modbus_server() -> None:
    physics = SpinningMasses()
    device = EmulatedIo(LAYOUT, physics.axes, on_brakes=physics.set_brakes)
    machine = EmulatedMachine(physics, two_axis_bus(), PERIOD_S, imu=EmulatedImu(), io=device)  # type: ignore[arg-type]
    machine.place(np.zeros(2))
    seen: list[Ports] = []

    def work(bus: can.BusABC, ports: Ports) -> None:
        seen.append(ports)
        for node in (1, 2, 11, 12):
            ask(bus, 0x600 + node, bytes.fromhex("40 00 10 00 00 00 00 00"), 0x580 + node)
        host, port = ports.io_url.removeprefix("tcp:").split(":")
        modbus = ModbusClient(host=host, port=int(port), unit_id=1, auto_open=True)
        assert modbus.write_single_coil(0, True)
        serial_port = os.open(ports.imu_device, os.O_RDWR | os.O_NOCTTY)
        os.write(serial_port, bytes.fromhex("FA FF 30 00 D1"))
        said = b""
        while b"\xfa\xff\x31\x00\xd0" not in said:
            said += os.read(serial_port, 256)
        os.close(serial_port)
        host, port = ports.imu_url.removeprefix("tcp:").split(":")
        with socket.create_connection((host, int(port)), WAIT_S) as line:
            line.sendall(bytes.fromhex("FA FF 30 00 D1"))
            said = b""
            while b"\xfa\xff\x31\x00\xd0" not in said:
                said += line.recv(256)
        for _ in range(20):
            bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
            bus.send(can.Message(arbitration_id=0x080, is_remote_frame=True, is_extended_id=False))
        ask(bus, 0x601, bytes.fromhex("40 00 10 00 00 00 00 00"), 0x581)
        assert physics.rows == 20, "one row per SYNC, and a remote frame is none"
        while not modbus.read_discrete_inputs(0, 1)[0]:  # the brake opens in the machine's own time
            bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
        modbus.close()

    emulate("machine", lambda bus, ready: run_emulator(bus, machine, ready), work, signal.SIGTERM)
    assert not physics.closed[0]
    assert not (sys.platform == "linux" and os.path.exists(seen[0].imu_device)), "the serial port is gone with the emulator"


def test_remote_frames_on_a_real_bus_are_ignored() -> None:
    def work(bus: can.BusABC) -> None:
        bus.send(can.Message(arbitration_id=0x605, is_remote_frame=True, dlc=8, is_extended_id=False))
        assert ask(bus, 0x605, bytes.fromhex("40 00 10 00 00 00 00 00"), 0x585)[0] == 0x43
        assert bus.recv(0.0) is None

    emulate("remote", lambda bus, ready: run_device(bus, BareMachine(DRIVE_EDS, 5), ready), work, signal.SIGTERM)


class StallingBus(can.BusABC):
    """Frames that lie in the queue when the emulator wakes after having stood still for so many seconds; then it is told to stop."""

    def __init__(self, stalls: list[tuple[float, can.Message | None]]) -> None:
        super().__init__("stalling")
        self.now_s = 0.0
        self._stalls = stalls

    def send(self, msg: can.Message, timeout: float | None = None) -> None: ...

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self._stalls:
            os.kill(os.getpid(), signal.SIGTERM)
            return None
        stall_s, message = self._stalls.pop(0)
        self.now_s += stall_s
        return message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stall_s", "looks", "periods"), [(5.0, 1, 0), (0.3, 4, 0), (0.002, 500, 256)], ids=["one stall", "four", "a silent bus"]
)
def test_an_emulator_that_stood_still_does_not_take_that_for_silence(
    monkeypatch: pytest.MonkeyPatch, stall_s: float, looks: int, periods: int
) -> None:
    """A SYNC has come while it stood still: one period passes, as without the stall. On a bus that is silent time goes on."""
    physics = SpinningMasses()
    machine = EmulatedMachine(physics, two_axis_bus(), PERIOD_S)  # type: ignore[arg-type]
    machine.place(np.zeros(2))
    sync = can.Message(arbitration_id=0x080, is_extended_id=False)
    bus = StallingBus([(0.0, sync), *[(stall_s, None)] * (looks - 1), (stall_s, sync)])
    monkeypatch.setattr("virtual_bus.emulator.time.perf_counter", lambda: bus.now_s)
    run_emulator(bus, machine, lambda ports: None)
    bus.shutdown()
    assert physics.advanced == pytest.approx(2 + periods, abs=1)
    assert physics.advanced == 2 or periods


class BusyBus(StallingBus):
    """A SYNC lies in the queue at every look, a period after the last: a master that is behind its time. It ends when `is_done` says so."""

    def __init__(self, is_done: threading.Event) -> None:
        super().__init__([])
        self._is_done = is_done

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self._is_done.is_set():
            self._stalls = [(PERIOD_S, can.Message(arbitration_id=0x080, is_extended_id=False))]
        return super().recv(timeout)


@pytest.mark.slow
@pytest.mark.parametrize("punctual", [True, False])
def test_the_io_answers_however_busy_the_bus_is(monkeypatch: pytest.MonkeyPatch, punctual: bool) -> None:
    device = EmulatedIo(LAYOUT, SpinningMasses().axes)
    machine = EmulatedMachine(SpinningMasses(), two_axis_bus(), PERIOD_S, io=device)  # type: ignore[arg-type]
    machine.place(np.zeros(2))
    answered, done = [], threading.Event()

    def ask_for_coil(url: str) -> None:
        host, port = url.removeprefix("tcp:").split(":")
        answered.append(ModbusClient(host=host, port=int(port), unit_id=1, timeout=WAIT_S).read_coils(0, 1))
        done.set()

    bus = BusyBus(done)
    monkeypatch.setattr("virtual_bus.emulator.time.perf_counter", lambda: bus.now_s)
    clients: list[threading.Thread] = []

    def ready(ports: Ports) -> None:
        clients.append(threading.Thread(target=ask_for_coil, args=(ports.io_url,)))
        clients[0].start()

    run_emulator(bus, machine, ready, punctual=punctual)
    clients[0].join()
    bus.shutdown()
    assert answered == [[False]]
