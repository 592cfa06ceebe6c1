"""A tiny CANopen bus for the drivers' tests: nodes written from the standards' byte tables, sharing no code with the emulated devices.

Virtual time passes by one period per SYNC and while somebody waits in `recv`; everything else happens at once.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from pathlib import Path

import can

from drivers.settings import AxisScaling, BusSettings, HomingSettings, Identity, IoMap, MotionLimits, Node, Pdo

PERIOD_S = 1 / 256
EDS = Path(__file__).resolve().parents[2] / "drivers" / "canopen" / "eds_files"
STANDING_TICKS = 3  # until a drive in quick stop takes its motor for standing
TICK_S = 0.001  # resolution of heartbeats while somebody waits


class ScriptedBus(can.BusABC):
    """Hands every frame to every node at once; `log` keeps (time, identifier, data) of both directions."""

    def __init__(self, *nodes: ScriptedNode) -> None:
        super().__init__(channel="scripted")
        self.channel_info = "scripted"
        self._is_shutdown = True  # nothing to shut down
        self.nodes = list(nodes)
        self.time_s = 0.0
        self.queue: deque[can.Message] = deque()
        self.log: list[tuple[float, int, bytes]] = []
        self.broken = False
        for node in nodes:
            node.bus = self

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.broken:
            raise can.CanOperationError("the interface went down")
        self.log.append((self.time_s, msg.arbitration_id, bytes(msg.data)))
        for node in self.nodes:
            node.receive(msg.arbitration_id, bytes(msg.data))
        if msg.arbitration_id == 0x80:
            self.pass_time(PERIOD_S)

    def emit(self, can_id: int, data: bytes) -> None:
        self.log.append((self.time_s, can_id, data))
        self.queue.append(can.Message(arbitration_id=can_id, is_extended_id=False, data=data, timestamp=self.time_s))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if self.broken:
            raise can.CanOperationError("the interface went down")
        end = self.time_s + (timeout or 0.0)
        while not self.queue and self.time_s < end - 1e-12:
            self.pass_time(min(TICK_S, end - self.time_s))
        return self.queue.popleft() if self.queue else None

    def pass_time(self, seconds: float) -> None:
        self.time_s += seconds
        for node in self.nodes:
            node.tick(self.time_s)

    def sent(self, can_id: int) -> list[bytes]:
        return [data for _, identifier, data in self.log if identifier == can_id]


class BusClock:
    """The clock of that bus."""

    def __init__(self, bus: ScriptedBus) -> None:
        self.bus, self.missed = bus, 0

    def now(self) -> float:
        return self.bus.time_s

    def wait(self, seconds: float) -> None:
        self.bus.pass_time(seconds)

    def start_ticks(self, period_s: float) -> None:
        self.missed = 0

    def wait_tick(self) -> float:
        return 0.0


class ScriptedNode:
    """A CiA 301 slave: objects as bytes, SDO (expedited, segmented upload), NMT, heartbeat, one TPDO and one RPDO set over SDO."""

    def __init__(self, node_id: int, device_type: int, product_code: int, name: str = "scripted") -> None:
        self.node_id, self.bus = node_id, None
        self.state, self.booted, self.boot_delay_s, self._boot_s = 0x7F, False, 0.01, None
        self.answers_sdo = True
        self.aborts: dict[tuple[int, int], int] = {}  # writes to these are refused
        self.stuck: set[tuple[int, int]] = set()  # writes to these are acknowledged and forgotten
        self.silent = False
        self.mute_pdo = False
        self._beat_s = 0.0
        self._segments: deque[bytes] = deque()
        self._toggle = 0
        self._rpdo_data = b""
        u8, u16, u32 = (lambda v: struct.pack("<B", v)), (lambda v: struct.pack("<H", v)), (lambda v: struct.pack("<I", v))
        self.objects: dict[tuple[int, int], bytes] = {
            (0x1000, 0): u32(device_type),
            (0x1001, 0): u8(0),
            (0x1005, 0): u32(0x80),
            (0x1008, 0): name.encode(),
            (0x1016, 0): u8(1),
            (0x1016, 1): u32(0),
            (0x1017, 0): u16(0),
            (0x1018, 0): u8(3),
            (0x1018, 1): u32(0),
            (0x1018, 2): u32(product_code),
            (0x1018, 3): u32(0x10000),
        }
        for number in range(4):
            for base, valid in ((0x1400, 0x200), (0x1800, 0x180)):
                self.objects[base + number, 1] = u32((0 if number == 0 else 1 << 31) | valid + 0x100 * number + node_id)
                self.objects[base + number, 2] = u8(255)
                self.objects[base + 0x200 + number, 0] = u8(0)
                for position in range(1, 9):
                    self.objects[base + 0x200 + number, position] = u32(0)
        for index in range(4):  # the encoder has two PDOs only; more do no harm
            self.objects.setdefault((0x1A00 + index, 0), u8(0))

    # what a test looks at or sets

    def value(self, index: int, subindex: int = 0) -> int:
        return int.from_bytes(self.objects[index, subindex], "little")

    def set(self, index: int, subindex: int, value: int) -> None:
        size = len(self.objects[index, subindex])
        self.objects[index, subindex] = (value & (1 << 8 * size) - 1).to_bytes(size, "little")

    # the bus

    def receive(self, can_id: int, data: bytes) -> None:
        if can_id == 0x000 and data[1] in (0, self.node_id):
            self._nmt(data[0])
        elif can_id == 0x600 + self.node_id and self.state != 0x04 and self._boot_s is None and self.answers_sdo:
            self._sdo(data)
        elif can_id == 0x080 and self.state == 0x05:
            self._sync()
        elif can_id == self.value(0x1400, 1) & 0x7FF and self.state == 0x05 and not self.value(0x1400, 1) >> 31:
            self._rpdo_data = data

    def tick(self, now_s: float) -> None:
        if self._boot_s is not None and now_s >= self._boot_s:
            self._boot_s, self.state = None, 0x7F
            if not self.silent:
                self.bus.emit(0x700 + self.node_id, b"\x00")
        period_s = self.value(0x1017) / 1000
        if period_s and self._boot_s is None and not self.silent and now_s - self._beat_s >= period_s - 1e-9:
            self._beat_s = now_s
            self.bus.emit(0x700 + self.node_id, bytes([self.state]))

    def _nmt(self, command: int) -> None:
        self.state = {0x01: 0x05, 0x02: 0x04, 0x80: 0x7F}.get(command, self.state)
        if command in (0x81, 0x82):
            self._boot_s = self.bus.time_s + self.boot_delay_s
            self.set(0x1017, 0, 0)

    def _reply(self, command: int, index: int, subindex: int, payload: bytes) -> None:
        self.bus.emit(0x580 + self.node_id, struct.pack("<BHB", command, index, subindex) + payload.ljust(4, b"\0"))

    def _sdo(self, data: bytes) -> None:
        command, index, subindex = struct.unpack_from("<BHB", data)
        if command == 0x40:
            self._upload(index, subindex)
        elif command & 0xE0 == 0x60:
            chunk = self._segments.popleft()
            head = (0 if self._segments else 1) | (7 - len(chunk)) << 1 | self._toggle
            self._toggle ^= 0x10
            self.bus.emit(0x580 + self.node_id, bytes([head]) + chunk.ljust(7, b"\0"))
        elif command & 0xE0 == 0x20:
            self._download(index, subindex, data[4 : 8 - (command >> 2 & 3)])

    def _upload(self, index: int, subindex: int) -> None:
        if (index, subindex) not in self.objects:
            known = any(key[0] == index for key in self.objects)
            self._reply(0x80, index, subindex, struct.pack("<I", 0x06090011 if known else 0x06020000))
            return
        value = self.objects[index, subindex]
        if len(value) <= 4:
            self._reply(0x43 | (4 - len(value)) << 2, index, subindex, value)
        else:
            self._segments, self._toggle = deque(value[i : i + 7] for i in range(0, len(value), 7)), 0
            self._reply(0x41, index, subindex, struct.pack("<I", len(value)))

    def _download(self, index: int, subindex: int, value: bytes) -> None:
        abort = (
            self.aborts.get((index, subindex))
            or (0 if (index, subindex) in self.objects else 0x06020000)
            or self.refuse(index, subindex, value)
        )
        if abort:
            self._reply(0x80, index, subindex, struct.pack("<I", abort))
            return
        if (index, subindex) not in self.stuck:
            self.objects[index, subindex] = value
        self._reply(0x60, index, subindex, b"")
        self.written(index, subindex)

    def refuse(self, index: int, subindex: int, value: bytes) -> int:
        """CiA 301: a mapping may change only while its PDO is invalid and its count is zero."""
        kind = index & 0xFE00
        if kind in (0x1600, 0x1A00) and index < 0x1C00:
            if not self.value(index - 0x200, 1) >> 31:
                return 0x06010000
            if subindex and self.value(index, 0):
                return 0x06010000
        return 0

    def written(self, index: int, subindex: int) -> None:
        """For devices that act on a write."""

    def _mapped(self, index: int) -> list[tuple[int, int]]:
        entries = [self.value(index, position) for position in range(1, self.value(index, 0) + 1)]
        return [(entry >> 16, entry >> 8 & 0xFF) for entry in entries]

    def _sync(self) -> None:
        data = self._rpdo_data
        for key in self._mapped(0x1600) if data else []:
            size = len(self.objects[key])
            self.objects[key], data = data[:size], data[size:]
        self.on_sync()
        if not self.value(0x1800, 1) >> 31 and not self.mute_pdo:
            self.bus.emit(self.value(0x1800, 1) & 0x7FF, b"".join(self.objects[key] for key in self._mapped(0x1A00)))

    def on_sync(self) -> None:
        """The application's turn, between RPDO and TPDO."""

    def emergency(self, code: int, register: int = 1, vendor: bytes = b"") -> None:
        self.bus.emit(0x080 + self.node_id, struct.pack("<HB5s", code, register, vendor))


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
        self.refuses_enable = False
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
        push = self.direction * torque - self.gravity
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
        elif word & 0x8F == 0x0F and self.power == "switched on" and not self.refuses_enable:
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
        for axis, drive in enumerate(self.drives.values()):
            sample.brakes_open[axis] = drive.brake_open


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
