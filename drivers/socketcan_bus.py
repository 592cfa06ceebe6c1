"""SocketCAN with one system call a frame.

python-can asks `select` before every frame that it sends or takes, and reads the clock and prepares a line for its log besides. A tick pays
that six times or more. Here a frame is sent and taken at once; `select` is asked only by those who wait. Who judges a node by when its
frames came opens python-can's own bus, `open_bus(..., stamped=True)`: its time stamps are the kernel's.
"""

from __future__ import annotations

import select
import struct
import time

import can
from can.interfaces.socketcan import SocketcanBus as PythonCanBus
from can.interfaces.socketcan.socketcan import build_can_frame

from drivers.data_frame import DataFrame

FRAME = struct.Struct("=IB3x8s")  # linux/can.h, struct can_frame
EXTENDED, REMOTE, ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
EXTENDED_ID, STANDARD_ID = 0x1FFF_FFFF, 0x7FF


class SocketcanBus(PythonCanBus):
    """python-can's SocketCAN bus, CAN 2.0 only.

    Parameters
    ----------
    channel : str
        Interface, such as "can0".
    """

    def __init__(self, channel: str) -> None:
        super().__init__(channel)
        self.socket.setblocking(False)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send as `can.BusABC` does; never waits."""
        self._send(build_can_frame(msg))

    def send_frame(self, can_id: int, data: bytes) -> None:
        """Send a data frame with an 11-bit identifier, without a message object around it."""
        self._send(FRAME.pack(can_id, len(data), data))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Receive as `can.BusABC` does; the stamp is the time of reading."""
        give_up_s = None if timeout is None or timeout <= 0.0 else time.perf_counter() + timeout
        while True:
            try:
                frame = self.socket.recv(FRAME.size)
            except BlockingIOError:
                remaining = timeout if give_up_s is None else give_up_s - time.perf_counter()
                if (remaining is not None and remaining <= 0.0) or not select.select([self.socket], [], [], remaining)[0]:
                    return None
                continue
            except OSError as error:
                raise can.CanOperationError(f"failed to receive: {error.strerror or error}", error.errno) from error
            message = message_of(frame)
            if self._is_filtered or self._filters is None or self._matches_filters(message):
                return message

    def _send(self, frame: bytes) -> None:
        try:
            self.socket.send(frame)
        except BlockingIOError as error:
            raise can.CanOperationError("transmit buffer full", error.errno) from error
        except OSError as error:
            raise can.CanOperationError(f"failed to send: {error.strerror or error}", error.errno) from error


def message_of(frame: bytes) -> can.Message:
    """Return a frame of the kernel as python-can's message, stamped with the present time."""
    can_id, length, data = FRAME.unpack(frame)
    if can_id <= STANDARD_ID:
        return DataFrame(can_id, data[:length], time.time())
    extended, remote = bool(can_id & EXTENDED), bool(can_id & REMOTE)
    return can.Message(
        time.time(),
        can_id & (EXTENDED_ID if extended else STANDARD_ID),
        extended,
        remote,
        bool(can_id & ERROR),
        None,
        length,
        b"" if remote else data[:length],
    )
