"""One wiring for all Modbus tests, and how to wait for another thread or process without guessing times."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from drivers.settings import IoMap
from virtual_bus.modbus.io_device import EmulatedIo, IoLayout
from virtual_bus.modbus.servers import ModbusRtuServer, ModbusTcpServer
from virtual_bus.serial.pty import Pty

AXES = ("propeller", "roll")
WIRING = {
    "unit_id": 17,
    "brake_coils": {"propeller": 1, "roll": 2},
    "brake_feedback_inputs": {"roll": 3, "propeller": 4},
    "hold_to_run_input": 8,
    "door_input": 9,
    "temperature_registers": {"propeller": 5, "roll": 2},
}
PATIENCE_S = 20.0
POLL_S = 0.001


def io_map(url: str = "", **changes: dict[str, int] | float) -> IoMap:
    return IoMap(**{"url": url, "poll_period_s": 0.05, "stale_after_s": 0.5, **WIRING, **changes})


def emulated_io(**options: object) -> EmulatedIo:
    return EmulatedIo(IoLayout(**WIRING), AXES, **options)


def eventually(condition: Callable[[], bool]) -> bool:
    """Whether the condition comes true while patience lasts."""
    give_up = time.monotonic() + PATIENCE_S
    pause = threading.Event()
    while not condition():
        if time.monotonic() > give_up:
            return False
        pause.wait(0.002)
    return True


class Polled:
    """Polls in a thread of its own what an emulator polls in its loop."""

    def __init__(self, poll: Callable[[], None]) -> None:
        self._end = threading.Event()
        self._poll = poll
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._end.is_set():
            self._poll()

    def end(self) -> None:
        self._end.set()
        self._thread.join()


class ServedTcp(ModbusTcpServer):
    """A device on TCP that answers all the time."""

    def __init__(self, device: EmulatedIo, port: int = 0) -> None:
        super().__init__(device, port=port)
        self._polled = Polled(lambda: self.poll(POLL_S))

    def close(self) -> None:
        self._polled.end()
        super().close()


class ServedRtu:
    """A device on a pseudo terminal that answers all the time; `device` is the bench's port."""

    def __init__(self, device: EmulatedIo) -> None:
        self._pty = pty = Pty()
        self.device = pty.path
        server = ModbusRtuServer(device, pty)

        def poll() -> None:
            pty.wait(POLL_S)
            server.poll()

        self._polled = Polled(poll)

    def close(self) -> None:
        self._polled.end()
        self._pty.close()
