"""The I/O driver: what the loop's sample says, brakes, and one clear line for everything that goes wrong on the way."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from modbus_wiring import AXES, WIRING, ServedRtu, ServedTcp, emulated_io, io_map
from pymodbus.pdu.bit_message import ReadDiscreteInputsRequest
from pymodbus.pdu.register_message import ReadInputRegistersRequest, WriteSingleRegisterRequest
from pyModbusTCP.server import ModbusServer

from drivers.errors import BusTimeoutError, BusUnavailableError, ConfigurationRefusedError, ProtocolError
from drivers.interface import Sample
from drivers.modbus.io import IoDriver
from drivers.modbus.transport import ClientTransport, InProcessTransport, parse_io_url
from drivers.serial.stream import SerialStream
from virtual_bus.modbus.framing import rtu_frame
from virtual_bus.serial.pty import Pty

UNIT = WIRING["unit_id"]


class Bench:
    """A driver and an emulated device, in this process."""

    def __init__(self, **changes: dict[str, int] | float) -> None:
        self.device = emulated_io()
        self.asked: list[bytes] = []
        self.driver = IoDriver(io_map(**changes), InProcessTransport(self.serve), AXES)
        self.sample = Sample(2)

    def serve(self, data: bytes) -> bytes:
        self.asked.append(data)
        return self.device.serve(data)


def test_the_sample_shows_what_is_wired() -> None:
    bench = Bench()
    bench.device.set_temperature("propeller", 41.7)
    bench.device.set_temperature("roll", -3.2)
    bench.device.set_door(False)
    bench.driver.poll_due(10.0)
    bench.driver.update(bench.sample)
    assert bench.sample.temperature_degC.tolist() == [41.7, -3.2]
    assert (bench.sample.hold_to_run, bench.sample.door_closed) == (True, False)
    assert bench.sample.brakes_open.tolist() == [False, False]
    assert bench.sample.io_age_s == 0.0


def test_a_broken_thermometer_is_nan() -> None:
    bench = Bench()
    bench.device.set_temperature("roll", float("nan"))
    bench.driver.poll_due(0.0)
    bench.driver.update(bench.sample)
    assert np.isnan(bench.sample.temperature_degC).tolist() == [False, True]


def test_brakes_open_axis_by_axis_and_the_feedback_says_when() -> None:
    bench = Bench()
    bench.driver.command_brakes({"roll": True, "table": True})
    bench.driver.poll_due(0.0)
    assert bench.device.coils == [False, False, True]
    for now_s in (0.0, 0.05, 0.1):
        bench.device.advance(now_s)
        bench.driver.poll_due(now_s)
    bench.driver.update(bench.sample)
    assert bench.sample.brakes_open.tolist() == [False, True]
    bench.driver.command_brakes({"propeller": True, "roll": False})
    bench.driver.poll_due(0.1)
    assert bench.device.coils == [False, True, False]


def test_polls_come_at_their_period_and_at_once_for_a_brake() -> None:
    bench = Bench()
    for tick in range(256):
        bench.driver.poll_due(tick / 256)
    assert len(bench.asked) == 2 * 20  # every 13 ticks: 0.05 s and what is left to the next tick
    bench.driver.command_brakes({"roll": False})
    bench.driver.poll_due(1.0 - 1 / 512)
    assert len(bench.asked) == 2 * 20 + 3


def test_a_poll_is_two_requests_over_the_whole_block() -> None:
    bench = Bench()
    bench.driver.poll_due(0.0)
    assert bench.asked == [bytes.fromhex("0001 0000 0006 11 02 0003 0007"), bytes.fromhex("0002 0000 0006 11 04 0002 0004")]


def test_coils_that_are_not_the_brakes_are_never_written() -> None:
    bench = Bench(brake_coils={"propeller": 0, "roll": 2})
    bench.driver.command_brakes({"propeller": True, "roll": True})
    bench.driver.poll_due(0.0)
    assert bench.asked[:2] == [bytes.fromhex("0001 0000 0008 11 0F 0000 0001 01 01"), bytes.fromhex("0002 0000 0008 11 0F 0002 0001 01 01")]


def test_a_stale_state_reads_as_the_safe_one() -> None:
    bench = Bench(poll_period_s=100.0)
    bench.device.set_temperature("roll", 30.0)
    bench.driver.command_brakes({"roll": True})
    bench.driver.poll_due(0.0)
    bench.device.advance(0.0)
    bench.device.advance(1.0)
    bench.driver.poll_once(1.0)
    bench.driver.poll_due(1.5)
    bench.driver.update(bench.sample)
    assert bench.sample.brakes_open[1]
    assert bench.sample.hold_to_run
    assert bench.sample.io_age_s == 0.5
    bench.driver.poll_due(1.6)
    bench.driver.update(bench.sample)
    assert not (bench.sample.brakes_open.any())
    assert not (bench.sample.hold_to_run)
    assert not (bench.sample.door_closed)
    assert np.isnan(bench.sample.temperature_degC).all()
    assert bench.sample.io_age_s == pytest.approx(0.6)


def test_before_the_first_poll_nothing_is_known() -> None:
    bench = Bench()
    bench.driver.update(bench.sample)
    assert not bench.sample.hold_to_run
    assert bench.sample.io_age_s == np.inf


def test_a_wiring_that_fits_no_request_is_refused() -> None:
    with pytest.raises(ProtocolError, match=r"input registers 2 to 400 do not fit one request of 125"):
        Bench(temperature_registers={"propeller": 2, "roll": 400})


def test_an_address_the_device_does_not_have_is_refused_in_words() -> None:
    bench = Bench(hold_to_run_input=30)
    with pytest.raises(ConfigurationRefusedError, match=r"unit 17 refuses function 2 at 3 to 30: illegal data address \(2\)"):
        bench.driver.poll_due(0.0)


@pytest.mark.parametrize("answer", [b"", b"\x00", bytes.fromhex("0001 0000 0003 11 02 00"), bytes.fromhex("0001 0000 0004 11 02 01")])
def test_an_answer_that_is_none_is_a_protocol_error(answer: bytes) -> None:
    driver = IoDriver(io_map(), InProcessTransport(lambda data: answer), AXES)
    with pytest.raises(ProtocolError):
        driver.poll_once(0.0)
    driver.poll_due(0.0)
    driver.update(sample := Sample(2))
    assert (driver.malformed, sample.io_age_s) == (1, np.inf)


def test_an_answer_that_was_good_before_is_none_to_the_next_request() -> None:
    device, said = emulated_io(), []

    def repeats_itself(request: bytes) -> bytes:
        said.append(device.serve(request))
        return said[0]

    transport, request = InProcessTransport(repeats_itself), ReadDiscreteInputsRequest(**REQUEST)
    assert transport.request(request).bits[:2] == [True, True]
    with pytest.raises(ProtocolError, match="is no Modbus message"):
        transport.request(request)


def test_an_answer_that_is_shorter_than_it_says_is_none() -> None:
    transport = InProcessTransport(lambda request: request[:5] + b"\x09" + request[6:8] + b"\x01\x03")
    with pytest.raises(ProtocolError, match="is no Modbus message"):
        transport.request(ReadDiscreteInputsRequest(**REQUEST))


def test_an_answer_is_read_anew_when_it_changes_and_when_it_changes_back() -> None:
    device = emulated_io()
    transport, request, doors = InProcessTransport(device.serve), ReadDiscreteInputsRequest(**REQUEST), (True, False, True, True)
    seen = []
    for closed in doors:
        device.set_door(closed)
        seen.append(transport.request(request).bits[1])
    assert seen == list(doors)


# ---- over TCP -------------------------------------------------------------------------------------------


def test_over_tcp_against_a_server_that_is_not_ours() -> None:
    server = ModbusServer(host="127.0.0.1", port=0, no_block=True)
    server.start()
    port = server._service.socket.getsockname()[1]
    server.data_bank.set_discrete_inputs(3, [True, False, False, False, False, True, False])
    server.data_bank.set_input_registers(2, [0x10000 - 15, 0, 0, 333])
    driver = IoDriver(io_map(), transport := ClientTransport(f"tcp:127.0.0.1:{port}", 5.0), AXES)
    driver.command_brakes({"propeller": True, "roll": False})
    driver.poll_due(0.0)
    driver.update(sample := Sample(2))
    assert sample.brakes_open.tolist() == [False, True]
    assert (sample.hold_to_run, sample.door_closed) == (True, False)
    assert sample.temperature_degC.tolist() == [33.3, -1.5]
    assert server.data_bank.get_coils(0, 4) == [False, True, False, False]
    transport.close()
    server.stop()


def test_nobody_listening_is_one_clear_line() -> None:
    server = ServedTcp(emulated_io())
    server.close()
    with pytest.raises(BusUnavailableError, match=rf"io on tcp:127.0.0.1:{server.port}: cannot connect: Connection refused; check address"):
        IoDriver(io_map(), ClientTransport(server.url), AXES).poll_due(0.0)


def test_a_wrong_unit_id_on_tcp_is_the_gateways_refusal() -> None:
    server = ServedTcp(emulated_io())
    driver = IoDriver(io_map(unit_id=3), transport := ClientTransport(server.url, 5.0), AXES)
    with pytest.raises(ConfigurationRefusedError, match=r"unit 3 refuses .* gateway target failed to respond \(11\); compare unit_id"):
        driver.poll_due(0.0)
    transport.close()
    server.close()


def test_a_server_that_comes_back_is_found_again() -> None:
    device = emulated_io()
    server = ServedTcp(device)
    driver = IoDriver(io_map(), transport := ClientTransport(server.url, 5.0), AXES)
    driver.poll_once(0.0)
    transport.close()
    server.close()
    with pytest.raises(BusUnavailableError):
        driver.poll_once(1.0)
    server = ServedTcp(device, port=server.port)
    driver.poll_once(2.0)
    assert driver.state.time_s == 2.0
    transport.close()
    server.close()


# ---- over a serial line ---------------------------------------------------------------------------------


class SerialDevice:
    """Answers every request on a pseudo terminal with the same bytes."""

    def __init__(self, answer: bytes) -> None:
        self.pty = Pty()
        self.answer = answer
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def serve(self) -> None:
        while not self.stop.is_set():
            if self.pty.wait(0.01) and self.pty.read():
                self.pty.write(self.answer)

    def __enter__(self) -> ClientTransport:
        self.transport = ClientTransport(f"rtu:{self.pty.path}@115200", 0.05)
        return self.transport

    def __exit__(self, *_: object) -> None:
        self.transport.close()
        self.stop.set()
        self.thread.join()
        self.pty.close()


REQUEST = {"address": 8, "count": 2, "dev_id": UNIT}
GOOD = rtu_frame(UNIT, b"\x02\x01\x03")


def test_over_a_serial_line_the_driver_reads_and_writes() -> None:
    device = emulated_io()
    device.set_temperature("roll", 21.5)
    server = ServedRtu(device)
    driver = IoDriver(io_map(), transport := ClientTransport(f"rtu:{server.device}@115200", 5.0), AXES)
    driver.command_brakes({"roll": True})
    driver.poll_due(0.0)
    driver.update(sample := Sample(2))
    assert device.coils == [False, False, True]
    assert sample.temperature_degC.tolist() == [0.0, 21.5]
    transport.close()
    server.close()


def test_a_good_serial_answer_is_read() -> None:
    with SerialDevice(GOOD) as transport:
        assert transport.request(ReadDiscreteInputsRequest(**REQUEST)).bits[:2] == [True, True]


@pytest.mark.parametrize(
    ("answer", "error", "words"),
    [
        (b"", BusTimeoutError, r"no answer from unit 17 in 0.05 s; check unit_id, baud rate, parity and cable"),
        (GOOD[:-1] + bytes((GOOD[-1] ^ 1,)), ProtocolError, r"a damaged answer, its check is wrong \(11 02 01 03 .*\); check wiring"),
        (rtu_frame(5, b"\x02\x01\x03"), ProtocolError, r"unit 5 answers where unit_id = 17 was asked"),
        (rtu_frame(UNIT, b"\x82\x06"), ConfigurationRefusedError, r"refuses function 2 at 8 to 9: server device busy \(6\)"),
        (rtu_frame(UNIT, b"\x82\x55"), ConfigurationRefusedError, r"unknown exception \(85\)"),
        (rtu_frame(UNIT, b"\x82\x05"), ConfigurationRefusedError, r"acknowledge \(5\); it has begun"),
        (b"\x05" + GOOD[:-1], ProtocolError, r"no answer to what was asked is in what came \(05 11 02 .*\); check wiring"),
        (GOOD[:-1], ProtocolError, r"an answer of which 5 bytes came where 6 belong \(11 02 01 03 .*\); check wiring"),
        (GOOD[:3], ProtocolError, r"an answer of which 3 bytes came \(11 02 01\); check wiring"),
        (bytes(12), ProtocolError, r"no answer to what was asked is in what came \(00 00 00"),
        (b"\x00" * 20 + GOOD, ProtocolError, r"no answer to what was asked is in what came \(00 00 00"),
    ],
)
def test_bad_serial_answers_are_told_apart(
    answer: bytes, error: type[BusTimeoutError] | type[ConfigurationRefusedError] | type[ProtocolError], words: str
) -> None:
    with SerialDevice(answer) as transport, pytest.raises(error, match=words):
        transport.request(ReadDiscreteInputsRequest(**REQUEST))


class TcpDevice:
    """Answers every request of a connection with the same bytes behind its transaction, then closes it if it is told to."""

    def __init__(self, answer: bytes, *, closes: bool = False) -> None:
        self.answer, self.closes = answer, closes
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self.listener.accept()
                with connection:
                    while request := connection.recv(64):
                        connection.sendall(request[:2] + self.answer if self.answer else b"")
                        if self.closes:
                            break

    def __enter__(self) -> ClientTransport:
        self.transport = ClientTransport(f"tcp:127.0.0.1:{self.listener.getsockname()[1]}", 0.05)
        return self.transport

    def __exit__(self, *_: object) -> None:
        self.transport.close()
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        self.thread.join()


ON_TCP = b"\0\0\0\4\x11\2\1\3"


def test_a_good_answer_on_tcp_is_read() -> None:
    with TcpDevice(ON_TCP) as transport:
        assert transport.request(ReadDiscreteInputsRequest(**REQUEST)).bits[:2] == [True, True]


@pytest.mark.parametrize(
    ("answer", "closes", "words"),
    [
        (b"", True, r"the other end closed the connection before an answer from unit 17 had come$"),
        (b"", False, r"no answer from unit 17 in 0.05 s; check unit_id$"),
        (b"\0\0\0", False, r"an answer of 5 bytes, where its header alone has 7 \(.*\)$"),
        (b"\0\7" + ON_TCP[2:], False, r"an answer with protocol identifier 7, where Modbus has 0 \(.*\)$"),
        (ON_TCP[:3] + b"\x09" + ON_TCP[4:], False, r"an answer of 4 bytes behind its length, which says 9 \(.*\)$"),
        (ON_TCP[:4] + b"\x00" + ON_TCP[5:], False, r"unit 0 answers where unit_id = 17 was asked$"),
    ],
)
def test_what_is_seen_on_tcp_is_named_and_no_serial_line_is_blamed(answer: bytes, closes: bool, words: str) -> None:
    with TcpDevice(answer, closes=closes) as transport, pytest.raises((BusUnavailableError, BusTimeoutError, ProtocolError), match=words):
        transport.request(ReadDiscreteInputsRequest(**REQUEST))


def test_a_serial_line_that_is_gone_is_no_silent_device(tmp_path: Path) -> None:
    pty, line = Pty(), tmp_path / "ttyUSB0"
    line.symlink_to(pty.path)  # the terminal's own name may be another's at once
    transport = ClientTransport(f"rtu:{line}@115200", 0.05)
    with pytest.raises(BusTimeoutError, match="no answer from unit 17"):
        transport.request(ReadDiscreteInputsRequest(**REQUEST))
    line.unlink()
    pty.close()
    with pytest.raises(BusUnavailableError, match=r"before an answer from unit 17 had come|cannot connect: No such file"):
        transport.request(ReadDiscreteInputsRequest(**REQUEST))
    transport.close()


def test_a_serial_line_of_another_program_is_named_as_such() -> None:
    pty = Pty()
    first = SerialStream(pty.path, 115200)
    transport = ClientTransport(f"rtu:{pty.path}@115200", 0.05)
    with pytest.raises(BusUnavailableError, match=r"cannot connect: another program has it open; end that program$"):
        transport.request(ReadDiscreteInputsRequest(**REQUEST))
    first.close()
    pty.close()


@pytest.mark.parametrize("stray", [b"\x00", b"\xff", b"\x00\x00\xfe", b"\x11", b"\x11\x02"])
@pytest.mark.parametrize("behind", [b"", b"\x00"])
def test_stray_bytes_around_an_answer_are_passed_over(stray: bytes, behind: bytes) -> None:
    with SerialDevice(stray + GOOD + behind) as transport:
        for _ in range(3):
            assert transport.request(ReadDiscreteInputsRequest(**REQUEST)).bits[:2] == [True, True]


class LateDevice(SerialDevice):
    """A device that answers the first try only when the second comes, and the second a little later; its inputs count the tries."""

    def serve(self) -> None:
        tries = 0
        while not self.stop.is_set():
            if self.pty.wait(0.01) and self.pty.read():
                tries += 1
                for number in (1, 2) if tries == 2 else range(tries, tries + (tries > 2)):
                    self.pty.write(rtu_frame(UNIT, bytes((2, 1, number))))
                    self.stop.wait(0.02)


def test_a_late_answer_is_not_taken_for_that_to_the_next_request() -> None:
    with LateDevice(b"") as transport:
        answers = [transport.request(ReadDiscreteInputsRequest(**REQUEST)).bits[:4] for _ in range(3)]
    numbers = [sum(bit << place for place, bit in enumerate(bits)) for bits in answers]
    assert numbers == [1, 3, 4]


class LosesOne(SerialDevice):
    """A device to whose first request the answer comes only after the second, which has another function."""

    def serve(self) -> None:
        late = b""
        while not self.stop.is_set():
            if self.pty.wait(0.01) and (request := self.pty.read()):
                answer = rtu_frame(UNIT, b"\x02\x01\x01") if request[1] == 2 else rtu_frame(UNIT, b"\x04\x02\x00\x07")
                if not late and request[1] == 2:
                    late = answer
                else:
                    self.pty.write((late if request[1] == 4 else b"") + answer)


def test_a_late_answer_to_another_function_is_passed_over() -> None:
    with LosesOne(b"") as transport:
        assert transport.request(ReadDiscreteInputsRequest(**REQUEST)).bits[0]
        assert transport.request(ReadInputRegistersRequest(address=0, count=1, dev_id=UNIT)).registers == [7]


class EchoingLine(SerialDevice):
    """A device behind an adapter that hands back what was sent, before the answer of the device, if that lives."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        self.of = answer
        super().__init__(b"")

    def serve(self) -> None:
        while not self.stop.is_set():
            if self.pty.wait(0.01) and (request := self.pty.read()):
                self.pty.write(request + self.of(request))


def test_an_adapter_that_echoes_is_recognised_and_its_echo_is_no_answer() -> None:
    """The answer to a write of one register equals the request: of a dead device, only the echo comes."""
    alive = [True]
    with EchoingLine(lambda request: (GOOD if request[1] == 2 else request) if alive[0] else b"") as transport:
        read, write = ReadDiscreteInputsRequest(**REQUEST), WriteSingleRegisterRequest(address=1, registers=[7], dev_id=UNIT)
        assert transport.request(read).bits[:2] == [True, True]
        assert transport.request(write).registers == [7]
        alive[0] = False
        for request in (write, read):
            with pytest.raises(BusTimeoutError, match="no answer from unit 17"):
                transport.request(request)


def test_a_serial_port_that_does_not_exist_is_named() -> None:
    with pytest.raises(BusUnavailableError, match=r"rtu:/dev/no_such_port@9600: cannot connect: No such file or directory"):
        ClientTransport("rtu:/dev/no_such_port@9600").request(ReadDiscreteInputsRequest(**REQUEST))


def test_faults_are_not_also_printed(capfd: pytest.CaptureFixture[str]) -> None:
    # Without a handler of its own the library's log would end on standard error
    assert logging.getLogger("pymodbus").handlers
    with pytest.raises(BusUnavailableError):
        ClientTransport("rtu:/dev/no_such_port@9600").request(ReadDiscreteInputsRequest(**REQUEST))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("url", "parsed"),
    [
        ("tcp:127.0.0.1:502", ("tcp", "127.0.0.1", 502, "")),
        ("tcp:io.lab:1502", ("tcp", "io.lab", 1502, "")),
        ("tcp:[::1]:502", ("tcp", "::1", 502, "")),
        ("rtu:/dev/ttyUSB1@115200", ("rtu", "/dev/ttyUSB1", 115200, "8E1")),  # the default of the serial line's standard
        ("rtu:/dev/ttyUSB1@19200,8N2", ("rtu", "/dev/ttyUSB1", 19200, "8N2")),
        ("rtu:COM4@9600,8O1", ("rtu", "COM4", 9600, "8O1")),
    ],
)
def test_urls(url: str, parsed: tuple[str, str, int]) -> None:
    assert parse_io_url(url) == parsed


@pytest.mark.parametrize(
    "url",
    [
        "",
        "tcp:",
        "tcp:host",
        "tcp:host:0",
        "tcp:host:70000",
        "rtu:/dev/ttyUSB1",
        "rtu:/dev/x@0",
        "rtu:/dev/x@9600,7E1",
        "rtu:/dev/x@9600,8E",
        "http://x:1",
        "udp:x:1",
    ],
)
def test_urls_that_are_none_say_how_they_read(url: str) -> None:
    with pytest.raises(BusUnavailableError, match=r"reads tcp:HOST:PORT or rtu:DEVICE@BAUD"):
        parse_io_url(url)
