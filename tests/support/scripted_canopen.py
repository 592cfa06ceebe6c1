"""A tiny CANopen bus for the drivers' tests, and a CiA 301 slave written from the standard's byte tables.

Virtual time passes by one period per SYNC and while somebody waits in `recv`; everything else happens at once.
"""

from __future__ import annotations

import struct
from collections import deque

import can

PERIOD_S = 1 / 256
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
        self.late_by_a_tick = 0  # identifier of the frames that come after the answer time of their SYNC
        self._held: list[tuple[int, bytes]] = []
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
        elif self._held:  # the loop's next command, before its next SYNC
            held, self._held = self._held, []
            for can_id, data in held:
                self.queue.append(can.Message(arbitration_id=can_id, is_extended_id=False, data=data, timestamp=self.time_s))

    def emit(self, can_id: int, data: bytes) -> None:
        self.log.append((self.time_s, can_id, data))
        if can_id == self.late_by_a_tick:
            self._held.append((can_id, data))
            return
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

    awake_s = 0.0

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
                self.objects[base + number, 5] = u16(0)
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
