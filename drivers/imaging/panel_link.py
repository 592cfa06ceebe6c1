"""Frames of a panel over TCP: told when to expose, it sends each as it is read out, stamped with the SYNC at which its pulse was seen.

The panel hears the CAN bus and counts SYNCs from the last NMT start on, and so does who sends them: the count is the loop's time on both
sides, with no clock besides. Both ends of the wire are here: what the host says is a line of text, what the panel says a header and pixels.
A panel has one host at a time and greets it; a second one that connects meanwhile hears nothing until its turn comes.
"""

from __future__ import annotations

import select
import socket
import struct
import time

import numpy as np

from drivers.errors import BusUnavailableError, DriverError
from drivers.imaging.spool import Frame
from drivers.tcp_url import parse_tcp_url, why_not_reached

HEADER = struct.Struct("<4sIHHQdd")
"""Mark, number, rows, columns, SYNC count at the pulse, start and width by the panel's clock; then rows x columns pixels of 16 bits.

No rows and no columns: all exposures have been sent, as many as the number says. So it greets, too: none yet."""

MARK = b"IXF1"
CONNECT_TIMEOUT_S = 2.0
GREETING_TIMEOUT_S = 5.0
"""A panel may still make an image for the host before, who is gone."""

READ_BYTES = 1 << 20


class PanelError(DriverError):
    """A panel on the network does not do what it was told.

    Example scenarios
    -----------------
    - It hung up during a scan, or what it sends are no frames.
    - It does not say that it has ended, long after it was told to stop.
    """


def expose_command(rate_Hz: float, binning: int) -> bytes:
    """Expose from now on, so many times a second by the panel's clock; `binning` x `binning` pixels are read as one."""
    return f"expose {rate_Hz!r} {binning}\n".encode()


STOP_COMMAND = b"stop\n"
"""Expose no more; what was exposed is sent, then the end."""


def read_command(line: bytes) -> tuple[float, int] | None:
    """The panel's end: rate [1/s] and binning of `expose_command`, None of `STOP_COMMAND`.

    Raises
    ------
    PanelError
        It is neither.
    """
    if line + b"\n" == STOP_COMMAND:
        return None
    try:
        word, rate, binning = line.decode().split()
        asked = float(rate), int(binning)
        if word == "expose" and 0.0 < asked[0] < np.inf and asked[1] >= 1:
            return asked
    except ValueError:
        pass
    raise PanelError(f"{line[:40]!r}: a panel is told `expose RATE BINNING` or `stop`")


def frame_bytes(exposure_id: int, sync: int, panel_s: float, width_s: float, image: np.ndarray) -> bytes:
    """The panel's end: one frame."""
    rows, columns = image.shape
    return HEADER.pack(MARK, exposure_id, rows, columns, sync, panel_s, width_s) + image.astype("<u2").tobytes()


def end_bytes(exposures: int) -> bytes:
    """The panel's end: all of its exposures have been sent; of none, its greeting."""
    return HEADER.pack(MARK, exposures, 0, 0, 0, 0.0, 0.0)


class PanelLink:
    """The host's end.

    Parameters
    ----------
    url : str
        `tcp:HOST:PORT`.
    period_s : float
        Of SYNC.

    Attributes
    ----------
    exposures : int or None
        How many there were, told with the end.

    Raises
    ------
    BusUnavailableError
        No such address, nobody listens there, or who does is no panel or another host's.
    """

    def __init__(self, url: str, period_s: float) -> None:
        address = parse_tcp_url(url)
        if address is None:
            raise BusUnavailableError(f"panel {url}: its address reads tcp:HOST:PORT, e.g. tcp:192.168.0.7:4100")
        self.url, self.exposures = url, None
        self._period_s, self._first, self._data = period_s, 0, bytearray()
        try:
            self._socket = socket.create_connection(address, CONNECT_TIMEOUT_S)
        except OSError as error:
            raise BusUnavailableError(f"panel {url}: {why_not_reached(error)}; name a panel that is on") from error
        self._socket.setblocking(False)
        try:
            self._await_greeting()
        except BaseException:
            self.close()
            raise

    def expose(self, rate_Hz: float, binning: int, first_sync: int) -> None:
        """Begin; times are counted from the SYNC of this count."""
        self._first, self.exposures = first_sync, None
        self._say(expose_command(rate_Hz, binning))

    def stop(self) -> None:
        """Expose no more; what was exposed still comes, then `exposures` is known."""
        self._say(STOP_COMMAND)

    def wait(self, seconds: float) -> None:
        """Until something comes, so long at most."""
        select.select([self._socket], [], [], seconds)

    def poll(self) -> list[Frame]:
        """Frames that have come since, in their order; pulses in periods of SYNC since the first.

        Raises
        ------
        PanelError
            The panel has hung up, or what came is no frame.
        """
        gone = self._read()
        frames = []
        while (frame := self._next()) is not None:
            frames.append(frame)
        if gone and not frames and self.exposures is None:
            raise PanelError(f"panel {self.url} is gone: {gone}")
        return frames

    def _await_greeting(self) -> None:
        until_s = time.monotonic() + GREETING_TIMEOUT_S
        while self.exposures is None:
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                said = f"has not greeted within {GREETING_TIMEOUT_S:g} s"
                raise BusUnavailableError(f"panel {self.url}: {said}; name a panel, and one that nobody else uses now")
            self.wait(left_s)
            try:
                self.poll()
            except PanelError as error:
                raise BusUnavailableError(str(error)) from None
        self.exposures = None

    def _read(self) -> str:
        """Take what has come; why nothing comes any more, or ''."""
        while True:
            try:
                data = self._socket.recv(READ_BYTES)
            except BlockingIOError:
                return ""
            except OSError as error:
                return error.strerror or str(error)
            if not data:
                return "it hung up"
            self._data += data

    def _next(self) -> Frame | None:
        data = self._data
        if len(data) < HEADER.size:
            return None
        mark, number, rows, columns, sync, panel_s, width_s = HEADER.unpack_from(data)
        if mark != MARK or not (np.isfinite([panel_s, width_s]).all() and width_s >= 0.0):
            raise PanelError(f"panel {self.url}: what it sends is no frame; is it a panel, and of this version?")
        size = HEADER.size + 2 * rows * columns
        if len(data) < size:
            return None
        image = np.frombuffer(bytes(data[HEADER.size : size]), dtype="<u2").astype(np.uint16).reshape(rows, columns)
        del data[:size]
        if not image.size:
            self.exposures = number
            return None
        return Frame(number, panel_s, width_s, (sync - self._first) * self._period_s, image)

    def _say(self, command: bytes) -> None:
        try:
            self._socket.sendall(command)
        except OSError as error:
            raise PanelError(f"panel {self.url} is gone: {error.strerror or error}") from error

    def close(self) -> None:
        """Hang up."""
        self._socket.close()
