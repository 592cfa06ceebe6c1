"""Drives, encoders and I/O for the drivers' tests, written from the standards: they share no code with the emulated devices."""

from __future__ import annotations

import math
import struct

from places import EDS_FILES
from scripted_canopen import PERIOD_S, BusClock, ScriptedBus, ScriptedNode

from drivers.settings import AxisScaling, BusSettings, HomingSettings, Identity, IoMap, MotionLimits, Node, Pdo

__all__ = ["PERIOD_S", "BusClock", "ScriptedBus", "ScriptedDrive", "ScriptedEncoder", "ScriptedIo", "ScriptedNode", "machine_settings"]

EDS = EDS_FILES
STANDING_TICKS = 3  # until a drive in quick stop takes its motor for standing

STATUSWORDS = {
    "switch on disabled": 0x240,
    "ready to switch on": 0x231,
    "switched on": 0x233,
    "operation enabled": 0x237,
    "quick stop active": 0x217,
    "fault": 0x208,
}


class ScriptedDrive(ScriptedNode):
    """CiA 402: state machine, modes 6 and 10, a mass that the torque accelerates while the brake is open."""

    COUNTS_PER_PERMILLE = 0.5  # counts per tick^2

    def __init__(self, node_id: int, **kwargs: object) -> None:
        super().__init__(node_id, 0x0002_0192, 0x4953_4F01, "Scripted drive")
        for index, size in (
            (0x603F, 2),
            (0x6040, 2),
            (0x6041, 2),
            (0x6060, 1),
            (0x6061, 1),
            (0x6064, 4),
            (0x6071, 2),
            (0x6072, 2),
            (0x6073, 2),
        ):
            self.objects[index, 0] = bytes(size)
        for index, size in ((0x6075, 4), (0x6076, 4), (0x6077, 2), (0x6078, 2), (0x6098, 1), (0x609A, 4)):
            self.objects[index, 0] = bytes(size)
        for index in (0x6007, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E):
            self.objects[index, 0] = bytes(2)
        self.objects |= {(0x6099, 0): b"\x02", (0x6099, 1): bytes(4), (0x6099, 2): bytes(4)}
        self.power, self.fault_cause, self._last_controlword = "switch on disabled", False, 0
        self.direction, self.gravity, self.friction, self.brake_open = 1, 0.0, 0.0, False
        self.speed, self.counts, self.link_counts = 0.0, 1000.0, 4194304.0
        self.homing_ticks, self.homing_result, self._homing_left, self._homing_bits = 1, "attained", 0, 0x400
        self.refuses_enable, self.resumes = False, True  # transition 16 is optional
        self.ramp, self._standing_ticks = 0.0, 0  # quick stop: counts per tick^2
        self.set(0x6041, 0, 0x240)

    def fail(self, code: int) -> None:
        self.power, self.fault_cause = "fault", True
        self.set(0x603F, 0, code)
        self.emergency(code)

    def written(self, index: int, subindex: int) -> None:
        if index == 0x6060:
            self.set(0x6061, 0, self.value(0x6060))

    def on_sync(self) -> None:
        self._transition(self.value(0x6040))
        torque = struct.unpack("<h", self.objects[0x6071, 0])[0] if self.power == "operation enabled" and self.value(0x6061) == 10 else 0
        self._homing(self.value(0x6040))
        carried = self.power == "quick stop active" and self.ramp > 0.0  # its velocity loop bears the load
        push = 0.0 if carried else self.direction * torque - self.gravity
        if self.brake_open and (abs(push) > self.friction or self.speed):
            self.speed += push * self.COUNTS_PER_PERMILLE
            self.counts += self.speed
            self.link_counts += self.speed * 13.65  # 2^23 / (4096 * 150): link counts per motor count
        elif not self.brake_open:
            self.speed = 0.0
        self._quick_stop()
        self.set(0x6064, 0, round(self.counts))
        self.set(0x6078, 0, torque)
        self.set(0x6041, 0, STATUSWORDS[self.power] | (self._homing_bits if self.value(0x6061) == 6 else 0))

    def _transition(self, word: int) -> None:
        rising = word & ~self._last_controlword
        self._last_controlword = word
        if self.power == "fault":
            if rising & 0x80 and not self.fault_cause:
                self.power = "switch on disabled"
            return
        if not word & 0x02:
            self.power = "switch on disabled"
        elif not word & 0x04:
            self.power = "quick stop active" if self.power in ("operation enabled", "quick stop active") else "switch on disabled"
        elif word & 0x8F == 0x06:
            self.power = "ready to switch on"
        elif word & 0x8F == 0x07 and self.power in ("ready to switch on", "operation enabled"):
            self.power = "switched on"
        elif word & 0x8F == 0x0F and (
            (self.power == "switched on" and not self.refuses_enable)
            or (self.power == "quick stop active" and self.resumes and self.value(0x605A) >= 5)
        ):
            self.power = "operation enabled"

    def _quick_stop(self) -> None:
        """605Ah: 5 to 8 stay in quick stop active once at standstill, the others switch the drive off."""
        if self.power != "quick stop active":
            self._standing_ticks = 0
            return
        self.speed -= math.copysign(min(abs(self.speed), self.ramp), self.speed)
        self._standing_ticks += self.speed == 0.0
        if self._standing_ticks >= STANDING_TICKS and self.value(0x605A) < 5:
            self.power = "switch on disabled"

    def _homing(self, word: int) -> None:
        if self.value(0x6061) != 6 or not word & 0x10:
            self._homing_left = self.homing_ticks
            return
        if self._homing_left > 0:
            self._homing_left -= 1
            self._homing_bits = 0
            return
        if self.homing_result == "attained":
            self.counts = self.counts if self._homing_bits & 0x1000 else 0.0
            self._homing_bits = 0x1400
        elif self.homing_result == "error":
            self._homing_bits = 0x2400


class ScriptedEncoder(ScriptedNode):
    """CiA 406: the joint of a drive, seen from the link."""

    def __init__(self, node_id: int, drive: ScriptedDrive) -> None:
        super().__init__(node_id, 0x0001_0196, 0x4953_4F02, "Scripted encoder")
        self.drive = drive
        self.direction = 1
        self.objects |= {(0x6004, 0): bytes(4), (0x6503, 0): bytes(2)}

    def on_sync(self) -> None:
        self.set(0x6004, 0, round(4194304 + self.direction * (self.drive.link_counts - 4194304)))


class ScriptedIo:
    """The I/O driver's face towards the link: brakes of the scripted drives, with feedback a few ticks later."""

    def __init__(self, drives: dict[str, ScriptedDrive], delay_polls: int = 3) -> None:
        self.drives, self.delay_polls = drives, delay_polls
        self.hold_to_run = self.door_closed = True
        self.age_s = 0.0
        self.jammed: set[str] = set()
        self.lies: set[str] = set()  # axes whose feedback follows the coil and not the brake
        self.history: list[dict[str, bool]] = []
        self._wanted = dict.fromkeys(drives, False)
        self._left = 0
        self.opened_at_sync = 0  # SYNCs on the bus' log when brakes were last told to open

    def command_brakes(self, brakes: dict[str, bool]) -> None:
        self.history.append(dict(brakes))
        if any(brakes.values()):
            self.opened_at_sync = len(next(iter(self.drives.values())).bus.sent(0x080))
        self._wanted |= brakes
        self._left = self.delay_polls

    def poll_due(self, now_s: float) -> None:
        self._left -= 1
        if self._left <= 0:
            for axis, is_open in self._wanted.items():
                if axis not in self.jammed:
                    self.drives[axis].brake_open = is_open

    def update(self, sample: object) -> None:
        sample.hold_to_run, sample.door_closed, sample.io_age_s = self.hold_to_run, self.door_closed, self.age_s
        for axis, (name, drive) in enumerate(self.drives.items()):
            sample.brakes_open[axis] = self._wanted[name] if name in self.lies and self._left <= 0 else drive.brake_open


def machine_settings(axes: tuple[str, ...] = ("propeller", "roll"), *, sign: int = 1, method: int = 37, io: bool = True) -> BusSettings:
    """Settings of one drive and one encoder per axis, as the shipped C-arm has them."""
    nodes, scalings, homings, motions = [], [], [], []
    for k, axis in enumerate(axes):
        identity = {"vendor_id": 0, "revision_number": 0x10000, "serial_number": None}
        nodes.append(
            Node(
                name=f"{axis}_drive",
                role="drive",
                axis=axis,
                node_id=k + 1,
                eds=EDS / "isocenter_drive.eds",
                identity=Identity(product_code=0x49534F01, **identity),
                tpdos=(Pdo(1, 0x181 + k, 1, ((0x6041, 0, 16), (0x6064, 0, 32), (0x6078, 0, 16))),),
                rpdos=(Pdo(1, 0x201 + k, 1, ((0x6040, 0, 16), (0x6071, 0, 16))),),
                heartbeat_period_s=0.1,
                boot_timeout_s=2.0,
            )
        )
        scalings.append(
            AxisScaling(axis, 2 * 3.141592653589793 / (4096 * 150), 2 * 3.141592653589793 / 2**23, 4194304, sign, 5.0, 8.0, 675, 5000)
        )
        homings.append(HomingSettings(axis, method, 0.035, 0.17, 3.0, 1.7e-3, 0.3, 3.5e-4, 2.0, 1.0))
        motions.append(MotionLimits(axis, -2.2, 2.2, 1.05, 0.052, 3))
    for k, axis in enumerate(axes):
        nodes.append(
            Node(
                name=f"{axis}_encoder",
                role="encoder",
                axis=axis,
                node_id=k + 11,
                eds=EDS / "isocenter_encoder.eds",
                identity=Identity(product_code=0x49534F02, **identity),
                tpdos=(Pdo(1, 0x18B + k, 1, ((0x6004, 0, 32),)),),
                rpdos=(),
                heartbeat_period_s=0.1,
                boot_timeout_s=2.0,
            )
        )
    coils = {axis: k for k, axis in enumerate(axes)}
    io_map = IoMap("", 1, 0.05, 0.5, coils, coils, 8, 9, coils) if io else None
    return BusSettings(
        1_000_000, 0x80, PERIOD_S, 127, 0.1, 0.0025, tuple(nodes), tuple(scalings), tuple(homings), tuple(motions), None, io_map
    )
