"""The polling process: the loop never waits for the I/O device, and brakes close when the loop dies."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from modbus_wiring import AXES, emulated_io, eventually, io_map

from drivers.errors import BusUnavailable, ConfigurationRefused
from drivers.interface import Sample
from drivers.modbus.io_process import IoProcess
from virtual_bus.modbus.servers import ModbusTcpServer

ROOT = Path(__file__).parents[2]


@pytest.fixture
def served():
    """A device on TCP."""
    device = emulated_io()
    server = ModbusTcpServer(device)
    yield device, server
    server.close()


def test_state_and_brake_commands_pass_and_closing_closes_the_brakes(served):
    device, server = served
    device.set_temperature("roll", 36.6)
    device.set_door(False)
    process = IoProcess(io_map(server.url, poll_period_s=0.01, stale_after_s=60.0), AXES)
    process.start()
    sample = Sample(2)
    process.update(sample)
    assert sample.temperature_degC.tolist() == [0.0, 36.6]
    assert (sample.hold_to_run, sample.door_closed) == (True, False)
    assert 0.0 <= sample.io_age_s < 60.0

    process.command_brakes({"roll": True})
    assert eventually(lambda: device.coils == [False, False, True])
    device.advance(0.0)
    device.advance(1.0)

    def roll_reads_open():
        process.update(sample)
        return sample.brakes_open.tolist() == [False, True]

    assert eventually(roll_reads_open)
    process.close()
    assert device.coils == [False, False, False]
    process.close()  # any number of times


def test_a_device_that_cannot_be_reached_fails_the_start_with_its_reason():
    server = ModbusTcpServer(emulated_io())
    server.close()
    process = IoProcess(io_map(server.url), AXES)
    with pytest.raises(BusUnavailable, match=rf"^io on tcp:127.0.0.1:{server.port}: cannot connect: Connection refused"):
        process.start()


def test_a_device_that_refuses_fails_the_start_with_its_words(served):
    _, server = served
    with pytest.raises(ConfigurationRefused, match="illegal data address"):
        IoProcess(io_map(server.url, door_input=99), AXES).start()


def test_a_lost_device_goes_stale_and_comes_back_with_brakes_closed(served):
    device, server = served
    process = IoProcess(io_map(server.url, poll_period_s=0.01, stale_after_s=0.1), AXES)
    process.start()
    process.command_brakes({"roll": True})
    assert eventually(lambda: device.coils[2])
    reachable = device.serve_tcp
    device.serve_tcp = lambda framing, data: b""  # the cable is pulled: requests vanish
    sample = Sample(2)

    def stale():
        process.update(sample)
        return sample.io_age_s > 0.1

    assert eventually(stale)
    assert not sample.hold_to_run and np.isnan(sample.temperature_degC).all()
    assert eventually(lambda: "no answer from unit 17" in process.error)
    device.serve_tcp = reachable
    assert eventually(lambda: device.coils == [False, False, False])  # open before, nobody knows what happened since: closed

    def fresh():
        process.update(sample)
        return sample.io_age_s < 0.1 and sample.hold_to_run

    assert eventually(fresh)
    process.command_brakes({"roll": True})
    assert eventually(lambda: device.coils[2])
    process.close()


LOOP = """
    import sys
    sys.path.insert(0, {folder!r})
    from modbus_wiring import AXES, io_map
    from drivers.modbus.io_process import IoProcess

    if __name__ == "__main__":
        process = IoProcess(io_map({url!r}, poll_period_s=0.01, stale_after_s=60.0), AXES)
        process.start()
        process.command_brakes({{"propeller": True, "roll": True}})
        print("running", flush=True)
        sys.stdin.read()
"""


@pytest.mark.parametrize("kill", ["SIGKILL", "SIGTERM", "exit"])
def test_when_the_loops_process_dies_the_brakes_close(served, tmp_path, kill):
    device, server = served
    script = tmp_path / "loop.py"
    script.write_text(textwrap.dedent(LOOP.format(folder=str(Path(__file__).parent), url=server.url)))
    loop = subprocess.Popen(
        [sys.executable, str(script)], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert loop.stdout.readline() == "running\n"
    assert eventually(lambda: device.coils == [False, True, True])
    if kill == "exit":
        loop.stdin.close()
    else:
        os.kill(loop.pid, getattr(signal, kill))
    loop.wait()
    assert eventually(lambda: device.coils == [False, False, False])
    loop.stdout.close()
    if not loop.stdin.closed:
        loop.stdin.close()
