"""The tests' own master on the lockstep bus: frames by hand from the standards, nothing of our drivers."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from typing import ClassVar

import can
import numpy as np
from device_wires import PERIOD_S, SpinningMasses, drive_settings, encoder_settings, two_axis_bus, u32

from virtual_bus.lockstep import LockstepBus
from virtual_bus.machine import EmulatedMachine
from virtual_bus.settings import EmulatedBus

SYNC = 0x080
OFF, NO_RTR = 1 << 31, 1 << 30


class Master:
    """One emulated machine and the frames a master exchanges with it."""

    open: ClassVar[list[Master]] = []  # to be shut down

    def __init__(self, bus: EmulatedBus | None = None, position: Sequence[float] = (0.0, 0.0), **machine_options: object) -> None:
        self.physics = SpinningMasses(("propeller", "roll")[2 - len(position) :])
        self.machine = EmulatedMachine(self.physics, bus or two_axis_bus(), PERIOD_S, **machine_options)  # type: ignore[arg-type]
        self.machine.place(np.array(position))
        self.log = io.StringIO()
        self.bus = LockstepBus(self.machine, self.log)
        self.seen: list[tuple[int, bytes]] = []
        Master.open.append(self)

    def send(self, can_id: int, data: bytes = b"") -> None:
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def drain(self, timeout_s: float = 0.0) -> list[tuple[int, bytes]]:
        got = []
        while (message := self.bus.recv(timeout_s)) is not None:
            got.append((message.arbitration_id, bytes(message.data)))
            timeout_s = 0.0
        self.seen += got
        return got

    def wait(self, seconds: float) -> list[tuple[int, bytes]]:
        """Let virtual time pass without a SYNC; everything that came."""
        self.bus.pass_time(seconds)
        return self.drain()

    def write(self, node: int, index: int, subindex: int, data: bytes) -> None:
        self.send(0x600 + node, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0"))
        answers = [data for can_id, data in self.drain() if can_id == 0x580 + node]
        assert answers, f"{node}: {index:04X}:{subindex}: {[a.hex() for a in answers]}"
        assert answers[0][0] == 0x60, f"{node}: {index:04X}:{subindex}: {[a.hex() for a in answers]}"

    def read(self, node: int, index: int, subindex: int = 0, signed: bool = False) -> int:
        self.send(0x600 + node, struct.pack("<BHB", 0x40, index, subindex) + bytes(4))
        answer = next(data for can_id, data in self.drain() if can_id == 0x580 + node)
        assert answer[0] & 0xE3 == 0x43, answer.hex()
        return int.from_bytes(answer[4 : 8 - (answer[0] >> 2 & 3)], "little", signed=signed)

    def map_pdo(self, node: int, communication: int, cob_id: int, mapped: Sequence[int]) -> None:
        cob_id |= NO_RTR if communication >= 0x1800 else 0
        self.write(node, communication, 1, u32(cob_id | OFF))
        self.write(node, communication + 0x200, 0, b"\0")
        for subindex, entry in enumerate(mapped, 1):
            self.write(node, communication + 0x200, subindex, u32(entry))
        self.write(node, communication, 2, b"\x01")
        self.write(node, communication + 0x200, 0, bytes((len(mapped),)))
        self.write(node, communication, 1, u32(cob_id))

    def configure(self, drives: Sequence[int] = (1, 2), encoders: Sequence[int] = (11, 12), heartbeat_ms: int = 0) -> None:
        """The PDOs of the shipped C-arm, mode torque, operational."""
        for node in drives:
            self.map_pdo(node, 0x1800, 0x180 + node, (0x60410010, 0x60640020, 0x60780010))
            self.map_pdo(node, 0x1400, 0x200 + node, (0x60400010, 0x60710010))
            self.write(node, 0x6060, 0, b"\x0a")
        for node in encoders:
            self.map_pdo(node, 0x1800, 0x180 + node, (0x60040020,))
        for node in (*drives, *encoders):
            if heartbeat_ms:
                self.write(node, 0x1017, 0, struct.pack("<H", heartbeat_ms))
            self.send(0x000, bytes((1, node)))
        self.drain()

    def tick(self, controlwords: dict[int, int], targets: dict[int, int]) -> dict[int, bytes]:
        """RPDOs, SYNC; what came back by identifier."""
        for node, word in controlwords.items():
            self.send(0x200 + node, struct.pack("<Hh", word, targets.get(node, 0)))
        self.send(SYNC)
        return dict(self.drain())

    def enable(self, *nodes: int) -> None:
        for word in (0x06, 0x07, 0x0F):
            self.tick(dict.fromkeys(nodes, word), {})

    def sample(self, node: int) -> tuple[int, int, int]:
        """statusword, position, current of one tick without new RPDOs."""
        return struct.unpack("<Hih", self.tick({}, {})[0x180 + node])


def one_axis_bus(**changes: object) -> EmulatedBus:
    return EmulatedBus(SYNC, (drive_settings(**changes),), (encoder_settings(),))


def one_axis(position: float = 0.0, **changes: object) -> Master:
    """A machine with one drive (node 2) and one encoder (node 12), configured and enabled, its brake worked by the drive."""
    master = Master(one_axis_bus(**changes), (position,))
    master.configure((2,), (12,))
    master.enable(2)
    return master
