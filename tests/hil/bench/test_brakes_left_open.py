"""A run whose brakes could not be closed on the way out says so, however well everything else went."""

from __future__ import annotations

import dataclasses

import pytest
from bench_machines import CARM

from drivers.errors import BusError
from hil.bench.options import BenchOptions
from hil.bench.signals import StopRequest
from hil.bench.wiring import wall_wiring

BUS = "udp:239.74.163.62"
TROUBLE = "io on tcp:127.0.0.1:502: no answer; the brakes may be open"
WITHOUT_IMU = dataclasses.replace(CARM, bus=dataclasses.replace(CARM.bus, imu=None))


@dataclasses.dataclass
class SilentAtTheEnd:
    """An I/O process whose device does not answer any more when the brakes are to be closed."""

    io_map: object
    axes: tuple[str, ...]
    refresh_from: str
    trouble: str = ""
    memory_name: str = ""

    def start(self) -> None: ...

    def close(self) -> None:
        self.trouble = TROUBLE


@pytest.fixture
def options(monkeypatch: pytest.MonkeyPatch) -> BenchOptions:
    monkeypatch.setattr("hil.bench.wiring.IoProcess", SilentAtTheEnd)
    return BenchOptions(BUS, io_url="tcp:127.0.0.1:502")


def test_it_is_the_error_of_a_run_that_has_none(options: BenchOptions) -> None:
    with pytest.raises(BusError, match=f"^{TROUBLE}$"), wall_wiring(WITHOUT_IMU, options, StopRequest()):
        pass


def test_it_is_a_note_to_the_error_there_is(options: BenchOptions) -> None:
    with pytest.raises(KeyError) as caught, wall_wiring(WITHOUT_IMU, options, StopRequest()):
        raise KeyError("row")
    assert caught.value.__notes__ == [TROUBLE]
