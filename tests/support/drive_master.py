"""A master of one emulated drive in any mode of operation: targets and offsets by RPDO, what the drive makes of them by TPDO."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from lockstep_client import SYNC, Master, one_axis_bus

NODE = 2
# objects in the order of the frames
RPDOS = (
    (0x200 + NODE, 0x1400, (0x60400010, 0x60600008, 0x60710010), "<Hbh"),
    (0x300 + NODE, 0x1401, (0x607A0020, 0x60FF0020), "<ii"),
    (0x400 + NODE, 0x1402, (0x60B00020, 0x60B10020), "<ii"),
    (0x500 + NODE, 0x1403, (0x60B20010,), "<h"),
)
TPDOS = (
    (0x180 + NODE, 0x1800, (0x60410010, 0x60640020, 0x60740010), "<Hih"),
    (0x280 + NODE, 0x1801, (0x60620020, 0x606B0020), "<ii"),
    (0x380 + NODE, 0x1802, (0x60F40020, 0x60610008), "<ib"),
)


@dataclass
class Asked:
    """What the master sends before a SYNC."""

    word: int = 0x0F
    mode: int = 0
    torque: int = 0
    position: int = 0
    velocity: int = 0
    position_offset: int = 0
    velocity_offset: int = 0
    torque_offset: int = 0


@dataclass(frozen=True)
class Answer:
    """What the drive says after a SYNC."""

    statusword: int
    position: int
    torque: int
    position_demand: int
    velocity_demand: int
    following_error: int
    mode: int

    @property
    def state(self) -> int:
        return self.statusword & (0x4F if self.statusword & 0x48 in (0x40, 0x08) else 0x6F)


class DriveMaster(Master):
    """One drive on a mass that spins freely, all targets in its RPDOs."""

    def __init__(self, position: float = 0.0, mode: int = 0, **changes: object) -> None:
        super().__init__(one_axis_bus(**changes), (position,))
        self.asked = Asked(mode=mode)
        self.again()

    def again(self) -> DriveMaster:
        """Configure and start the node, also after a reset; itself."""
        for cob_id, communication, mapped, _ in RPDOS:
            self.map_pdo(NODE, communication, cob_id, mapped)
        for cob_id, communication, mapped, _ in TPDOS:
            self.map_pdo(NODE, communication, cob_id, mapped)
        self.send(0x000, bytes((1, NODE)))
        return self

    @property
    def drive(self) -> object:
        return self.machine.drives["roll_drive"]

    def announce(self, **changes: int) -> None:
        """Send what is asked, without a SYNC."""
        asked = self.asked
        for name, value in changes.items():
            assert hasattr(asked, name)
            setattr(asked, name, value)
        values = (
            (asked.word, asked.mode, asked.torque),
            (asked.position, asked.velocity),
            (asked.position_offset, asked.velocity_offset),
            (asked.torque_offset,),
        )
        for (cob_id, _, _, layout), row in zip(RPDOS, values, strict=True):
            self.send(cob_id, struct.pack(layout, *row))

    def step(self, **changes: int) -> Answer:
        """RPDOs, SYNC, and what came back."""
        self.announce(**changes)
        self.send(SYNC)
        frames = dict(self.drain())
        status, demand, error = (struct.unpack(layout, frames[cob_id]) for cob_id, _, _, layout in TPDOS)
        return Answer(*status, *demand, *error)

    def steps(self, count: int, **changes: int) -> Answer:
        """Several samples of the same; the last answer."""
        answer = self.step(**changes)
        for _ in range(count - 1):
            answer = self.step()
        return answer

    def switch_on(self, **changes: int) -> Answer:
        """To OPERATION_ENABLED."""
        for word in (0x06, 0x07, 0x0F):
            answer = self.step(word=word, **changes)
        return answer

    def set(self, index: int, value: int, layout: str = "<I", subindex: int = 0) -> None:
        self.write(NODE, index, subindex, struct.pack(layout, value))

    def get(self, index: int, subindex: int = 0, signed: bool = False) -> int:
        return self.read(NODE, index, subindex, signed)
