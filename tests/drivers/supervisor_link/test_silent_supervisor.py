"""A supervisor that does not answer stops the loop, unless the loop was away itself."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import pytest
from bench_machines import CARM

from drivers.settings import IoWatchdog
from drivers.supervisor_link import process
from drivers.supervisor_link.process import SILENT_S, SupervisorProcess

assert CARM.bus is not None
PERIOD_S = CARM.bus.sync_period_s


class Clock:
    now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.mark.parametrize(("watchdog_s", "silent_s"), [(None, SILENT_S), (0.5, 0.25), (1.0, 0.5)])
def test_a_supervisor_that_makes_no_round_is_found_in_ticks_of_the_loop(
    watchdog_s: float | None, silent_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(process.time, "monotonic", clock.monotonic)
    assert CARM.bus is not None
    assert CARM.bus.io is not None
    watchdog = None if watchdog_s is None else IoWatchdog(0, watchdog_s)
    settings = replace(CARM.bus, io=replace(CARM.bus.io, watchdog=watchdog))
    with contextlib.closing(SupervisorProcess(settings, "udp:")) as supervisor:
        supervisor.begin()
        clock.now_s += 5.0  # the computer stood still, and the supervisor with it
        assert supervisor.trouble() == ""
        looks = 0
        while not supervisor.trouble():
            clock.now_s += PERIOD_S
            looks += 1
            assert looks < 200
        assert looks * PERIOD_S == pytest.approx(silent_s, abs=3 * PERIOD_S)
        supervisor.begin()
        assert supervisor.trouble() == ""
