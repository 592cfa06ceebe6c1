"""The emulated I/O device, asked by Modbus clients that are not ours, and by bytes from the specification."""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Iterator

import minimalmodbus
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from minimalmodbus import Instrument
from modbus_wiring import AXES, WIRING, ServedRtu, ServedTcp, emulated_io
from pyModbusTCP.client import ModbusClient

from drivers.errors import ProtocolError
from drivers.modbus.registers import register_to_temperature, temperature_to_register
from virtual_bus.errors import EmulatorError
from virtual_bus.modbus.framing import TcpFraming, crc16, rtu_frame, rtu_request, tcp_frame
from virtual_bus.modbus.io_device import EmulatedIo

UNIT = WIRING["unit_id"]


@pytest.fixture
def tcp() -> Iterator[tuple[EmulatedIo, ModbusClient]]:
    """A device on TCP and pyModbusTCP's client to it."""
    device = emulated_io()
    server = ServedTcp(device)
    client = ModbusClient(host=server.host, port=server.port, unit_id=UNIT, timeout=5.0)
    yield device, client
    client.close()
    server.close()


@pytest.fixture
def rtu() -> Iterator[tuple[EmulatedIo, Instrument]]:
    """A device on a pseudo terminal and minimalmodbus's instrument on it."""
    device = emulated_io()
    server = ServedRtu(device)
    instrument = minimalmodbus.Instrument(server.device, UNIT)
    instrument.serial.baudrate = 115200
    instrument.serial.timeout = 5.0
    yield device, instrument
    instrument.serial.close()
    server.close()


def test_pymodbustcp_reads_inputs_and_temperatures(tcp: tuple[EmulatedIo, ModbusClient]) -> None:
    device, client = tcp
    device.set_hold_to_run(False)
    device.set_temperature("propeller", 24.3)
    device.set_temperature("roll", -5.1)
    assert client.read_discrete_inputs(8, 2) == [False, True]
    assert client.read_discrete_inputs(0, 10) == [False] * 9 + [True]  # two bytes, the first eight inputs in the first
    assert client.read_input_registers(0, 6) == [0, 0, 0x10000 - 51, 0, 0, 243]


def test_pymodbustcp_writes_coils_and_sees_the_feedback(tcp: tuple[EmulatedIo, ModbusClient]) -> None:
    device, client = tcp
    assert client.write_single_coil(2, True)
    assert client.read_coils(0, 3) == [False, False, True]
    device.advance(1.0)
    assert client.read_discrete_inputs(3, 2) == [False, False]
    device.advance(1.0 + 0.03)  # spring-applied brakes open in 30 to 60 ms
    assert client.read_discrete_inputs(3, 2) == [False, False]
    device.advance(1.0 + 0.06)
    assert client.read_discrete_inputs(3, 2) == [True, False]
    assert client.write_multiple_coils(1, [True, False])
    assert device.coils == [False, True, False]


def test_minimalmodbus_reads_inputs_and_temperatures(rtu: tuple[EmulatedIo, Instrument]) -> None:
    device, instrument = rtu
    device.set_door(False)
    device.set_temperature("roll", -5.1)
    assert instrument.read_bits(8, 2) == [1, 0]
    assert instrument.read_register(2, number_of_decimals=1, functioncode=4, signed=True) == -5.1
    assert instrument.read_registers(0, 6, functioncode=4) == [0, 0, 0x10000 - 51, 0, 0, 0]


def test_minimalmodbus_writes_coils(rtu: tuple[EmulatedIo, Instrument]) -> None:
    device, instrument = rtu
    instrument.write_bit(1, 1)
    instrument.write_bits(0, [0, 1, 1])
    assert instrument.read_bits(0, 3, functioncode=1) == [0, 1, 1]
    assert device.coils == [False, True, True]


def test_minimalmodbus_gets_exceptions_and_the_line_lives_on(rtu: tuple[EmulatedIo, Instrument]) -> None:
    _, instrument = rtu
    instrument.serial.timeout = 0.3  # it always waits for the length of a good answer
    with pytest.raises(minimalmodbus.IllegalRequestError, match="illegal data address"):
        instrument.read_bit(10)
    with pytest.raises(minimalmodbus.IllegalRequestError, match="illegal function"):
        instrument.read_register(0, functioncode=3)
    assert instrument.read_bit(9) == 1


def test_a_foreign_or_damaged_frame_on_the_serial_line_is_not_answered(rtu: tuple[EmulatedIo, Instrument]) -> None:
    device, instrument = rtu
    instrument.serial.timeout = 0.05
    instrument.address = UNIT + 1
    with pytest.raises(minimalmodbus.NoResponseError):
        instrument.read_bit(9)
    assert device.serve_rtu(rtu_frame(UNIT, b"\x02\x00\x09\x00\x01")[:-1] + b"\x00") == b""


def test_a_broadcast_is_obeyed_in_silence() -> None:
    device = emulated_io()
    assert device.serve_rtu(rtu_frame(0, b"\x05\x00\x01\xff\x00")) == b""
    assert device.coils[1]


@pytest.mark.parametrize(
    ("pdu", "answer"),
    [
        # Modbus Application Protocol V1.1b3, sec. 6: what is asked and what a device answers
        ("02 0008 0002", "02 01 03"),
        ("01 0000 0003", "01 01 00"),
        ("04 0005 0001", "04 02 0000"),
        ("05 0001 FF00", "05 0001 FF00"),
        ("05 0001 0000", "05 0001 0000"),
        ("0F 0001 0002 01 03", "0F 0001 0002"),
        ("03 0000 0001", "83 01"),  # no holding registers
        ("2B 0E 01 00", "AB 01"),
        ("02 0000 0000", "82 03"),  # count 0
        ("02 0000 07D1", "82 03"),  # count 2001
        ("04 0000 007E", "84 03"),  # count 126
        ("02 0009 0002", "82 02"),
        ("02 FFFF 0001", "82 02"),
        ("04 0006 0001", "84 02"),
        ("05 0003 FF00", "85 02"),
        ("05 0001 1234", "85 03"),
        ("05 0001", "85 03"),
        ("0F 0001 0003 01 07", "8F 02"),
        ("0F 0001 0002 02 0300", "8F 03"),  # byte count against count
        ("0F 0001 0002 01", "8F 03"),
        ("0F 0001 0000 00", "8F 03"),
        ("02 0000", "82 03"),
    ],
)
def test_requests_are_answered_as_the_specification_says(pdu: str, answer: str) -> None:
    assert emulated_io().serve_pdu(bytes.fromhex(pdu)) == bytes.fromhex(answer)


@given(st.binary(min_size=1, max_size=253))
def test_no_request_makes_the_device_fail(pdu: bytes) -> None:
    device = emulated_io()
    answer = device.serve_pdu(pdu)
    assert answer[0] & 0x7F == pdu[0] & 0x7F
    assert len(device.coils) == 3


def test_on_tcp_another_unit_gets_the_gateways_answer(tcp: tuple[EmulatedIo, ModbusClient]) -> None:
    _, client = tcp
    client.unit_id = UNIT + 1
    assert client.read_coils(0) is None
    assert client.last_except == 0x0B
    client.unit_id = 255
    assert client.read_coils(0) == [False]


def test_a_client_that_speaks_something_else_is_hung_up_on_and_others_are_not(tcp: tuple[EmulatedIo, ModbusClient]) -> None:
    _, client = tcp
    assert client.read_coils(0) == [False]
    with socket.create_connection((client.host, client.port), 5.0) as line:
        line.sendall(b"GET / HTTP/1.1\r\n\r\n")
        assert line.recv(100) == b""
    assert client.read_coils(0) == [False]


def test_a_port_in_use_is_one_clear_line() -> None:
    server = ServedTcp(emulated_io())
    with pytest.raises(EmulatorError, match=rf"127.0.0.1:{server.port}: Address already in use; give another port"):
        ServedTcp(emulated_io(), port=server.port)
    server.close()


requests = st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 255), st.binary(min_size=1, max_size=253)), max_size=5)


@given(requests, st.lists(st.integers(1, 50), max_size=30))
def test_split_and_merged_tcp_segments_hold_the_same_requests(sent: list[tuple[int, int, bytes]], cuts: list[int]) -> None:
    stream = b"".join(tcp_frame(*request) for request in sent)
    framing = TcpFraming()
    received, start = [], 0
    for cut in [*cuts, len(stream)]:
        received += framing.feed(stream[start : start + cut])
        start += cut
    assert received == sent
    assert not framing.broken


@given(st.binary(max_size=60))
def test_no_bytes_make_the_tcp_framing_fail(data: bytes) -> None:
    for request in TcpFraming().feed(data):
        assert 1 <= len(request.pdu) <= 253


def test_the_serial_check_is_the_documented_one() -> None:
    # Modbus over Serial Line V1.02, sec. 6.2.2 (example: 02 07 -> 0x1241, sent low byte first), and the usual check value of CRC-16/MODBUS
    assert crc16(b"\x02\x07") == 0x1241
    assert crc16(b"123456789") == 0x4B37
    assert rtu_frame(2, b"\x07") == bytes.fromhex("02074112")


@given(st.integers(0, 255), st.binary(min_size=1, max_size=250), st.data())
def test_serial_frames_survive_and_damage_is_noticed(unit_id: int, pdu: bytes, data: st.DataObject) -> None:
    frame = rtu_frame(unit_id, pdu)
    assert rtu_request(frame) == (unit_id, pdu)
    damaged = bytearray(frame)
    damaged[data.draw(st.integers(0, len(frame) - 1))] ^= data.draw(st.integers(1, 255))
    assert rtu_request(bytes(damaged)) is None


@given(st.floats(-3276.7, 3276.7))
def test_temperatures_survive_within_half_a_step(temperature_degC: float) -> None:
    assert register_to_temperature(temperature_to_register(temperature_degC)) == pytest.approx(temperature_degC, abs=0.0501)


@given(st.integers(0, 0xFFFF))
def test_registers_are_signed_tenths(register: int) -> None:
    temperature_degC = register_to_temperature(register)
    if register == 0x8000:  # the sensor is broken or not connected
        assert math.isnan(temperature_degC)
    else:
        assert temperature_degC == struct.unpack(">h", register.to_bytes(2, "big"))[0] / 10
    assert temperature_to_register(temperature_degC) == register


@pytest.mark.parametrize("temperature_degC", [3277.0, -3277.0, math.inf])
def test_a_temperature_that_fits_no_register_is_refused(temperature_degC: float) -> None:
    with pytest.raises(ProtocolError, match="does not fit"):
        temperature_to_register(temperature_degC)


def test_brakes_follow_their_coils_after_the_delay_and_say_so() -> None:
    heard = []
    device = emulated_io(on_brakes=lambda closed: heard.append(closed.tolist()), brake_delay_s=0.04)
    device.serve_pdu(bytes.fromhex("0F 0001 0002 01 03"))
    for tick in range(20):
        device.advance(tick / 256)
        assert device.brakes_closed.tolist() == ([True, True] if tick / 256 < 0.04 else [False, False])
    device.serve_pdu(bytes.fromhex("05 0002 0000"))
    device.advance(1.0)
    device.advance(1.04)
    assert heard == [[False, False], [False, True]]
    assert device.discrete_inputs[3:5] == [False, True]  # roll, propeller


def test_a_coil_that_changes_its_mind_in_time_moves_no_brake() -> None:
    device = emulated_io(brake_delay_s=0.04)
    device.serve_pdu(bytes.fromhex("05 0001 FF00"))
    device.advance(0.0)
    device.serve_pdu(bytes.fromhex("05 0001 0000"))
    device.advance(0.02)
    device.serve_pdu(bytes.fromhex("05 0001 FF00"))
    device.advance(0.05)
    assert device.brakes_closed.all()
    device.advance(0.0901)
    assert np.array_equal(device.brakes_closed, [False, True])


def test_an_axis_without_wiring_is_left_alone() -> None:
    device = emulated_io()
    device.set_temperature("table", 30.0)
    assert device.input_registers == [0] * 6
    assert device.axes == AXES
