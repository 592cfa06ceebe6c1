"""The frames of one tick of two axes, in virtual time, on a wire that answers by script."""

from __future__ import annotations

import dataclasses
import struct
from collections import deque
from collections.abc import Sequence

import can
from scripted_nodes import machine_settings

from drivers.canopen.cyclic import CyclicExchange
from drivers.canopen.heartbeat_consumer import HeartbeatConsumer
from drivers.canopen.network import PolledNetwork
from drivers.interface import Sample
from drivers.settings import Node

PERIOD_S, PATIENCE_S = 2.0**-8, 2.0**-9
SYNC = 0x080
NODES = machine_settings().nodes
IDS = (0x181, 0x182, 0x18B, 0x18C)  # of the answers: two drives, two encoders
Frame = tuple[float, int, bytes]
"""When it comes after its SYNC [s], identifier, data."""


def answer(can_id: int, counts: int = 0, delay_s: float = 0.0) -> Frame:
    data = struct.pack("<Hih", 0x0637, counts, 0) if can_id < 0x18B else struct.pack("<I", 4194304 + counts)
    return delay_s, can_id, data


ALL = [answer(can_id) for can_id in IDS]


class Wire(can.BusABC):
    """Virtual time; after SYNC k it brings what the script says, and of what comes too late the rest before the next."""

    def __init__(self) -> None:
        super().__init__(channel="wire")
        self.channel_info, self._is_shutdown = "wire", True
        self.time_s = 0.0
        self.script: deque[Sequence[Frame | can.Message]] = deque()
        self.usual: Sequence[Frame | can.Message] = ALL
        self.log: list[tuple[int, bytes]] = []
        self._due: list[tuple[float, can.Message]] = []

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        assert not msg.is_extended_id
        self.log.append((msg.arbitration_id, bytes(msg.data)))
        if msg.arbitration_id == SYNC:
            for frame in self.script.popleft() if self.script else self.usual:
                self.bring(frame)

    def bring(self, frame: Frame | can.Message) -> None:
        if isinstance(frame, can.Message):
            self._due.append((self.time_s, frame))
        else:
            delay_s, can_id, data = frame
            message = can.Message(arbitration_id=can_id, is_extended_id=False, data=data, timestamp=7.0)
            self._due.append((self.time_s + delay_s, message))
        self._due.sort(key=lambda due: due[0])

    def recv(self, timeout: float | None = None) -> can.Message | None:
        assert timeout is not None, "a tick waits for nothing without end"
        end = self.time_s + timeout
        if self._due and self._due[0][0] <= end:
            due_s, message = self._due.pop(0)
            self.time_s = max(self.time_s, due_s)
            return message
        self.time_s = end
        return None


class Ticks:
    """The clock of that wire: a tick begins a period after the one before."""

    def __init__(self, wire: Wire) -> None:
        self.wire, self.awake_s, self.missed, self.lateness_s = wire, 0.0, 0, 0.0
        self.tick_s = 0.0

    def now(self) -> float:
        return self.wire.time_s

    def wait_tick(self) -> float:
        self.tick_s += PERIOD_S
        self.wire.time_s = self.tick_s
        return self.lateness_s


class Machine:
    """Two axes on that wire."""

    def __init__(self, nodes: int = 4, awake_s: float = 0.0, all_nodes: Sequence[Node] = NODES, **changes: object) -> None:
        self.wire = Wire()
        self.clock = Ticks(self.wire)
        self.clock.awake_s = awake_s
        self.network = PolledNetwork(self.wire, self.clock)
        settings = dataclasses.replace(
            machine_settings(), nodes=tuple(all_nodes[:nodes]), sync_period_s=PERIOD_S, answer_timeout_s=PATIENCE_S
        )
        settings = dataclasses.replace(settings, **changes)
        self.heartbeats = HeartbeatConsumer(self.network, settings.nodes)
        self.cyclic = CyclicExchange(self.network, settings, self.heartbeats)
        self.sample = Sample(2)

    def tick(self, *frames: Frame | can.Message, efforts: Sequence[float] = (0.0, 0.0)) -> Sample:
        """Make one tick, after whose SYNC these frames come: all answers where none are given."""
        if frames:
            self.wire.script.append(frames)
        self.cyclic.run(efforts, self.sample)
        return self.sample

    def ticks(self, number: int) -> Machine:
        for _ in range(number):
            self.tick()
        return self


def but(can_id: int) -> list[Frame]:
    return [frame for frame in ALL if frame[1] != can_id]
