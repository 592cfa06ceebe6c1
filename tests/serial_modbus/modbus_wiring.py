"""One wiring for all Modbus tests, and how to wait for another thread or process without guessing times."""

import threading
import time
from collections.abc import Callable

from drivers.settings import IoMap
from virtual_bus.modbus.io_device import EmulatedIo, IoLayout

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


def io_map(url: str = "", **changes) -> IoMap:
    return IoMap(**{"url": url, "poll_period_s": 0.05, "stale_after_s": 0.5, **WIRING, **changes})


def emulated_io(**options) -> EmulatedIo:
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
