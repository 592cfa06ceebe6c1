"""The I/O device in the sample loop: brakes, hold-to-run, door contact and temperatures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from pymodbus.pdu.bit_message import ReadDiscreteInputsRequest, WriteMultipleCoilsRequest, WriteSingleCoilRequest
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, ReadInputRegistersRequest, WriteSingleRegisterRequest

from drivers.errors import ProtocolError
from drivers.interface import Sample
from drivers.modbus.registers import MAX_READ_BITS, MAX_READ_REGISTERS, register_to_temperature
from drivers.modbus.transport import Transport
from drivers.settings import IoMap
from drivers.shared_memory.io_state import IoState

LAGS_BORNE = 1  # polls in a row for which a wired input may lag behind its output


class Io(Protocol):
    """The interface of the I/O device to the machine link. No method waits."""

    def poll_due(self, now_s: float) -> None:
        """Poll the device when a poll is due at `now_s`; do nothing where another process polls."""

    def update(self, sample: Sample) -> None:
        """Copy the newest state into the sample."""

    def command_brakes(self, brakes: Mapping[str, bool]) -> None:
        """Open (True) or close the brakes of the named axes with the next poll."""


class IoDriver:
    """Polls the device through a transport.

    A poll is two requests, one more when brakes are commanded, one of a looped-back output, and two of an output watchdog.

    Parameters
    ----------
    io_map : IoMap
        Addresses of the inputs and outputs.
    transport : Transport
        An `InProcessTransport` in lockstep; a `ClientTransport` waits and belongs in another process (`drivers.modbus.io_process`).
    axes : tuple of str
        Order of the axes in arrays.
    refresh : callable, optional
        Called with each state that was read; returns the word that refreshes the device's output watchdog, or None. Only the supervisor
        knows it.
    """

    def __init__(
        self, io_map: IoMap, transport: Transport, axes: tuple[str, ...], refresh: Callable[[IoState], int | None] | None = None
    ) -> None:
        self.state = IoState(len(axes))
        self.malformed = 0  # polls whose answer was none
        self.first_malformed = ""  # why the first was none
        self._map = io_map
        self._transport = transport
        self._refresh = refresh
        self._refreshed: int | None = None  # the word that was answered, since it was read
        self._open = dict.fromkeys(io_map.brake_coils, False)
        self._commanded = False
        self._next_poll_s = -math.inf
        self._now_s = 0.0
        released, unit_id = io_map.hold_to_run_released_input, io_map.unit_id
        inputs = (*io_map.brake_feedback_inputs.values(), io_map.hold_to_run_input, io_map.door_input)
        inputs += () if released is None else (released,)
        inputs += () if io_map.loop_back is None else (io_map.loop_back[1],)
        self._looped = False  # the output that is wired to an input, as it was written last
        self._lags = 0  # polls for which that input has not followed
        registers = tuple(io_map.temperature_registers.values())
        self._feedback = _of_axes(axes, io_map.brake_feedback_inputs)
        self._thermometers = _of_axes(axes, io_map.temperature_registers)
        start, count = _block("discrete inputs", inputs, MAX_READ_BITS)
        self._read_inputs = ReadDiscreteInputsRequest(address=start, count=count, dev_id=unit_id)
        self._read_registers: ReadInputRegistersRequest | None = None
        if registers:
            start, count = _block("input registers", registers, MAX_READ_REGISTERS)
            self._read_registers = ReadInputRegistersRequest(address=start, count=count, dev_id=unit_id)
        if io_map.watchdog is not None:
            self._read_word = ReadHoldingRegistersRequest(address=io_map.watchdog.register, count=1, dev_id=unit_id)
        if io_map.loop_back is not None:
            coil = io_map.loop_back[0]
            self._switch = {on: WriteSingleCoilRequest(address=coil, bits=[on], dev_id=unit_id) for on in (False, True)}

    def poll_once(self, now_s: float) -> None:
        """Write the brakes if commanded, then read all inputs and registers.

        Raises
        ------
        BusError, DeviceError
            As `Transport.request`; the state keeps its age, a brake command stays pending.
        """
        if self._commanded:
            self.write_brakes()
        state, io_map = self.state, self._map
        start, count = self._read_inputs.address, self._read_inputs.count
        bits = self._transport.request(self._read_inputs).bits
        if len(bits) < count:
            raise ProtocolError(f"io: {len(bits)} discrete inputs in the answer where {count} were asked")
        if self._is_alive(bits, start):
            released = io_map.hold_to_run_released_input
            pressed = bits[io_map.hold_to_run_input - start]
            state.hold_to_run = pressed and (released is None or not bits[released - start])
            state.door_closed = bits[io_map.door_input - start]
            for index, feedback in self._feedback:
                state.brakes_open[index] = bits[feedback - start]
            if self._read_registers is not None:
                self._take_temperatures(self._read_registers)
            state.time_s = now_s
        if io_map.watchdog is not None:
            self._take_word()
        self.refresh()

    def _is_alive(self, bits: Sequence[bool], start: int) -> bool:
        """Return whether the wired input has followed its output; the output is switched for the next poll.

        An output that has just been written may take its time to the input, so one poll in a row does not count. Where all brakes are told
        to close the outputs may have fallen by themselves, which is safe, and the inputs are all that shows it: nothing is judged.
        """
        io_map = self._map
        if io_map.loop_back is None:
            return True
        looped = io_map.loop_back[1]
        follows = bits[looped - start] == self._looped
        self._lags = 0 if follows else self._lags + 1
        self._looped ^= follows  # outputs that fell are switched on again until they follow
        self._transport.request(self._switch[self._looped])
        if self._open and not any(self._open.values()):
            self._lags = 0
        return self._lags <= LAGS_BORNE

    def poll_due(self, now_s: float) -> None:
        """Poll when the period is over or a brake command is pending.

        An answer that is malformed is counted and dropped: the state keeps its age, and a brake command stays pending for the next poll.
        Other errors as in `poll_once`.
        """
        self._now_s = now_s
        if now_s >= self._next_poll_s or self._commanded:
            self._next_poll_s = now_s + self._map.poll_period_s
            try:
                self.poll_once(now_s)
            except ProtocolError as error:
                self.malformed += 1
                self.first_malformed = self.first_malformed or str(error)

    def update(self, sample: Sample) -> None:
        """Copy the newest state into the sample, aged by the last `poll_due`."""
        self.state.copy_to(sample, self._now_s, self._map.stale_after_s)

    def command_brakes(self, brakes: Mapping[str, bool]) -> None:
        """Open (True) or close the brakes of the named axes with the next poll; axes without a brake are ignored."""
        for axis, is_open in brakes.items():
            if axis in self._open:
                self._open[axis] = is_open
        self._commanded = True

    def write_brakes(self) -> None:
        """Write the brakes as last commanded, and read nothing. Errors as in `poll_once`; the command then stays pending."""
        for address, bits in _runs({self._map.brake_coils[axis]: is_open for axis, is_open in self._open.items()}):
            self._transport.request(WriteMultipleCoilsRequest(address=address, bits=bits, dev_id=self._map.unit_id))
        self._commanded = False

    def refresh(self) -> None:
        """Refresh the output watchdog, where the supervisor has answered the word that was read last; once. Errors as in `poll_once`."""
        watchdog, state = self._map.watchdog, self.state
        if self._refresh is None or state.word == self._refreshed:
            return
        if (word := self._refresh(state)) is not None and watchdog is not None:
            self._transport.request(WriteSingleRegisterRequest(address=watchdog.register, registers=[word], dev_id=self._map.unit_id))
            self._refreshed = state.word

    def _take_word(self) -> None:
        answer = self._transport.request(self._read_word)
        if len(answer.registers) != 1:
            raise ProtocolError(f"io: {len(answer.registers)} holding registers in the answer where 1 was asked")
        self.state.word, self._refreshed = answer.registers[0], None

    def _take_temperatures(self, request: ReadInputRegistersRequest) -> None:
        registers, count = self._transport.request(request).registers, request.count
        if len(registers) != count:
            raise ProtocolError(f"io: {len(registers)} input registers in the answer where {count} were asked")
        for index, register in self._thermometers:
            self.state.temperature_degC[index] = register_to_temperature(registers[register - request.address])


def brake_requests(io_map: IoMap) -> int:
    """Return the number of requests that write all brakes: one for each run of neighbouring coils."""
    return len(_runs(dict.fromkeys(io_map.brake_coils.values(), False)))


def _of_axes(axes: tuple[str, ...], addresses: Mapping[str, int]) -> list[tuple[int, int]]:
    """Return (place of the axis, address) of every axis that has one."""
    return [(index, addresses[axis]) for index, axis in enumerate(axes) if axis in addresses]


def _block(what: str, addresses: tuple[int, ...], most: int) -> tuple[int, int]:
    """Return (first address, count) of the one read that covers all addresses."""
    start, count = min(addresses), max(addresses) - min(addresses) + 1
    if count > most:
        raise ProtocolError(f"io: {what} {start} to {start + count - 1} do not fit one request of {most}; wire them closer together")
    return start, count


def _runs(coils: dict[int, bool]) -> list[tuple[int, list[bool]]]:
    """Return coils as (first address, values) of neighbours, so that no coil in between is written."""
    runs: list[tuple[int, list[bool]]] = []
    for address in sorted(coils):
        if runs and address == runs[-1][0] + len(runs[-1][1]):
            runs[-1][1].append(coils[address])
        else:
            runs.append((address, [coils[address]]))
    return runs
