"""A python-can bus without wires: its other end is the emulated machine, in the same thread, on virtual time.

Every frame is still encoded and decoded, serial bytes and Modbus messages go through in-process lines with the same codecs, and nothing
ever waits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import inf
from typing import Any, TextIO

import can

from virtual_bus.machine import EmulatedMachine
from virtual_bus.serial.pipe import PipeEnd, pipe
from virtual_bus.special_frames import FLAGS, message_of

CHANNEL = "lockstep"

MOST_HEARD = 3 * 32
"""Values of frames, three each, that wait for the listener where no SYNC comes: those of four ticks of two axes."""


class LockstepBus(can.BusABC):
    """A bus on which a frame that is sent is answered before `send` returns; the answers wait for `recv`.

    Parameters
    ----------
    machine : EmulatedMachine
        Powered on and then connected by this constructor: it has sent its boot-ups already, like a machine that was on before the bench.
    log : text file, optional
        Takes every frame of both directions in candump's form, with virtual time.
    """

    def __init__(self, machine: EmulatedMachine, log: TextIO | None = None) -> None:
        self.machine = machine
        self.time_s = 0.0  # virtual: one period per SYNC, and what passes in `recv` and `pass_time`
        self.channel_info = "lockstep: the emulated machine in this process"
        self._frames: deque[tuple[int, bytes]] = deque()
        self._sync_id = machine.bus.sync_cob_id
        self._period_s = machine.period_s
        self._log = log
        self._heard: list[Any] = []
        self._listener: Callable[[], None] | None = None
        super().__init__(channel=CHANNEL)
        machine.power_on()
        machine.connect(self._queue if log is None else self._queue_logged)

    def tap(self, heard: list[Any], listener: Callable[[], None]) -> None:
        """Note every data frame of both directions in `heard`: identifier, data and time of each, one after the other.

        `listener` is called with every SYNC, before anybody else hears it, and where many frames wait. It takes them out.
        """
        self._heard, self._listener = heard, listener

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand a frame to the machine. Nobody listens to error, 29-bit and CAN FD frames."""
        if msg.is_error_frame or msg.is_extended_id or msg.is_fd:
            return
        if msg.is_remote_frame:
            self.machine.receive_remote(msg.arbitration_id)
        else:
            self.send_frame(msg.arbitration_id, bytes(msg.data))

    def send_frame(self, can_id: int, data: bytes) -> None:
        """Hand a frame to the machine without a message object around it."""
        if self._log is not None:
            self._write_log(can_id, data)
        is_sync = can_id == self._sync_id
        if (listener := self._listener) is not None:
            heard = self._heard
            heard += can_id, data, self.time_s
            if is_sync or len(heard) >= MOST_HEARD:
                listener()
        self.machine.receive(can_id, data)
        if is_sync and self.machine.until_sync_s == inf:
            self.time_s += self._period_s

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame.

        With none there, virtual time passes until one comes or the time-out is over; without a time-out there is no wait.
        """
        if not self._frames and not (timeout and self._wait_for_frame(timeout)):
            return None
        return self.as_message(*self._frames.popleft())

    def waiting_frames(self) -> deque[tuple[int, bytes]]:
        """Return the frames that wait, as (identifier, data), for a caller that takes them out; no time passes."""
        return self._frames

    def as_message(self, can_id: int, data: bytes) -> can.Message:
        """Return a frame of `waiting_frames` as `recv` would."""
        message = message_of(can_id, data)
        message.timestamp, message.channel = self.time_s, CHANNEL
        return message

    def pass_time(self, seconds: float) -> None:
        """Let virtual time pass without a SYNC; frames that come meanwhile wait for `recv`."""
        while seconds > 0.0:
            step_s = min(seconds, self._period_s, self.machine.until_sync_s)
            self.time_s += step_s
            self.machine.idle(step_s)
            seconds -= step_s

    def _wait_for_frame(self, timeout_s: float) -> bool:
        while timeout_s > 0.0 and not self._frames:
            step_s = min(timeout_s, self._period_s, self.machine.until_sync_s)
            self.pass_time(step_s)
            timeout_s -= step_s
        return bool(self._frames)

    def _queue(self, can_id: int, data: bytes) -> None:
        if (listener := self._listener) is not None and not can_id & FLAGS:
            heard = self._heard
            heard += can_id, data, self.time_s
            if can_id == self._sync_id or len(heard) >= MOST_HEARD:
                listener()
        if self._filters is None or self._matches_filters(self.as_message(can_id, data)):
            self._frames.append((can_id, data))

    def _queue_logged(self, can_id: int, data: bytes) -> None:
        self._write_log(can_id, data)
        self._queue(can_id, data)

    def _write_log(self, can_id: int, data: bytes) -> None:
        assert self._log is not None
        self._log.write(f"({self.time_s:.6f}) {CHANNEL} {can_id:03X}#{data.hex().upper()}\n")


def imu_line(machine: EmulatedMachine) -> PipeEnd:
    """Return the bench's end of a serial line to the machine's IMU."""
    imu = machine.imu
    assert imu is not None, "this machine has no IMU"
    bench, device = pipe()
    device.on_data = lambda: device.write(imu.receive(device.read()))
    machine.imu_out = device.write
    return bench


def io_line(machine: EmulatedMachine) -> PipeEnd:
    """Return the bench's end of a Modbus/TCP connection to the machine's I/O device."""
    io = machine.io
    assert io is not None, "this machine has no I/O device"
    bench, device = pipe()
    device.on_data = lambda: device.write(io.serve(device.read()))
    return bench
