"""Transports that carry a Modbus request to the I/O device and its answer back: over TCP, a serial line, or in this process."""

from __future__ import annotations

import logging
import os
import re
import socket
import struct
import time
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple, Protocol

import serial
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU

from drivers.errors import BusTimeoutError, BusUnavailableError, ConfigurationRefusedError, ProtocolError
from drivers.modbus.registers import ExceptionCode
from drivers.serial_port import why_not_opened
from drivers.tcp_url import parse_tcp_url, why_not_reached

ANSWER_TIMEOUT_S = 0.2  # an I/O device answers within some 10 ms
RETRIES = 1
REQUEST_AT_MOST_S = ANSWER_TIMEOUT_S * (2 + 2 * (1 + RETRIES))
"""Waiting for late answers; connecting; every try, whose time an answer in pieces doubles."""

MBAP_PROTOCOL_OFFSET, MBAP_LENGTH_OFFSET, MBAP_UNIT_OFFSET, MBAP_BYTES = 2, 4, 6, 7
KEPT_MESSAGES = 16
"""Requests, and answers: those of two polls are fewer."""

SHOWN_BYTES = 16
PSEUDO_TERMINALS = "/dev/pts/"
MOST_STRAY_BYTES = 8
"""Before an answer: a line without bias reads some while no one drives it."""

STANDARD_FRAMING = "8E1"  # data bits, parity, stop bits: the default of Modbus over Serial Line V1.02, 2.5.1
SHORTEST_ANSWER, WRITE_ANSWER, LAST_READ = 5, 8, 0x04
"""Bytes of an exception's answer, unit and check with it, to which a read adds what it read; of a write's; the last function that reads."""

SILENCE_S, MOST_BYTES = 0.005, 256
"""A message is over after that much silence; most bytes of one."""

_ADDRESSES = "compare unit_id and addresses with the device's manual"
WAY_OUT: dict[int, str] = {
    **dict.fromkeys((ExceptionCode.ILLEGAL_FUNCTION, ExceptionCode.ILLEGAL_DATA_ADDRESS, ExceptionCode.ILLEGAL_DATA_VALUE), _ADDRESSES),
    ExceptionCode.SERVER_DEVICE_FAILURE: "read the device's own diagnosis",
    ExceptionCode.ACKNOWLEDGE: "it has begun and needs longer than an answer may take",
    ExceptionCode.SERVER_DEVICE_BUSY: "it works on another request: a longer poll_period_s asks less often",
    ExceptionCode.GATEWAY_PATH_UNAVAILABLE: "compare unit_id with the gateway's table",
    ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND: "compare unit_id, baud rate and parity behind the gateway",
}
"""What helps where a device refuses."""

UNREADABLE = (ModbusException, struct.error, ValueError, IndexError, TypeError, AttributeError)
"""What pymodbus raises over bytes that are no message; the last five are its decoder's, on messages that are cut off or too long."""

logging.getLogger("pymodbus").addHandler(logging.NullHandler())  # faults are raised as exceptions, not written to standard error


class Transport(Protocol):
    """A line to one Modbus device."""

    def request(self, pdu: ModbusPDU) -> ModbusPDU:
        """Send a request and return its answer.

        Raises
        ------
        BusUnavailableError
            There is no such port, nobody listens, or the connection is gone.
        BusTimeoutError
            Nobody answered.
        ConfigurationRefusedError
            The device answered with an exception.
        ProtocolError
            The answer is damaged or comes from another unit.
        """

    def close(self) -> None:
        """Release the line."""


class InProcessTransport:
    """Transport to a device in this process, every message encoded to bytes and decoded from bytes.

    A poll's requests come again and again, and mostly its answers: neither is encoded or decoded anew, so change none.

    Parameters
    ----------
    serve : callable
        Modbus/TCP bytes in, answers out: `EmulatedIo.serve`.
    """

    def __init__(self, serve: Callable[[bytes], bytes]) -> None:
        self._serve = serve
        decoder = DecodePDU(False)
        self._framer = framer = FramerSocket(decoder)
        self._transaction = 0
        self._decoded = lru_cache(KEPT_MESSAGES)(decoder.decode)
        self._behind_transaction = lru_cache(KEPT_MESSAGES)(lambda pdu: framer.buildFrame(pdu)[MBAP_PROTOCOL_OFFSET:])

    def request(self, pdu: ModbusPDU) -> ModbusPDU:
        """Send a request and return its answer."""
        self._transaction = transaction = self._transaction % 0xFFFF + 1
        sent: bytes = transaction.to_bytes(MBAP_PROTOCOL_OFFSET, "big") + self._behind_transaction(pdu)
        said = self._serve(sent)
        try:
            if _is_answer(said, sent) and (answer := self._decoded(said[MBAP_BYTES:])) is not None:
                return answer
            _, answer = self._framer.handleFrame(said, pdu.dev_id, transaction)
        except UNREADABLE as error:
            raise ProtocolError(f"io: the in-process device's answer is no Modbus message: {error}") from error
        if answer is None:
            raise ProtocolError("io: the in-process device's answer is no Modbus message")
        return _without_exception("io", pdu, answer)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


class ClientTransport:
    """Transport to a device on TCP or a serial line, through pymodbus. It waits for answers, so never use it in the loop's process.

    An adapter whose receiver stays on hands back every request. It is recognised by the first request that comes back before an answer,
    and from then on that is taken away: the answer to some writes equals the request, so an echo must not be mistaken for it.

    On a serial line nothing tells the answer to a request from one to an earlier request with the same function. So answers that are still
    due, because a request was repeated or given up, are waited for and thrown away before the next request with that function; those to
    other functions are passed over when they come, as are stray bytes before an answer.

    Parameters
    ----------
    url : str
        `tcp:HOST:PORT` or `rtu:/dev/ttyUSB1@115200`.
    """

    def __init__(self, url: str, timeout_s: float = ANSWER_TIMEOUT_S) -> None:
        self.name = f"io on {url}"
        self._sent = self._received = b""
        self._timeout_s = timeout_s
        self._line = line = parse_io_url(url)
        self._client: ModbusTcpClient | ModbusSerialClient
        if line.kind == "tcp":
            self._client = ModbusTcpClient(line.place, port=line.number, timeout=timeout_s, retries=RETRIES, trace_packet=self._trace)
            self._open: Callable[[], object] = lambda: socket.create_connection((line.place, line.number), timeout_s).close()
            self._unit_offset = MBAP_UNIT_OFFSET
        else:
            self._client = self._serial_client(echoes=False)
            exclusive = True if os.name == "posix" else None
            self._open = lambda: serial.Serial(line.place, line.number, 8, line.parity, line.stop_bits, exclusive=exclusive).close()
            self._unit_offset = 0
        self._is_serial = self._may_echo = line.kind == "rtu"
        self._tries = 0  # of this request
        self._tried_s = 0.0
        self._due: dict[int, tuple[int, float]] = {}  # function -> answers that may still come, and until when

    def request(self, pdu: ModbusPDU) -> ModbusPDU:
        """Send a request and return its answer; connects when needed."""
        self._received = b""
        self._throw_late_answers_away(pdu.function_code)
        self._tries = 0
        if not self._client.connect():
            raise BusUnavailableError(f"{self.name}: cannot connect: {self._why_not()}")
        try:
            answer = self._client.execute(False, pdu)
            self._await_later(pdu.function_code, self._tries - 1)
        except (*UNREADABLE, OSError) as error:
            self._await_later(pdu.function_code, self._tries)
            if not self._tries or not self._is_serial:
                self.close()
            if self._may_echo and self._sent and self._received.startswith(self._sent):
                self.close()
                self._may_echo, self._client = False, self._serial_client(echoes=True)
                return self.request(pdu)
            raise self._explained(pdu.dev_id, error) from error
        return _without_exception(self.name, pdu, answer)

    def close(self) -> None:
        """Close the connection; the next request opens it again."""
        self._client.close()  # type: ignore[no-untyped-call]

    def _await_later(self, function: int, answers: int) -> None:
        """Keep how many answers may still come to tries that were given up, and until when: as long again as they had."""
        if answers and self._is_serial:
            self._due[function] = answers, self._tried_s + 2.0 * self._timeout_s

    def _throw_late_answers_away(self, function: int) -> None:
        """Wait for answers to earlier tries with this function, at most until they are no longer due."""
        answers, until_s = self._due.pop(function, (0, 0.0))
        line = self._client.socket
        if not answers or not isinstance(line, serial.Serial):
            return
        try:
            while answers and (left_s := until_s - time.monotonic()) > 0.0:
                line.timeout = left_s
                if line.read(1):
                    line.timeout = SILENCE_S
                    while line.read(MOST_BYTES):
                        pass
                    answers -= 1
            line.timeout = self._timeout_s
        except OSError:
            self.close()

    def _serial_client(self, *, echoes: bool) -> ModbusSerialClient:
        line = self._line
        return ModbusSerialClient(
            line.place, baudrate=line.number, parity=line.parity, stopbits=line.stop_bits, timeout=self._timeout_s, retries=RETRIES,
            handle_local_echo=echoes, trace_packet=self._trace,
        )  # fmt: skip

    def _trace(self, sending: bool, data: bytes) -> bytes:
        """Keep what pymodbus has sent and received, which distinguishes a silent device from one that answers wrongly."""
        if sending:
            self._sent = data
            self._tries += 1
            self._tried_s = time.monotonic()
            return data
        self._received = data
        is_echo = self._may_echo and data.startswith(self._sent)
        return data[_stray_bytes(data, self._sent) :] if self._is_serial and not is_echo else data

    def _why_not(self) -> str:
        """Ask the system again why connecting failed, because pymodbus logs the reason and returns False."""
        try:
            self._open()
        except (OSError, ValueError) as error:
            if self._is_serial or not isinstance(error, OSError):
                return why_not_opened(error)
            return f"{why_not_reached(error)}; check address, cable and power"
        return "not at first, a moment later it could be opened"

    def _explained(self, unit_id: int, error: Exception) -> Exception:
        """Return the error that names what was seen: nothing, the end of the connection, another unit, or bytes that are no answer."""
        received = self._received
        if not received and isinstance(error, (OSError, ConnectionException)):
            seen = why_not_reached(error) if isinstance(error, OSError) else "the other end closed the connection"
            return BusUnavailableError(f"{self.name}: {seen} before an answer from unit {unit_id} had come")
        if not received or (self._is_serial and received[_stray_bytes(received, self._sent) :] == self._sent):  # nothing but its echo
            check = "check unit_id, baud rate, parity and cable" if self._is_serial else "check unit_id"
            return BusTimeoutError(f"{self.name}: no answer from unit {unit_id} in {self._timeout_s:g} s; {check}")
        is_whole = not self._is_serial or _length(received) is not None
        if is_whole and len(received) > self._unit_offset and received[self._unit_offset] != unit_id:
            return ProtocolError(f"{self.name}: unit {received[self._unit_offset]} answers where unit_id = {unit_id} was asked")
        seen = _what_is_wrong(received, self._sent) if self._is_serial else _what_is_wrong_on_tcp(received)
        shown = received[:SHOWN_BYTES].hex(" ")
        return ProtocolError(f"{self.name}: {seen} ({shown}){'; check wiring, baud rate and parity' if self._is_serial else ''}")


def _is_answer(said: bytes, sent: bytes) -> bool:
    """Return whether bytes are one message with a request's transaction, unit and function, which are in the same places."""
    return (
        said[:MBAP_LENGTH_OFFSET] == sent[:MBAP_LENGTH_OFFSET]
        and said[MBAP_UNIT_OFFSET : MBAP_BYTES + 1] == sent[MBAP_UNIT_OFFSET : MBAP_BYTES + 1]
        and len(said) - MBAP_UNIT_OFFSET == int.from_bytes(said[MBAP_LENGTH_OFFSET:MBAP_UNIT_OFFSET], "big")
    )


def _what_is_wrong(received: bytes, sent: bytes) -> str:
    """Return what serial bytes are that hold no whole answer."""
    if received[:1] != sent[:1] or received[1:2] not in (sent[1:2], bytes((sent[1] | 0x80,))):
        return "no answer to what was asked is in what came"
    announced = _announced(received)
    if announced is None or len(received) < announced:
        return f"an answer of which {len(received)} bytes came" + ("" if announced is None else f" where {announced} belong")
    return "a damaged answer, its check is wrong"


def _what_is_wrong_on_tcp(received: bytes) -> str:
    """Return what bytes of a connection are that hold no whole answer."""
    if len(received) < MBAP_BYTES:
        return f"an answer of {len(received)} bytes, where its header alone has {MBAP_BYTES}"
    protocol, length = int.from_bytes(received[2:4], "big"), int.from_bytes(received[4:6], "big")
    if protocol:
        return f"an answer with protocol identifier {protocol}, where Modbus has 0"
    if len(received) - MBAP_UNIT_OFFSET != length:
        return f"an answer of {len(received) - MBAP_UNIT_OFFSET} bytes behind its length, which says {length}"
    return "an answer that is none to what was asked"


def _stray_bytes(received: bytes, sent: bytes) -> int:
    """Return how many bytes lie before the answer to what was sent: late answers to other functions, and strays."""
    start = 0
    while (length := _length(received[start:])) is not None and received[start] == sent[0] and received[start + 1] & 0x7F != sent[1]:
        start += length
    for stray in range(start, min(len(received), start + MOST_STRAY_BYTES + 1)):
        rest = received[stray:]
        if rest[:1] == sent[:1] and _length(rest) is not None and rest[1] & 0x7F == sent[1]:
            return stray
    return start


def _length(received: bytes) -> int | None:
    """Return the bytes of the answer that begins here; None where it is not whole or its check is wrong."""
    length = _announced(received)
    if length is None or len(received) < length:
        return None
    check = FramerRTU.compute_CRC(received[: length - 2])
    return length if check == int.from_bytes(received[length - 2 : length], "big") else None


def _announced(received: bytes) -> int | None:
    """Return the bytes that an answer that begins here has by its own words; None where it is shorter than any."""
    if len(received) < SHORTEST_ANSWER:
        return None
    function = received[1]
    return SHORTEST_ANSWER if function & 0x80 else SHORTEST_ANSWER + received[2] if function <= LAST_READ else WRITE_ANSWER


def _without_exception(name: str, request: ModbusPDU, answer: ModbusPDU) -> ModbusPDU:
    if isinstance(answer, ExceptionResponse) or answer.isError():
        try:
            reason = ExceptionCode(answer.exception_code).name.lower().replace("_", " ")
        except ValueError:
            reason = "unknown exception"
        last = request.address + max(1, request.count, len(request.bits)) - 1
        raise ConfigurationRefusedError(
            f"{name}: unit {request.dev_id} refuses function {request.function_code} at {request.address} to {last}:"
            f" {reason} ({answer.exception_code}); {WAY_OUT.get(answer.exception_code, 'its manual says what this means')}"
        )
    if answer.function_code != request.function_code:
        raise ProtocolError(f"{name}: an answer to function {answer.function_code} where function {request.function_code} was asked")
    return answer


class IoLine(NamedTuple):
    """Where an I/O device is: host and port, or serial device, baud rate and framing."""

    kind: str  # "tcp" or "rtu"
    place: str
    number: int
    framing: str = ""  # data bits, parity, stop bits; "" on TCP

    @property
    def parity(self) -> str:
        """N, E or O; a pseudo terminal, which carries bytes and no bits, has none."""
        return "N" if os.path.realpath(self.place).startswith(PSEUDO_TERMINALS) else self.framing[1:2]

    @property
    def stop_bits(self) -> int:
        """1 or 2."""
        return int(self.framing[2:])


def parse_io_url(url: str) -> IoLine:
    """Split `tcp:HOST:PORT`, `rtu:DEVICE@BAUD` or `rtu:DEVICE@BAUD,8N1`; without a framing, a serial line has the standard's 8E1.

    Raises
    ------
    BusUnavailableError
        The URL is neither of them.
    """
    if address := parse_tcp_url(url):
        return IoLine("tcp", *address)
    if (match := re.fullmatch(r"rtu:(.+)@([0-9]{1,8})(?:,(8[NEO][12]))?", url)) and int(match[2]) > 0:
        return IoLine("rtu", match[1], int(match[2]), match[3] or STANDARD_FRAMING)
    raise BusUnavailableError(
        f"io url {url!r}: it reads tcp:HOST:PORT or rtu:DEVICE@BAUD, e.g. tcp:192.168.0.5:502, rtu:/dev/ttyUSB1@115200 "
        "or rtu:/dev/ttyUSB1@19200,8N1"
    )
