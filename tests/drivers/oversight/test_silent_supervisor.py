"""A supervisor that does not answer stops the loop, unless the loop was away itself."""

from __future__ import annotations

import contextlib

import pytest
from bench_machines import CARM

from drivers.oversight import process
from drivers.oversight.process import SILENT_S, SupervisorProcess

assert CARM.bus is not None
PERIOD_S = CARM.bus.sync_period_s


class Clock:
    now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


def test_a_supervisor_that_makes_no_round_is_found_in_a_quarter_of_a_second_of_the_loop_s(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(process.time, "monotonic", clock.monotonic)
    assert CARM.bus is not None
    with contextlib.closing(SupervisorProcess(CARM.bus, "udp:")) as supervisor:
        supervisor.begin()
        clock.now_s += 5.0  # the computer stood still, and the supervisor with it
        assert supervisor.trouble() == ""
        looks = 0
        while not supervisor.trouble():
            clock.now_s += PERIOD_S
            looks += 1
            assert looks < 100
        assert looks * PERIOD_S == pytest.approx(SILENT_S, abs=3 * PERIOD_S)
        supervisor.begin()
        assert supervisor.trouble() == ""
