"""Two benches on one bus would move the same motors: the second is refused before it touches anything of the machine's."""

from __future__ import annotations

import contextlib
import os
import select
import socket
from collections.abc import Iterator
from typing import ClassVar

import can
import pytest
from bench_machines import CARM

from drivers.errors import DuplicateNodeError
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions

termios = pytest.importorskip("termios", reason="the IMU is on a pseudo-terminal")
CHANNEL = "second bench"


@pytest.fixture
def running_bench() -> Iterator[can.BusABC]:
    """Somebody whose heartbeat is a bench's, and who hears what the other sends."""
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        beat = can.Message(arbitration_id=0x700 + CARM.bus.master_node_id, is_extended_id=False, data=[5])
        task = bus.send_periodic(beat, CARM.bus.master_heartbeat_period_s / 2)
        yield bus
        task.stop()


class Watching:
    """An observer that notes when its estimates are put where the first bench's are."""

    channels: ClassVar[list[tuple[str, str]]] = []

    def __init__(self, touched: list[str]) -> None:
        self._touched = touched

    def shown(self, bus_url: str) -> contextlib.AbstractContextManager[None]:
        self._touched.append(f"estimates of {bus_url}")
        return contextlib.nullcontext()


def test_it_neither_polls_the_io_nor_opens_the_imu_nor_sends_a_frame_nor_shows_an_estimate(running_bench: can.BusABC) -> None:
    touched: list[str] = []
    io, (imu, far_end) = socket.create_server(("127.0.0.1", 0)), os.openpty()
    settings = termios.tcgetattr(imu)
    url = f"tcp:127.0.0.1:{io.getsockname()[1]}"
    options = BenchOptions(f"virtual:{CHANNEL}", imu_device=os.ttyname(far_end), io_url=url, real_time=False)
    with (
        pytest.raises(DuplicateNodeError, match=r"node id 127, the bench's own, is already on .*another bench is running there"),
        open_bench(CARM, options, observer=Watching(touched)),
    ):
        pass
    assert touched == []
    assert running_bench.recv(0.0) is None
    assert not select.select([io, imu], [], [], 0.0)[0], "nobody has called the I/O, nothing was sent to the IMU"
    assert termios.tcgetattr(imu) == settings, "nobody has set the IMU's line"
    io.close()
    os.close(imu)
    os.close(far_end)
