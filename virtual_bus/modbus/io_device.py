"""The emulated input/output device: brakes, hold-to-run, door contact and temperatures behind Modbus.

It answers every request, wrong ones included, as the Modbus Application Protocol Specification V1.1b3 (state diagrams of sec. 6) asks.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from drivers.modbus.refresh import FIRST_WORD, following_word
from drivers.modbus.registers import (
    MAX_READ_BITS,
    MAX_READ_REGISTERS,
    MAX_WRITE_BITS,
    ExceptionCode,
    FunctionCode,
    temperature_to_register,
)
from virtual_bus.modbus.framing import TcpFraming, rtu_frame, rtu_request, tcp_frame

BRAKE_DELAY_S = 0.04  # spring-applied brakes open in 30 to 60 ms
COIL_ON, COIL_OFF = 0xFF00, 0x0000
BROADCAST = 0  # on a serial line: every device obeys, none answers
TCP_ANY_UNIT = (0x00, 0xFF)  # a device directly on TCP is addressed by its IP address alone


@dataclass(frozen=True)
class IoLayout:
    """The wiring of the device. Addresses are zero-based; axes are named."""

    unit_id: int
    brake_coils: Mapping[str, int]  # 1 releases the brake
    brake_feedback_inputs: Mapping[str, int]  # 1: brake is open
    hold_to_run_input: int
    door_input: int
    temperature_registers: Mapping[str, int]
    watchdog_register: int | None = None  # holding register of the output watchdog
    watchdog_timeout_s: float = 0.0
    hold_to_run_released_input: int | None = None  # the opposite contact of the same switch
    loop_back: tuple[int, int] | None = None  # coil and discrete input that are wired together

    @property
    def inputs(self) -> tuple[int, ...]:
        """Every discrete input that is wired."""
        second = () if self.hold_to_run_released_input is None else (self.hold_to_run_released_input,)
        looped = () if self.loop_back is None else (self.loop_back[1],)
        return (*self.brake_feedback_inputs.values(), self.hold_to_run_input, self.door_input, *second, *looped)


class _RefusalError(Exception):
    """A request the device does not carry out."""

    def __init__(self, code: ExceptionCode) -> None:
        self.code = code


class EmulatedIo:
    """The device: its memory, its wiring, and how it answers.

    Parameters
    ----------
    layout : IoLayout
        What is wired where. The device has exactly the coils, inputs and registers up to the last one wired.
    axes : tuple of str
        Order of the axes in arrays.
    on_brakes : callable, optional
        Called by `advance` with an (n,) bool array, True where the brake is closed, whenever a brake has opened or closed.
    brake_delay_s : float
        Time from a coil's change to the brake's.
    """

    def __init__(
        self,
        layout: IoLayout,
        axes: tuple[str, ...],
        on_brakes: Callable[[np.ndarray], None] | None = None,
        brake_delay_s: float = BRAKE_DELAY_S,
    ) -> None:
        self.layout = layout
        self.axes = axes
        coils = (*layout.brake_coils.values(), *(() if layout.loop_back is None else (layout.loop_back[0],)))
        self.coils = [False] * (1 + max(coils, default=-1))
        self.discrete_inputs = [False] * (1 + max(layout.inputs))
        self.input_registers = [0] * (1 + max(layout.temperature_registers.values(), default=-1))
        self._on_brakes = on_brakes
        self._brake_delay_s = brake_delay_s
        self._open = np.zeros(len(axes), dtype=bool)
        self._moving: list[tuple[float, bool] | None] = [None] * len(axes)  # (when it arrives, open or closed)
        self._followed: list[bool] = []  # the coils with which every brake has arrived
        self._word = FIRST_WORD
        self._refreshed = False  # since the last `advance`
        self._falls_s = math.inf if layout.watchdog_register is None else -math.inf  # when the outputs fall unless refreshed
        self._loop_back = layout.loop_back
        self._tcp = TcpFraming()
        self._functions: dict[int, Callable[[bytes], bytes]] = {
            FunctionCode.READ_COILS: partial(_read_bits, self.coils),
            FunctionCode.READ_DISCRETE_INPUTS: partial(_read_bits, self.discrete_inputs),
            FunctionCode.READ_INPUT_REGISTERS: partial(_read_registers, self.input_registers),
            FunctionCode.WRITE_SINGLE_COIL: partial(_write_coil, self.coils),
            FunctionCode.WRITE_MULTIPLE_COILS: partial(_write_coils, self.coils),
        }
        if layout.watchdog_register is not None:
            self._functions[FunctionCode.READ_HOLDING_REGISTERS] = self._read_word
            self._functions[FunctionCode.WRITE_SINGLE_REGISTER] = self._refresh
        self.malformed = 0  # connections and serial frames dropped because they do not speak Modbus
        self.set_hold_to_run(True)
        self.set_door(True)

    # ---- the machine's side -----------------------------------------------------------------------------

    def set_hold_to_run(self, pressed: bool) -> None:
        """Press or release the operator's switch: both its contacts, where the second one is wired."""
        self.discrete_inputs[self.layout.hold_to_run_input] = pressed
        if self.layout.hold_to_run_released_input is not None:
            self.discrete_inputs[self.layout.hold_to_run_released_input] = not pressed

    def set_door(self, closed: bool) -> None:
        """Close or open the door contact."""
        self.discrete_inputs[self.layout.door_input] = closed

    def set_temperature(self, axis: str, temperature_degC: float) -> None:
        """Set the temperature that the sensor of an axis's winding shows; NaN: it is broken.

        Axes without a sensor are ignored.
        """
        register = self.layout.temperature_registers.get(axis)
        if register is not None:
            self.input_registers[register] = temperature_to_register(temperature_degC)

    @property
    def brakes_closed(self) -> np.ndarray:
        """Whether each brake really is closed (n,)."""
        return ~self._open

    def advance(self, time_s: float) -> None:
        """Move machine time to `time_s` [s]: brakes follow their coils after the mechanical delay, feedback follows the brakes."""
        coils = self.coils
        if self._refreshed:
            self._refreshed, self._falls_s = False, time_s + self.layout.watchdog_timeout_s
        if time_s >= self._falls_s:
            coils[:] = [False] * len(coils)
        if self._loop_back is not None:
            coil, looped = self._loop_back
            self.discrete_inputs[looped] = coils[coil]
        if coils != self._followed:
            self._follow(time_s)

    def _follow(self, time_s: float) -> None:
        """Let the brakes follow their coils."""
        changed, coils = False, list(self.coils)
        for index, axis in enumerate(self.axes):
            coil = self.layout.brake_coils.get(axis)
            if coil is None:
                continue
            wanted = coils[coil]
            moving = self._moving[index]
            if moving is None or moving[1] != wanted:
                moving = (time_s + self._brake_delay_s, wanted) if wanted != self._open[index] else None
                self._moving[index] = moving
            if moving is not None and time_s >= moving[0]:
                self._moving[index] = None
                self._open[index] = wanted
                changed = True
                feedback = self.layout.brake_feedback_inputs.get(axis)
                if feedback is not None:
                    self.discrete_inputs[feedback] = wanted
        self._followed = [] if any(self._moving) else coils
        if changed and self._on_brakes is not None:
            self._on_brakes(self.brakes_closed)

    # ---- the line's side --------------------------------------------------------------------------------

    def serve(self, data: bytes) -> bytes:
        """Take bytes of one Modbus/TCP connection and return the answers."""
        return self.serve_tcp(self._tcp, data)

    def serve_tcp(self, framing: TcpFraming, data: bytes) -> bytes:
        """Take bytes of one of several connections, each with its own framing, and return the answers."""
        answers = b""
        for transaction, unit_id, pdu in framing.feed(data):
            if unit_id == self.layout.unit_id or unit_id in TCP_ANY_UNIT:
                answer = self.serve_pdu(pdu)
            else:
                answer = bytes((pdu[0] | 0x80, ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND))
            answers += tcp_frame(transaction, unit_id, answer)
        self.malformed += framing.broken
        return answers

    def serve_rtu(self, frame: bytes) -> bytes:
        """Take what arrived on a serial line between two silences and return the answer.

        There is none to damaged, foreign and broadcast frames.
        """
        request = rtu_request(frame)
        if request is None:
            self.malformed += 1
            return b""
        if request[0] not in (self.layout.unit_id, BROADCAST):
            return b""
        answer = self.serve_pdu(request[1])
        return rtu_frame(self.layout.unit_id, answer) if request[0] != BROADCAST else b""

    def serve_pdu(self, pdu: bytes) -> bytes:
        """Carry out one request and return the answer or an exception answer."""
        carry_out = self._functions.get(pdu[0])
        try:
            if carry_out is None:
                raise _RefusalError(ExceptionCode.ILLEGAL_FUNCTION)
            return pdu[:1] + carry_out(pdu[1:])
        except _RefusalError as refusal:
            return bytes((pdu[0] | 0x80, refusal.code))

    def _read_word(self, data: bytes) -> bytes:
        """Show the word; the holding registers before it are zero."""
        assert self.layout.watchdog_register is not None
        return _read_registers([0] * self.layout.watchdog_register + [self._word], data)

    def _refresh(self, data: bytes) -> bytes:
        """Take a word; only the one that follows the word shown keeps the outputs on."""
        if len(data) != 4:
            raise _RefusalError(ExceptionCode.ILLEGAL_DATA_VALUE)
        address, word = struct.unpack(">HH", data)
        if address != self.layout.watchdog_register:
            raise _RefusalError(ExceptionCode.ILLEGAL_DATA_ADDRESS)
        if word != following_word(self._word):
            raise _RefusalError(ExceptionCode.ILLEGAL_DATA_VALUE)
        self._word, self._refreshed = word, True
        return data


def _range(data: bytes, size: int, available: int, most: int) -> tuple[int, int]:
    """Return (address, count) of a request's first four bytes.

    They are checked in the order of the specification: value, then address.
    """
    if len(data) != size:
        raise _RefusalError(ExceptionCode.ILLEGAL_DATA_VALUE)
    address, count = struct.unpack_from(">HH", data)
    if not 1 <= count <= most:
        raise _RefusalError(ExceptionCode.ILLEGAL_DATA_VALUE)
    if address + count > available:
        raise _RefusalError(ExceptionCode.ILLEGAL_DATA_ADDRESS)
    return address, count


def _read_bits(bits: list[bool], data: bytes) -> bytes:
    address, count = _range(data, 4, len(bits), MAX_READ_BITS)
    packed = 0
    for bit in reversed(bits[address : address + count]):
        packed = packed << 1 | bit
    size = (count + 7) // 8
    return bytes((size,)) + packed.to_bytes(size, "little")


def _read_registers(registers: list[int], data: bytes) -> bytes:
    address, count = _range(data, 4, len(registers), MAX_READ_REGISTERS)
    return struct.pack(f">B{count}H", 2 * count, *registers[address : address + count])


def _write_coil(coils: list[bool], data: bytes) -> bytes:
    if len(data) != 4:
        raise _RefusalError(ExceptionCode.ILLEGAL_DATA_VALUE)
    address, value = struct.unpack(">HH", data)
    if value not in (COIL_ON, COIL_OFF):
        raise _RefusalError(ExceptionCode.ILLEGAL_DATA_VALUE)
    if address >= len(coils):
        raise _RefusalError(ExceptionCode.ILLEGAL_DATA_ADDRESS)
    coils[address] = value == COIL_ON
    return data


def _write_coils(coils: list[bool], data: bytes) -> bytes:
    if len(data) < 6 or data[4] != len(data) - 5:
        raise _RefusalError(ExceptionCode.ILLEGAL_DATA_VALUE)
    address, count = _range(data, 5 + data[4], len(coils), MAX_WRITE_BITS)
    if data[4] != (count + 7) // 8:
        raise _RefusalError(ExceptionCode.ILLEGAL_DATA_VALUE)
    packed = int.from_bytes(data[5:], "little")
    coils[address : address + count] = [bool(packed >> position & 1) for position in range(count)]
    return data[:4]
