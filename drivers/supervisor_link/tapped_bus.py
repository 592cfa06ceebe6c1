"""A bus that only one process can open, whose frames are passed on to the supervisor."""

from __future__ import annotations

import contextlib
import socket

import can

from drivers.shared_memory.supervisor_blocks import FRAME


class TappedBus(can.BusABC):
    """A bus that has one owner: what passes is passed on, and what the supervisor sends is sent.

    Parameters
    ----------
    bus : can.BusABC
        Remains the caller's.
    tap : socket.socket
        Does not block; a frame that does not fit is left out, and a supervisor that hears nothing stops the machine.
    """

    def __init__(self, bus: can.BusABC, tap: socket.socket) -> None:
        self._bus, self._tap = bus, tap
        super().__init__(channel=bus.channel_info)
        self.channel_info = bus.channel_info

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, and pass it on."""
        self._bus.send(msg, timeout)
        self._pass_on(msg)
        with contextlib.suppress(OSError):
            can_id, length, data = FRAME.unpack(self._tap.recv(FRAME.size))
            self._bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data[:length]))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame, and pass it on."""
        message = self._bus.recv(timeout)
        if message is not None:
            self._pass_on(message)
        return message

    def _pass_on(self, message: can.Message) -> None:
        if not (message.is_extended_id or message.is_error_frame or message.is_remote_frame or message.is_fd):
            with contextlib.suppress(OSError):
                self._tap.send(FRAME.pack(message.arbitration_id, len(message.data), bytes(message.data)))

    def shutdown(self) -> None:
        """Close the tap; the bus remains open."""
        super().shutdown()
        self._tap.close()
