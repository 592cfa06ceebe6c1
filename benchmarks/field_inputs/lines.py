"""Lines to devices on which something else comes than an answer: the message names what came."""

from __future__ import annotations

import contextlib
import socket
import threading
from functools import partial
from pathlib import Path

from pymodbus.pdu.bit_message import ReadDiscreteInputsRequest

from drivers.errors import DriverError
from drivers.modbus.transport import ClientTransport
from drivers.serial.imu import ImuDriver
from drivers.serial.stream import SerialStream
from drivers.serial.xbus import encode
from drivers.settings import ImuPort
from field_inputs.kinds import RIGHT, WRONG, Input, Outcome, refused
from virtual_bus.modbus.framing import rtu_frame
from virtual_bus.serial.pipe import pipe
from virtual_bus.serial.pty import Pty

UNIT, TIMEOUT_S = 17, 0.05
TCP = b"\0\0\0\4\x11\2\1\3"
RTU = rtu_frame(UNIT, b"\x02\x01\x03")


def asked(url: str, words: str) -> Outcome:
    """Read two inputs, and compare what is said with `words`; "": both are on."""
    transport = ClientTransport(url, TIMEOUT_S)
    try:
        bits = transport.request(ReadDiscreteInputsRequest(address=8, count=2, dev_id=UNIT)).bits[:2]
    except DriverError as refusal:
        return refused(str(refusal), words or "no refusal was due")
    finally:
        transport.close()
    return Outcome(RIGHT if bits == [True, True] and not words else WRONG, str(bits))


def on_tcp(_: Path, answer: bytes, words: str, closes: bool = False) -> Outcome:
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listener.accept()
                with connection:
                    while request := connection.recv(64):
                        connection.sendall(request[:2] + answer if answer else b"")
                        if closes:
                            break

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        return asked(f"tcp:127.0.0.1:{listener.getsockname()[1]}", words)
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join()


def on_serial(_: Path, answer: bytes, words: str) -> Outcome:
    pty, over = Pty(), threading.Event()

    def serve() -> None:
        while not over.is_set():
            if pty.wait(0.01) and pty.read():
                pty.write(answer)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        return asked(f"rtu:{pty.path}@115200", words)
    finally:
        over.set()
        thread.join()
        pty.close()


def port_in_use(_: Path) -> Outcome:
    pty = Pty()
    first = SerialStream(pty.path, 115200)
    try:
        return asked(f"rtu:{pty.path}@115200", "another program has it open")
    finally:
        first.close()
        pty.close()


def tracker(_: Path, sent: bytes, words: str, device: str = "/dev/ttyUSB7") -> Outcome:
    near, far = pipe()
    driver = ImuDriver(ImuPort(name="imu", device=device, baud=921600, triggered_by_sync=True, rate_Hz=256.0), near)
    try:
        driver.configure(lambda _: far.write(sent))
    except DriverError as refusal:
        return refused(str(refusal), words)
    return Outcome(WRONG, "was configured")


ON_TCP: list[tuple[str, bytes, bool, str]] = [
    ("a good answer", TCP, False, ""),
    ("a connection that is closed", b"", True, "the other end closed the connection"),
    ("silence", b"", False, "no answer from unit 17 in 0.05 s; check unit_id"),
    ("a header cut off", TCP[:3], False, "an answer of 5 bytes, where its header alone has 7"),
    ("another protocol", b"\0\7" + TCP[2:], False, "protocol identifier 7, where Modbus has 0"),
    ("a length that is wrong", TCP[:3] + b"\x09" + TCP[4:], False, "which says 9"),
    ("another unit", TCP[:4] + b"\0" + TCP[5:], False, "unit 0 answers"),
]
ON_SERIAL: list[tuple[str, bytes, str]] = [
    ("a good answer", RTU, ""),
    ("a stray byte before it", b"\0" + RTU, ""),
    ("stray bytes behind it", RTU + b"\0\0", ""),
    ("silence", b"", "check unit_id, baud rate, parity and cable"),
    ("an answer cut off", RTU[:-1], "5 bytes came where 6 belong"),
    ("a damaged answer", RTU[:-1] + bytes((RTU[-1] ^ 1,)), "its check is wrong"),
    ("zeros", bytes(12), "no answer to what was asked is in what came (00 00"),
    ("another unit", rtu_frame(5, b"\x02\x01\x03"), "unit 5 answers"),
    ("text", b"login: ", "no answer to what was asked is in what came (6c 6f"),
]
TRACKERS: list[tuple[str, bytes, str]] = [
    ("silence", b"", "check power, cable and the machine file's baud = 921600"),
    ("another rate", b"\x80\x1f", "bytes came that are no Xbus message"),
    ("a tracker that does not hear", encode(0x32, bytes(40)), "messages 32h came; check the line towards the device"),
]
KIND, TOOL = "what was seen", "bytes"
INPUTS = [
    Input(f"Modbus on TCP, {name}", KIND, TOOL, partial(on_tcp, answer=one, closes=ends, words=said)) for name, one, ends, said in ON_TCP
]
INPUTS += [
    Input(f"Modbus on a serial line, {name}", KIND, TOOL, partial(on_serial, answer=one, words=said)) for name, one, said in ON_SERIAL
]
INPUTS += [Input(f"tracker, {name}", KIND, TOOL, partial(tracker, sent=one, words=said)) for name, one, said in TRACKERS]
INPUTS.append(Input("serial port of another program", KIND, TOOL, port_in_use))
