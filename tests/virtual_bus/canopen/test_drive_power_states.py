"""The drive's state machine against the standard's own table, written out here from IEC 61800-7-201 figure 3 and table 7."""

from __future__ import annotations

import struct

import canopen
import pytest
from device_wires import DRIVE_EDS, PERIOD_S, Wire, client, drive_settings

from virtual_bus.canopen.drive import Cia402Drive

# name -> (statusword mask, value): IEC 61800-7-201, table 4
STATES = {
    "switch on disabled": (0x4F, 0x40),
    "ready to switch on": (0x6F, 0x21),
    "switched on": (0x6F, 0x23),
    "operation enabled": (0x6F, 0x27),
    "quick stop active": (0x6F, 0x07),
    "fault reaction active": (0x4F, 0x0F),
    "fault": (0x4F, 0x08),
}

# (bit 7, bit 3, bit 2, bit 1, bit 0) with None for "does not matter": IEC 61800-7-201, table 7
SHUTDOWN = (0, None, 1, 1, 0)
SWITCH_ON = (0, 0, 1, 1, 1)
ENABLE = (0, 1, 1, 1, 1)
DISABLE_VOLTAGE = (0, None, None, 0, None)
QUICK_STOP = (0, None, 0, 1, None)

# what each command does in each state, the drive at rest, option codes as delivered (605Ah = 2: stop, then switch on disabled).
# A quick stop at rest is over at the next samples; "->" is where it ends.
TABLE = {
    "switch on disabled": {SHUTDOWN: "ready to switch on"},  # 2
    "ready to switch on": {
        SWITCH_ON: "switched on",  # 3
        ENABLE: "operation enabled",  # 3 and 4
        DISABLE_VOLTAGE: "switch on disabled",  # 7
        QUICK_STOP: "switch on disabled",  # 7
    },
    "switched on": {
        ENABLE: "operation enabled",  # 4
        SHUTDOWN: "ready to switch on",  # 6
        DISABLE_VOLTAGE: "switch on disabled",  # 10
        QUICK_STOP: "switch on disabled",  # 10
    },
    "operation enabled": {
        SWITCH_ON: "switched on",  # 5
        SHUTDOWN: "ready to switch on",  # 8
        DISABLE_VOLTAGE: "switch on disabled",  # 9
        QUICK_STOP: "switch on disabled",  # 11 and 12
    },
    "fault": {},
}
WAY_THERE = {
    "switch on disabled": [],
    "ready to switch on": [0x06],
    "switched on": [0x06, 0x07],
    "operation enabled": [0x06, 0x07, 0x0F],
    "fault": [0x06],
}


class Bench:
    """A drive alone with its motor standing still."""

    def __init__(self, **changes: object) -> None:
        self.wire = Wire()
        self.drive = Cia402Drive(drive_settings(node_id=4, **changes), PERIOD_S, lambda can_id, data: None)
        self.wire.attach(self.drive)
        self.remote: canopen.RemoteNode = client(self.wire, DRIVE_EDS)
        self.counts = 0

    def sample(self, count: int = 1) -> float:
        for _ in range(count):
            self.wire.now_s += PERIOD_S
            self.drive.tick(self.wire.now_s)
            effort = self.drive.command()
            self.drive.latch(self.counts, effort, 24.0)
        return effort

    def control(self, word: int) -> None:
        self.remote.sdo.download(0x6040, 0, struct.pack("<H", word))

    @property
    def statusword(self) -> int:
        return int(self.remote.sdo[0x6041].raw)

    @property
    def state(self) -> str:
        names = [name for name, (mask, value) in STATES.items() if self.statusword & mask == value]
        assert len(names) == 1, f"{self.statusword:04X}"
        return names[0]

    def go_to(self, state: str) -> None:
        for word in WAY_THERE[state]:
            self.control(word)
        if state == "fault":
            self.drive.inject_fault(0x5000)
        assert self.state == state


def expected(state: str, word: int) -> str:
    bits = (word >> 7 & 1, word >> 3 & 1, word >> 2 & 1, word >> 1 & 1, word & 1)
    for pattern, after in TABLE[state].items():
        if all(wanted is None or wanted == bit for wanted, bit in zip(pattern, bits, strict=True)):
            return after
    if state == "fault" and bits[0]:
        return "switch on disabled"  # 15
    return state


@pytest.mark.parametrize("state", list(TABLE))
def test_every_controlword_does_in_every_state_what_the_table_says(state: str) -> None:
    bench = Bench()
    for word in [low | high for low in range(16) for high in (0x00, 0x80)]:
        bench.wire.command(0x81)
        bench.go_to(state)
        bench.control(word)
        if state != "operation enabled":
            assert bench.state == expected(state, word), f"{state}, controlword {word:02X}"
        bench.sample(40)  # a stop at rest takes a moment
        assert bench.state == expected(state, word), f"{state}, controlword {word:02X}"


@pytest.mark.parametrize("option", [5, 6, 7])
def test_quick_stop_active_is_kept_and_left_as_the_option_code_says(option: int) -> None:
    ways = {0x02: "quick stop active", 0x0F: "operation enabled", 0x00: "switch on disabled", 0x06: "quick stop active"}
    for word, after in ways.items():
        bench = Bench()
        bench.remote.sdo[0x605A].raw = option
        bench.go_to("operation enabled")
        bench.control(0x02)
        bench.sample(60)
        assert bench.state == "quick stop active"
        bench.control(word)
        bench.sample(60)
        assert bench.state == after, f"controlword {word:02X}"


def test_without_that_option_enable_does_not_lead_out_of_a_quick_stop() -> None:
    bench = Bench()
    bench.go_to("operation enabled")
    bench.control(0x02)
    assert bench.state == "quick stop active"
    bench.control(0x0F)
    assert bench.state == "quick stop active"


def test_a_fault_is_reset_by_the_rising_edge_only() -> None:
    bench = Bench()
    bench.control(0x80)
    bench.drive.inject_fault(0x5000)
    bench.sample(2)
    bench.control(0x80)
    assert bench.state == "fault", "bit 7 was on before"
    bench.control(0x00)
    assert bench.state == "fault"
    bench.control(0x80)
    assert bench.state == "switch on disabled"


def test_a_reset_never_enables() -> None:
    bench = Bench()
    bench.go_to("operation enabled")
    bench.drive.inject_fault(0x2310)
    bench.sample(60)
    bench.control(0x8F)
    bench.sample(2)
    assert bench.state == "switch on disabled"
    bench.control(0x0F)
    bench.sample(2)
    assert bench.state == "switch on disabled", "the way leads through shutdown"


def test_a_cause_that_is_still_there_keeps_the_fault() -> None:
    bench = Bench()
    limit_degC = bench.remote.sdo[0x2001][2].raw / 10.0
    bench.drive.latch(0, 0.0, limit_degC)
    bench.control(0x80)
    assert bench.state == "fault"
    bench.drive.latch(0, 0.0, limit_degC - 1.0)
    bench.control(0x00)
    bench.wire.forget()
    bench.control(0x80)
    assert bench.state == "switch on disabled"
    assert bench.wire.heard(0x084) == [bytes(8)]
    assert bench.remote.sdo[0x603F].raw == 0


def test_a_fault_outlives_a_reset_of_communication_and_not_a_reset_of_the_node() -> None:
    bench = Bench()
    bench.drive.inject_fault(0x2310)
    bench.wire.command(0x82)
    assert bench.state == "fault"
    assert bench.remote.sdo[0x1001].raw == 0x03
    bench.wire.command(0x81)
    assert bench.state == "switch on disabled"
    assert bench.remote.sdo[0x1001].raw == 0


def test_a_fault_is_told_once_with_its_code() -> None:
    bench = Bench()
    bench.wire.forget()
    bench.drive.inject_fault(0x2310)
    bench.drive.inject_fault(0x2310)
    assert bench.wire.heard(0x084) == [bytes.fromhex("10 23 03 00 00 00 00 00")]
    assert bench.remote.sdo[0x603F].raw == 0x2310
    assert bench.remote.sdo[0x1003][1].raw == 0x2310


def test_statusword_bits_beside_the_state() -> None:
    bench = Bench()
    bench.sample()
    assert bench.statusword & 0x0210 == 0x0210, "voltage enabled, remote"
    assert not bench.statusword & 0x0080
    bench.drive.latch(0, 0.0, 95.0)
    assert bench.statusword & 0x0080, "warning above the warning temperature"
    bench.drive.latch(0, 0.0, 111.0)
    assert bench.state == "fault"
    assert bench.remote.sdo[0x603F].raw == 0x4310
    bench.drive.latch(0, 0.0, 50.0)
    bench.control(0x80)
    assert bench.state == "switch on disabled"


@pytest.mark.parametrize("mode", [8, 9, 10])
def test_a_warning_and_a_limit_come_and_go_with_the_sample_while_the_drive_follows_its_target(mode: int) -> None:
    bench = Bench()
    bench.remote.sdo[0x6060].raw = mode
    bench.go_to("operation enabled")
    bench.sample(3)
    assert bench.statusword & 0x1880 == 0x1000, "it follows its target, with neither"
    for degC, warns in ((95.0, True), (95.0, True), (24.0, False), (95.0, True)):
        bench.drive.latch(0, bench.drive.command(), degC)
        assert bool(bench.statusword & 0x0080) is warns
    bench.sample()
    for offset, limited in ((3000, True), (3000, True), (0, False), (3000, True)):
        bench.remote.sdo[0x60B2].raw = offset
        bench.sample()
        assert bench.statusword & 0x1880 == 0x1000 | 0x0800 * limited


@pytest.mark.parametrize(
    ("index", "value"), [(0x6060, 2), (0x6060, 7), (0x6060, -1), (0x6086, 3), (0x6098, 1), (0x605B, 2), (0x605D, 0), (0x6007, 4)]
)
def test_what_the_drive_cannot_do_is_refused(index: int, value: int) -> None:
    bench = Bench()
    with pytest.raises(canopen.SdoAbortedError) as refused:
        bench.remote.sdo[index].raw = value
    assert refused.value.code in (0x06090030, 0x06090031, 0x06090032)


def test_supported_modes_are_what_it_says() -> None:
    bench = Bench()
    supported = bench.remote.sdo[0x6502].raw
    for mode in range(1, 11):
        if supported >> (mode - 1) & 1:
            bench.remote.sdo[0x6060].raw = mode
            assert bench.remote.sdo[0x6061].raw == mode
        else:
            with pytest.raises(canopen.SdoAbortedError):
                bench.remote.sdo[0x6060].raw = mode
