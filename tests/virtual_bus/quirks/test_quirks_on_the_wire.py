"""Every quirk shows on the wire: a master that sends the same frames sees other ones than from a drive of the standard."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from bench_machines import CARM

from hil.emulated.machine import build_emulated
from virtual_bus.errors import FaultError
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.faults.motion_log import MotionLog
from virtual_bus.lockstep import LockstepBus
from virtual_bus.quirks.quirk import QuirkSetting
from virtual_bus.quirks.registry import parse_quirks, quirks

NODE, DRIVE = 2, "roll_drive"
NMT, SYNC, OFF, NO_RTR = 0x000, 0x080, 1 << 31, 1 << 30
START, RESET_COMMUNICATION = 1, 0x82
SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP, HALT, RESET, HOME = 0x06, 0x07, 0x0F, 0x02, 0x100, 0x80, 0x1F
TORQUE, VELOCITY, HOMING = 10, 9, 6
READ = (
    *((index, 0) for index in (0x1000, 0x1001, 0x1008, 0x6502, 0x6061, 0x60A9, 0x6071)),
    *((0x1018, 3), (0x608F, 1), (0x6091, 1), (0x6092, 1)),
)
AT_MOST_S = 4.5  # longer than the slowest of them takes


class Script:
    """A master's frames, whatever is answered, and everything that comes."""

    def __init__(self, *names: str) -> None:
        settings = tuple(QuirkSetting(DRIVE, name) for name in names)
        machine = build_emulated(CARM, np.array([0.0, 0.1]), motion=MotionLog(CARM.axes), quirks=settings, noise=False)
        assert isinstance(machine, FaultyMachine)
        self.machine, self.bus, self.seen = machine, LockstepBus(machine), []
        self.controlword = 0

    def send(self, can_id: int, data: bytes = b"") -> None:
        self.bus.send_frame(can_id, data)
        frames = self.bus.waiting_frames()
        while frames:
            self.seen.append((round(self.bus.time_s, 4), *frames.popleft()))

    def wait(self, seconds: float) -> None:
        self.bus.pass_time(seconds)
        self.send(0x7FF)  # means nothing: takes what has come

    def read(self, index: int, subindex: int = 0) -> None:
        self.send(0x600 + NODE, struct.pack("<BHB4x", 0x40, index, subindex))

    def write(self, index: int, subindex: int, layout: str, value: int) -> None:
        data = struct.pack(layout, value)
        self.send(0x600 + NODE, struct.pack("<BHB", 0x23 | 4 - len(data) << 2, index, subindex) + data.ljust(4, b"\0"))

    def ticks(self, count: int, controlword: int, torque: int = 0) -> None:
        for _ in range(count):
            self.send(0x200 + NODE, struct.pack("<Hh", controlword, torque))
            self.send(SYNC)

    def map_pdo(self, communication: int, cob_id: int, *entries: int) -> None:
        self.write(communication, 1, "<I", cob_id | OFF)
        self.write(communication + 0x200, 0, "<B", 0)
        for number, entry in enumerate(entries, start=1):
            self.write(communication + 0x200, number, "<I", entry)
        self.write(communication + 0x200, 0, "<B", len(entries))
        self.write(communication, 2, "<B", 1)
        self.write(communication, 1, "<I", cob_id)

    def play(self) -> list[tuple[float, int, bytes]]:
        """Boot, read, configure, change modes, home, enable, halt, stop, fail and reset."""
        self.wait(0.1)
        self.send(NMT, bytes((RESET_COMMUNICATION, NODE)))
        self.wait(0.02)
        for index, subindex in READ:
            self.read(index, subindex)
        self.write(0x1016, 1, "<I", 127 << 16 | 10_000)
        self.write(0x1017, 0, "<H", 100)
        self.write(0x1400, 5, "<H", 0)
        self.write(0x605A, 0, "<h", 6)
        self.map_pdo(0x1400, 0x200 + NODE, 0x60400010, 0x60710010)
        self.map_pdo(0x1800, NO_RTR | 0x180 + NODE, 0x60410010, 0x60640020)
        self.map_pdo(0x1801, NO_RTR | 0x280 + NODE, 0x606C0020)
        self.send(NMT, bytes((START, NODE)))
        self.ticks(3, 0)
        for word in (SHUTDOWN, SWITCH_ON, ENABLE):
            self.ticks(2, word)
        self.ticks(2, 0)
        self.write(0x6060, 0, "<b", HOMING)
        self.read(0x6061)
        self.write(0x6098, 0, "<b", 35)
        self.read(0x6098)
        for word in (SHUTDOWN, SWITCH_ON, ENABLE):
            self.ticks(2, word)
        self.ticks(40, HOME)
        self.write(0x6060, 0, "<b", TORQUE)
        self.send(0x200 + NODE, struct.pack("<Hh", ENABLE, 0))
        self.read(0x6040)  # an RPDO waits for its SYNC
        self.send(SYNC)
        self.ticks(20, ENABLE, 300)
        self.ticks(20, ENABLE, 500)
        self.ticks(5, ENABLE | HALT)
        brakes = np.ones(len(self.machine.physics.axes), bool)
        self.machine.physics.set_brakes(~brakes)
        self.write(0x6060, 0, "<b", VELOCITY)
        self.read(0x6061)
        self.write(0x60FF, 0, "<i", 20_000)
        self.ticks(40, ENABLE)
        self.machine.physics.set_brakes(brakes)
        self.ticks(100, QUICK_STOP)
        self.machine.drives[DRIVE].inject_fault(0x6100)
        self.ticks(200, 0)
        self.ticks(5, RESET)
        self.ticks(5, 0)
        self.wait(AT_MOST_S)
        return self.seen


@cache
def standard() -> list[tuple[float, int, bytes]]:
    return Script().play()


@pytest.fixture
def script(request: pytest.FixtureRequest) -> Iterator[Script]:
    script = Script(request.param)
    yield script
    script.bus.shutdown()


@pytest.mark.parametrize("script", list(quirks()), indirect=True)
def test_a_quirk_shows_in_the_frames(script: Script) -> None:
    assert script.play() != standard()


def test_the_same_frames_come_from_a_drive_without_quirks() -> None:
    assert Script().play() == standard()


def test_another_drive_of_the_machine_stays_as_it_is() -> None:
    frames = Script("sdo_four_bytes").play()
    own = (0x180, 0x280, 0x580, 0x700, 0x080)
    others = [[frame for frame in each if frame[1] not in [base + NODE for base in own]] for each in (frames, standard())]
    assert others[0] == others[1]


def test_each_has_a_sentence_of_its_own_and_an_address() -> None:
    assert len({quirk.does for quirk in quirks().values()}) == len(quirks())
    for quirk in quirks().values():
        assert quirk.does[0].isupper(), quirk.name
        assert quirk.does.endswith("."), quirk.name
        assert quirk.source.startswith("https://"), quirk.name


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("roll_drive", "must be DRIVE:NAME, such as propeller_drive:sdo_late"),
        ("roll:sdo_late", "no drive 'roll'; there is propeller_drive, roll_drive"),
        ("roll_drive:sdo_never", "no quirk 'sdo_never'; `isocenter faults quirks` names all"),
    ],
)
def test_an_option_that_names_none_says_what_there_is(text: str, words: str) -> None:
    with pytest.raises(FaultError, match=words):
        parse_quirks([text], ("propeller_drive", "roll_drive"))
