"""Frames to and from the node under test, kept in the order in which they went over the wire."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import can

from drivers.canopen.network import SDO_REQUEST, SDO_RESPONSE, receive_frame, send_frame

ANSWER_S = 0.5
"""Longest time for an SDO answer. CiA 301 gives none; devices answer within 20 ms, writes to flash within 200 ms."""
QUIET_S = 0.06
"""Silence that counts as no answer where none may come."""


@dataclass(frozen=True)
class Frame:
    """One frame; `time_s` of a received one is the time stamp of `open_bus(..., stamped=True)`, of a sent one the tester's clock."""

    time_s: float
    can_id: int
    data: bytes
    sent: bool = False
    remote: bool = False

    def __str__(self) -> str:
        """Return it as a person reads it."""
        return (
            f"{'sent' if self.sent else 'came'} {self.can_id:03X} {'remote' if self.remote else self.data.hex(' ').upper() or '(no data)'}"
        )


class Wire:
    """The tester's end of the bus.

    Parameters
    ----------
    bus : can.BusABC
        Open; it stays open.
    now : callable
        Time [s]: of the wall, or of a device in this process.
    node_id : int
    """

    def __init__(self, bus: can.BusABC, now: Callable[[], float], node_id: int) -> None:
        self._bus, self.now, self.node_id = bus, now, node_id
        self.log: list[Frame] = []

    def send(self, can_id: int, data: bytes = b"", *, remote: bool = False) -> Frame:
        """Send one frame.

        Raises
        ------
        BusError
            The bus does not take it.
        """
        self._receive_all(0.0)  # what came before was no answer
        frame = Frame(self.now(), can_id, data, sent=True, remote=remote)
        self.log.append(frame)
        send_frame(self._bus, can.Message(arbitration_id=can_id, is_extended_id=False, data=data, is_remote_frame=remote))
        return frame

    def _receive(self, timeout_s: float) -> Frame | None:
        message = receive_frame(self._bus, timeout_s)
        if message is None or message.is_error_frame or message.is_extended_id or message.is_fd:
            return None
        frame = Frame(message.timestamp, message.arbitration_id, bytes(message.data), remote=message.is_remote_frame)
        self.log.append(frame)
        return frame

    def _receive_all(self, seconds: float, wanted: int = -1) -> Frame | None:
        deadline = self.now() + seconds
        while True:
            left_s = deadline - self.now()
            frame = self._receive(max(0.0, left_s))
            if frame is not None and frame.can_id == wanted:
                return frame
            if frame is None and left_s <= 0.0:
                return None

    def mark(self) -> int:
        """Return the present place in the log."""
        self._receive_all(0.0)
        return len(self.log)

    def listen(self, seconds: float) -> None:
        """Take what comes in this time."""
        self._receive_all(seconds)

    def wait(self, can_id: int, timeout_s: float) -> Frame | None:
        """Return the next frame with this identifier, None when none comes in time."""
        return self._receive_all(timeout_s, can_id)

    def heard(self, can_id: int, since: int = 0) -> list[Frame]:
        """Return the frames received with this identifier since a mark."""
        return [frame for frame in self.log[since:] if frame.can_id == can_id and not frame.sent]

    def sdo(self, request: bytes, timeout_s: float = ANSWER_S) -> bytes | None:
        """Send an SDO request of eight bytes; return the answer, None when none comes in time."""
        self.send(SDO_REQUEST + self.node_id, request.ljust(8, b"\0"))
        answer = self.wait(SDO_RESPONSE + self.node_id, timeout_s)
        return None if answer is None else answer.data.ljust(8, b"\0")

    def sdo_answer(self, timeout_s: float = ANSWER_S) -> bytes | None:
        """Return a further SDO answer, None when none comes in time."""
        answer = self.wait(SDO_RESPONSE + self.node_id, timeout_s)
        return None if answer is None else answer.data.ljust(8, b"\0")
