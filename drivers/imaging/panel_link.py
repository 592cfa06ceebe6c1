"""Frames of a panel over TCP: the panel sends each frame as it is read out, stamped with the SYNC at which its pulse was seen.

The panel listens to the CAN bus and counts SYNCs from the last NMT start, and so does the sender of the SYNCs: the count is the loop's time
on both sides, without another clock. This module holds both ends of the line: the host sends lines of text, the panel sends headers and
pixels. A panel serves one host at a time and greets it; a second host that connects meanwhile receives nothing until its turn.
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

Without rows and columns: all exposures have been sent, and the number is their count. The greeting is such a header with a count of 0."""

MARK = b"IXF1"
SHOWN_BYTES = 16
CONNECT_TIMEOUT_S = 2.0
GREETING_TIMEOUT_S = 5.0
"""Generous, because a panel may still be making an image for a previous host that is gone."""

MOST_PIXELS = 2**27
"""The largest flat panels have 16 million."""


class PanelError(DriverError):
    """A panel on the network does not follow the protocol.

    Example scenarios
    -----------------
    - It hung up during a scan, or sends something else than frames.
    - It does not report the end long after it was told to stop.
    """


def expose_command(rate_Hz: float, binning: int) -> bytes:
    """Return the command to expose at a rate by the panel's clock; `binning` x `binning` pixels are read as one."""
    return f"expose {rate_Hz!r} {binning}\n".encode()


STOP_COMMAND = b"stop\n"
"""Ends the exposures; the panel sends what was exposed, then the end."""


def read_command(line: bytes) -> tuple[float, int] | None:
    """Return rate [1/s] and binning of `expose_command`, None of `STOP_COMMAND`; for the panel's end.

    Raises
    ------
    PanelError
        The line is neither.
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
    """Return the bytes of one frame; for the panel's end."""
    rows, columns = image.shape
    return HEADER.pack(MARK, exposure_id, rows, columns, sync, panel_s, width_s) + image.astype("<u2").tobytes()


def end_bytes(exposures: int) -> bytes:
    """Return the bytes that end a series of exposures, or greet when there are none yet; for the panel's end."""
    return HEADER.pack(MARK, exposures, 0, 0, 0, 0.0, 0.0)


class PanelLink:
    """The host's end of the line.

    Parameters
    ----------
    url : str
        `tcp:HOST:PORT`.
    period_s : float
        Period of SYNC.

    Attributes
    ----------
    exposures : int or None
        Number of exposures, known with the end of a series.

    Raises
    ------
    BusUnavailableError
        The address is invalid, nobody listens there, or the listener is no panel or serves another host.
    """

    def __init__(self, url: str, period_s: float) -> None:
        address = parse_tcp_url(url)
        if address is None:
            raise BusUnavailableError(f"panel {url}: its address reads tcp:HOST:PORT, e.g. tcp:192.168.0.7:4100")
        self.url, self.exposures = url, None
        self._period_s, self._first, self._is_gone = period_s, 0, False
        self._header, self._image = bytearray(HEADER.size), np.empty(0, dtype="<u2")
        self._missing = memoryview(self._header)
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
        """Begin to expose; times are counted from the SYNC with this count."""
        self._first, self.exposures = first_sync, None
        self._say(expose_command(rate_Hz, binning))

    def stop(self) -> None:
        """End the exposures; what was exposed still comes, and then `exposures` is known."""
        self._say(STOP_COMMAND)

    def wait(self, seconds: float) -> None:
        """Wait until data come, at most this long; from a panel that has hung up none do."""
        if self._is_gone:
            time.sleep(seconds)
        else:
            select.select([self._socket], [], [], seconds)

    def poll(self) -> list[Frame]:
        """Return the frames that have come since the last call, in order; pulses are in periods of SYNC since the first.

        Raises
        ------
        PanelError
            The panel has hung up, or sent something else than a frame.
        """
        frames: list[Frame] = []
        while not (gone := self._read()):
            if self._missing:  # nothing more has come
                return frames
            frames += self._completed()
        self._is_gone = True
        if not frames and self.exposures is None:
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
        """Read what is missing of a header or of an image, straight into it; return why the connection has ended, or ''."""
        while self._missing:
            try:
                count = self._socket.recv_into(self._missing)
            except BlockingIOError:
                return ""
            except OSError as error:
                return error.strerror or str(error)
            if not count:
                return "it hung up"
            self._missing = self._missing[count:]
        return ""

    def _completed(self) -> list[Frame]:
        """Return the frame whose last byte has come; none after a header, whose image is awaited then."""
        mark, number, rows, columns, sync, panel_s, width_s = HEADER.unpack(self._header)
        if self._image.size == 0:
            if mark != MARK:
                came = bytes(self._header[:SHOWN_BYTES]).hex(" ")
                raise PanelError(f"panel {self.url}: what it sends is no frame ({came}); this version's begin with {MARK.hex(' ')}")
            if rows * columns > MOST_PIXELS or not (np.isfinite([panel_s, width_s]).all() and width_s >= 0.0):
                raise PanelError(
                    f"panel {self.url}: a frame of {rows} x {columns} pixels with a pulse of {width_s:g} s at {panel_s:g} s is none"
                )
            if rows * columns:
                self._image = np.empty(rows * columns, dtype="<u2")
                self._missing = self._image.data.cast("B")
                return []
        image, self._image = self._image, np.empty(0, dtype="<u2")
        self._missing = memoryview(self._header)
        if not image.size:
            self.exposures = number
            return []
        whole = image.astype(np.uint16, copy=False).reshape(rows, columns)
        return [Frame(number, panel_s, width_s, (sync - self._first) * self._period_s, whole)]

    def _say(self, command: bytes) -> None:
        try:
            self._socket.sendall(command)
        except OSError as error:
            raise PanelError(f"panel {self.url} is gone: {error.strerror or error}") from error

    def close(self) -> None:
        """Hang up."""
        self._socket.close()
