"""`isocenter emulate` from outside: what it says when it is ready, its ports asked by other people's clients, and how it ends."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import can
import minimalmodbus
import pytest
from device_wires import DRIVE_EDS
from pyModbusTCP.client import ModbusClient

from drivers.modbus.refresh import following_word
from virtual_bus.canopen.bare import BareMachine
from virtual_bus.emulator import run_device
from virtual_bus.errors import BusLostError

pytestmark = pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo terminals here")
EMULATE = [sys.executable, "-m", "hil", "emulate"]
TIMEOUT_S = 120.0
HOLD_TO_RUN, DOOR = 8, 9  # wired so in carm.toml


def emulating(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen([*EMULATE, *arguments, "--no-real-time"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture(scope="module")
def carm() -> Iterator[dict[str, str]]:
    """The C-arm emulated with its I/O on TCP and on a pseudo terminal; its ready line."""
    process = emulating("carm", "--bus", "virtual:emulate-command", "--io-rtu", "pty", "--json", "-")
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line, process.communicate()[1]
    yield json.loads(line)
    process.terminate()
    rest, errors = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, rest) == (0, ""), errors


@pytest.mark.slow
def test_minimalmodbus_reads_and_works_the_io_on_its_serial_line(carm: dict[str, str]) -> None:
    device, _, baud = carm["io_rtu"].removeprefix("rtu:").rpartition("@")
    instrument = minimalmodbus.Instrument(device, 1)
    instrument.serial.baudrate = int(baud)
    instrument.serial.timeout = TIMEOUT_S
    assert instrument.read_bits(HOLD_TO_RUN, 2, functioncode=2) == [1, 1]
    assert 15.0 < instrument.read_register(1, 1, functioncode=4, signed=True) < 35.0, "a winding as warm as a room"
    assert instrument.read_bit(1, functioncode=2) == 0
    while not instrument.read_bit(1, functioncode=2):  # the brake opens in the machine's own time, while its watchdog is refreshed
        instrument.write_register(0, following_word(instrument.read_register(0)), functioncode=6)
        instrument.write_bit(1, 1)
    while instrument.read_bit(1, functioncode=2):  # and closes by itself without
        pass
    instrument.serial.close()


def test_the_same_io_answers_on_tcp(carm: dict[str, str]) -> None:
    host, port = carm["io"].removeprefix("tcp:").split(":")
    client = ModbusClient(host=host, port=int(port), unit_id=1, timeout=TIMEOUT_S)
    assert client.read_discrete_inputs(HOLD_TO_RUN, 2) == [True, True]
    client.close()


def test_the_imu_listens_where_the_ready_line_says(carm: dict[str, str]) -> None:
    scheme, host, port = carm["imu_tcp"].split(":")
    assert scheme == "tcp"
    assert os.path.exists(carm["imu"])
    with socket.create_connection((host, int(port)), TIMEOUT_S) as line:
        line.sendall(bytes.fromhex("fa ff 30 00 d1"))  # Xbus: GoToConfig, answered by GoToConfigAck
        heard, file = b"", line.makefile("rb")
        while not heard.endswith(bytes.fromhex("fa ff 31 00 d0")):  # measurements that were under way come before it
            heard += file.read(1)
            assert len(heard) < 1000


@pytest.mark.slow
def test_without_json_it_says_in_words_that_it_is_ready(tmp_path: Path) -> None:
    process = emulating("--eds", str(DRIVE_EDS), "--node", "5", "--bus", "virtual:words", "--json", str(tmp_path / "ready.json"))
    assert process.stdout is not None
    line = process.stdout.readline()
    process.terminate()
    _, errors = process.communicate(timeout=TIMEOUT_S)
    assert line == f"ready: {DRIVE_EDS} on virtual:words, node 5; Ctrl-C ends it\n", errors
    assert json.loads((tmp_path / "ready.json").read_text()) == {"ready": str(DRIVE_EDS), "bus": "virtual:words", "node": 5}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("ttyUSB1", "--io-rtu ttyUSB1: write pty, or DEVICE@BAUD, for example /dev/ttyUSB1@115200"),
        ("/dev/isocenter-none@9600", "serial port /dev/isocenter-none at 9600 baud: No such file or directory"),
    ],
)
def test_a_serial_port_that_is_none_is_one_line(port: str, words: str) -> None:
    process = emulating("carm", "--bus", "virtual:none", "--io-rtu", port)
    said, errors = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, said) == (2, "")
    assert errors.startswith(f"isocenter: {words}")
    assert errors.count("\n") == 1


@pytest.mark.slow
def test_a_bus_that_is_lost_ends_the_emulator_with_one_line() -> None:
    class Unplugged(can.BusABC):
        def __init__(self) -> None:
            super().__init__("can0")
            self.channel_info = "socketcan channel 'can0'"

        def send(self, msg: can.Message, timeout: float | None = None) -> None: ...

        def recv(self, timeout: float | None = None) -> can.Message | None:
            raise can.CanOperationError("Network is down", 100)

    bus = Unplugged()
    with pytest.raises(
        BusLostError, match=r"^socketcan channel 'can0': the bus is gone: Network is down .*; the emulated devices are off$"
    ) as lost:
        run_device(bus, BareMachine(DRIVE_EDS, 5), lambda: None)
    bus.shutdown()
    assert lost.value.exit_status == 1
