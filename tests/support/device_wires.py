"""A device on the tests' bench: the canopen library as independent client on one side, an emulated node on the other, no thread."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import canopen
import numpy as np
import pytest
from places import DATA, ROOT, needs_data

from virtual_bus.canopen.bare import bare_device
from virtual_bus.canopen.node import Node
from virtual_bus.settings import EmulatedBus, EmulatedDrive, EmulatedEncoder

EDS_FILES = ROOT / "drivers" / "canopen" / "eds_files"
DRIVE_EDS = EDS_FILES / "isocenter_drive.eds"
ENCODER_EDS = EDS_FILES / "isocenter_encoder.eds"
VENDOR_FILES = DATA / "canopen"
PERIOD_S = 1.0 / 256.0

needs_vendor_files = needs_data("canopen", "the makers' device files are")


class Wire(canopen.Network):
    """The canopen library's network with one emulated device on the other end; time stands still unless it is told to pass."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0
        self.sent: list[tuple[int, bytes]] = []  # by the device, everything
        self.device: Node

    def attach(self, device: Node) -> None:
        self.device = device
        device.connect(self._from_device)
        device.power_on(self.now_s)

    def _from_device(self, can_id: int, data: bytes) -> None:
        self.sent.append((can_id, bytes(data)))
        self.notify(can_id, bytearray(data), self.now_s)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        if remote:
            self.device.receive_remote(can_id, self.now_s)
        else:
            self.device.receive(can_id, bytes(data), self.now_s)

    def pass_time(self, seconds: float, step_s: float = 0.001) -> None:
        """Ticks every millisecond, as an emulator's idle loop gives them."""
        for _ in range(round(seconds / step_s)):
            self.now_s += step_s
            self.device.tick(self.now_s)

    def heard(self, can_id: int) -> list[bytes]:
        """What the device has sent with that identifier since `forget`."""
        return [data for sent_id, data in self.sent if sent_id == can_id]

    def forget(self) -> None:
        self.sent.clear()

    def frame(self, can_id: int, data: bytes = b"") -> None:
        self.send_message(can_id, data)

    def command(self, command: int) -> None:
        self.frame(0x000, bytes((command, self.device.node_id)))

    def sdo_raw(self, request: bytes) -> bytes:
        """One SDO request frame, and the one frame that answers it."""
        self.forget()
        self.frame(0x600 + self.device.node_id, request)
        answers = self.heard(0x580 + self.device.node_id)
        assert len(answers) == 1, f"{len(answers)} answers to {request.hex()}"
        return answers[0]


def bare_wire(eds: Path, node_id: int = 4, memory: Path | None = None) -> tuple[Wire, canopen.RemoteNode]:
    """A bare device of an EDS on a wire, and the library's client of it."""
    wire = Wire()
    wire.attach(bare_device(eds, node_id, lambda can_id, data: None, memory))
    return wire, client(wire, eds)


def client(wire: Wire, eds: Path) -> canopen.RemoteNode:
    remote = canopen.RemoteNode(wire.device.node_id, str(eds))
    wire.add_node(remote)
    remote.sdo.RESPONSE_TIMEOUT = 0.01
    remote.sdo.MAX_RETRIES = 0
    wire.forget()
    return remote


def abort_code(action: Callable[[], object]) -> int:
    """The abort code an SDO transfer ends with."""
    with pytest.raises(canopen.SdoAbortedError) as refused:
        action()
    return refused.value.code


def u8(value: int) -> bytes:
    return struct.pack("<B", value)


def u16(value: int) -> bytes:
    return struct.pack("<H", value)


def u32(value: int) -> bytes:
    return struct.pack("<I", value)


RESOLUTION = 2.0 * np.pi / (4096 * 100)
COUNTS_PER_TURN = 4096


def drive_settings(name: str = "roll_drive", axis: str = "roll", node_id: int = 2, **changes: object) -> EmulatedDrive:
    values: dict = dict(
        name=name,
        axis=axis,
        node_id=node_id,
        eds=DRIVE_EDS,
        rated=5.0,
        rated_current_mA=5000,
        rated_torque_mNm=675,
        limit=8.0,
        position_resolution=RESOLUTION,
        counts_per_turn=COUNTS_PER_TURN,
        velocity_gain=20.0,
        velocity_integral_gain=40.0,
    )
    return EmulatedDrive(**(values | changes))


def encoder_settings(name: str = "roll_encoder", axis: str = "roll", node_id: int = 12, **changes: object) -> EmulatedEncoder:
    values: dict = dict(name=name, axis=axis, node_id=node_id, eds=ENCODER_EDS, counts_per_turn=8388608, zero_counts=4194304)
    return EmulatedEncoder(**(values | changes))


class Latched:
    """Physics of a standing machine: what its sensors read is what a test sets."""

    def __init__(self, axes: int) -> None:
        self.position_counts = np.zeros(axes, dtype=np.int64)
        self.link_counts = np.zeros(axes, dtype=np.int64)
        self.effort = np.zeros(axes)
        self.imu = np.zeros(6)
        self.temperature_degC = np.full(axes, 24.0)


class SpinningMasses:
    """Physics simple enough to be known in closed form: a mass on every axis, 1 unit of effort accelerates it by 1 rad/s^2."""

    def __init__(self, axes: tuple[str, ...] = ("propeller", "roll")) -> None:
        self.axes = axes
        self.position = np.zeros(len(axes))
        self.speed = np.zeros(len(axes))
        self.effort = np.zeros(len(axes))
        self.closed = np.ones(len(axes), dtype=bool)
        self.load = np.zeros(len(axes))  # a constant effort against the drive
        self.temperature_degC = 24.0
        self.advanced = 0
        self.rows = 0  # times the noisy sensors were read
        self._start = np.zeros(len(axes))

    def place(self, axis_positions: np.ndarray) -> None:
        self.position[:] = self._start[:] = axis_positions
        self.speed[:] = 0.0

    def set_brakes(self, closed: np.ndarray) -> None:
        self.closed[:] = closed

    def apply(self, effort: np.ndarray) -> None:
        self.effort[:] = effort

    def prepare(self, effort: np.ndarray) -> None:
        """Nothing takes long here."""

    def latch(self) -> Latched:
        self.rows += 1
        return self.latch_exactly()

    def latch_exactly(self) -> Latched:
        latched = Latched(len(self.axes))
        latched.position_counts[:] = np.round((self.position - self._start) / RESOLUTION)
        latched.link_counts[:] = np.round(self.position / (2.0 * np.pi / 8388608))
        latched.effort[:] = self.effort
        latched.imu[:] = np.arange(6) + 0.25
        latched.temperature_degC[:] = self.temperature_degC
        return latched

    def seen_by_imu(self) -> np.ndarray:
        return self.latch_exactly().imu

    def read_by_imu(self, seen: np.ndarray) -> np.ndarray:
        return seen

    def advance(self) -> None:
        self.advanced += 1
        moving = ~self.closed
        self.speed = np.where(moving, self.speed + PERIOD_S * (self.effort - self.load), 0.0)
        self.position = self.position + PERIOD_S * self.speed


def two_axis_bus() -> EmulatedBus:
    return EmulatedBus(
        0x080,
        (drive_settings("propeller_drive", "propeller", 1), drive_settings()),
        (encoder_settings("propeller_encoder", "propeller", 11), encoder_settings()),
    )
