"""Answers that come after their tick: rows never lag behind for longer than the tick that was late."""

from __future__ import annotations

import dataclasses
import struct
from collections import deque

import can
import pytest
from scripted_nodes import PERIOD_S, BusClock, ScriptedBus, machine_settings

from drivers.canopen.cyclic import CyclicExchange
from drivers.canopen.heartbeat_consumer import HeartbeatConsumer
from drivers.canopen.network import PolledNetwork
from drivers.interface import Sample

SYNC, TPDO = 0x080, 0x181
LOOK_S = 1e-5


class SlowBus(ScriptedBus):
    """One drive whose position is the number of the SYNC it answers; `delays` are its answers' delays [s], in turn, None: lost."""

    def __init__(self, delays: list[float | None]) -> None:
        super().__init__()
        self._delays = deque(delays)
        self._syncs = 0
        self._due: deque[tuple[float, bytes]] = deque()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if msg.arbitration_id == SYNC:
            self._syncs += 1
            delay = self._delays.popleft() if self._delays else 0.0
            if delay is not None:
                self._due.append((self.time_s + delay, struct.pack("<Hih", 0x0637, self._syncs, 0)))
            self.pass_time(0.0)

    def pass_time(self, seconds: float) -> None:
        self.time_s += seconds
        while self._due and self._due[0][0] <= self.time_s + 1e-12:
            self.emit(TPDO, self._due.popleft()[1])


class TickingClock(BusClock):
    """Ticks a period apart, however long the answers took."""

    next_tick_s = 0.0

    def wait_tick(self) -> float:
        self.next_tick_s += PERIOD_S
        self.bus.pass_time(max(0.0, self.next_tick_s - self.bus.time_s))
        return 0.0


class LookedAtBus(SlowBus):
    """To look takes time, and so it passes for who waits awake."""

    looks = 0

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self.looks += 1
        if timeout == 0.0:
            self.pass_time(LOOK_S)
        return super().recv(timeout)


def rows(delays: list[float | None], ticks: int, awake_s: float = 0.0) -> list[float]:
    """Per tick, the number of the SYNC whose answer the row holds; NaN where it holds none."""
    bus = LookedAtBus(delays)
    bus_settings = machine_settings(("roll",), io=False)
    bus_settings = dataclasses.replace(bus_settings, nodes=bus_settings.nodes[:1])
    clock = TickingClock(bus)
    clock.awake_s = awake_s
    network = PolledNetwork(bus, clock)
    cyclic = CyclicExchange(network, bus_settings, HeartbeatConsumer(network, bus_settings.nodes))
    resolution = bus_settings.scalings[0].sign * bus_settings.scalings[0].position_resolution
    sample = Sample(1)
    seen = []
    for _ in range(ticks):
        cyclic.run([0.0], sample)
        seen.append(float(sample.position[0]) / resolution)
    looks = awake_s / LOOK_S + 10.0
    assert bus.looks <= ticks * looks, "who has waited awake for long enough sleeps"
    return seen


LOST = float("nan")


@pytest.mark.parametrize(
    ("delays", "expected"),
    [
        ([0.0, 0.0, 0.8 * PERIOD_S, 0.0], [1, 2, LOST, 4, 5, 6]),
        ([0.0, 0.0, 1.2 * PERIOD_S, 0.0], [1, 2, LOST, 4, 5, 6]),
        ([0.0, 0.0, 2.3 * PERIOD_S, 0.0, 0.0], [1, 2, LOST, LOST, 5, 6]),
        ([0.0, 0.0, None, 0.0], [1, 2, LOST, 4, 5, 6]),
        ([0.0, 0.0, None, 0.0, None, 0.0], [1, 2, LOST, 4, LOST, 6]),
        ([0.0, 0.0] + [1.2 * PERIOD_S] * 6, [1, 2] + [LOST] * 6),
        ([0.0, 0.0] + [2.2 * PERIOD_S] * 6, [1, 2] + [LOST] * 6),
        ([0.0, 0.0] + [1.2 * PERIOD_S] * 3 + [0.0] * 3, [1, 2, LOST, LOST, LOST, 6, 7, 8]),
    ],
    ids=[
        "before the next SYNC",
        "after the next SYNC",
        "after two SYNCs",
        "never",
        "never, twice",
        "always late from the third on",
        "later still",
        "late three times",
    ],
)
@pytest.mark.parametrize("awake_s", [0.0, 5e-4, 1.0], ids=["asleep", "awake at first", "awake"])
def test_a_late_answer_is_not_taken_for_the_next_syncs(delays: list[float | None], expected: list[float], awake_s: float) -> None:
    assert rows(delays, len(expected), awake_s) == pytest.approx(expected, nan_ok=True)
