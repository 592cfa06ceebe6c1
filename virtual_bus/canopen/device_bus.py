"""A python-can bus without wires, on virtual time: its other end is one bare device, in the same thread."""

from __future__ import annotations

from collections import deque

import can

from virtual_bus.canopen.bare import BareMachine

STEP_S = 0.001
"""Largest step of virtual time while nothing comes. The device is looked at sooner where something is due."""


class DeviceBus(can.BusABC):
    """A bus on which a frame that is sent is answered before `send` returns, and time passes only in `recv`.

    Parameters
    ----------
    machine : BareMachine
        Connected and powered on by this constructor; its boot-up waits for `recv`.
    """

    def __init__(self, machine: BareMachine) -> None:
        self._machine = machine
        self._frames: deque[can.Message] = deque()
        self.channel_info = "lockstep: one bare device in this process"
        super().__init__(channel="lockstep")
        machine.connect(self._queue)
        machine.power_on()

    def now(self) -> float:
        """Return the device's time [s]."""
        return self._machine.time_s

    def _queue(self, can_id: int, data: bytes) -> None:
        self._frames.append(can.Message(timestamp=self.now(), arbitration_id=can_id, data=data, is_extended_id=False))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand a frame to the device. Nobody listens to error, 29-bit and CAN FD frames."""
        if msg.is_error_frame or msg.is_extended_id or msg.is_fd:
            return
        if msg.is_remote_frame:
            self._machine.receive_remote(msg.arbitration_id)
        else:
            self._machine.receive(msg.arbitration_id, bytes(msg.data))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame; with none there, time passes until one comes or the time-out is over."""
        left_s = timeout or 0.0
        while not self._frames and left_s > 0.0:
            step_s = min(left_s, STEP_S)
            self._machine.idle(step_s)
            left_s -= step_s
        return self._frames.popleft() if self._frames else None
