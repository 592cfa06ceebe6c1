"""Which silences become machine time, and how much of it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from device_wires import PERIOD_S

from hil.emulated.machine import emulated_bus
from hil.machine import load_machine
from virtual_bus.idle_time import IdleTime
from virtual_bus.physics import Physics

SILENCE_S = 0.1  # longer than a busy computer lets a process stand still, shorter than the usual heartbeat time-outs
QUIET_S = 0.002  # a master that computes between two frames is quiet for less
ANSWER_S = 0.02  # so much more silence is left for an answer to a device that has spoken


class Silence:
    """Silence in slices of a millisecond, as an emulator on the wall clock sees it; counts the periods that pass."""

    def __init__(self, silence_s: float = SILENCE_S, *, by_the_wall: bool = False) -> None:
        self.idle = IdleTime(PERIOD_S, silence_s, by_the_wall=by_the_wall)
        self.periods = 0
        self.talkative = False  # the devices send something in every period

    def wait(self, seconds: float, slice_s: float = 0.001) -> None:
        for _ in range(round(seconds / slice_s)):
            self.idle.add(slice_s)
            while self.idle.step():
                self.periods += 1
                if self.talkative:
                    self.idle.spoken()

    @property
    def passed_s(self) -> float:
        return self.periods * PERIOD_S


@pytest.mark.parametrize("slice_s", [0.0005, 0.001, 0.005, 0.02])
def test_long_silence_passes_in_full_once_it_has_been_long_enough(slice_s: float) -> None:
    silence = Silence()
    silence.wait(SILENCE_S - slice_s, slice_s)
    assert silence.periods == 0
    silence.wait(3.0, slice_s)
    assert silence.passed_s == pytest.approx(3.0 + SILENCE_S - slice_s, abs=PERIOD_S)


def test_by_the_wall_time_passes_whoever_speaks_and_with_syncs_they_alone_move_it() -> None:
    silence = Silence(by_the_wall=True)
    silence.talkative = True
    for _ in range(1000):
        silence.wait(0.001)
        silence.idle.frame()
    assert silence.passed_s == pytest.approx(1.0, abs=PERIOD_S)
    silence.idle.sync()
    before = silence.periods
    for _ in range(100):
        silence.wait(0.004)
        silence.idle.sync()
    assert silence.periods == before


def test_a_bench_may_stand_still_for_as_long_as_it_was_said() -> None:
    silence = Silence(silence_s=0.5)
    for _ in range(10):
        silence.idle.sync()
        silence.wait(0.4)
    assert silence.periods == 0
    silence.wait(1.0)
    assert silence.passed_s == pytest.approx(0.4 + 1.0, abs=PERIOD_S)  # what was held back is made up for


@pytest.mark.slow
@pytest.mark.parametrize(
    ("nodes_s", "master_s", "silence_s"), [(0.1, 0.1, 0.1), (0.3, 1.0, 0.3), (4.0, 0.2, 0.2), (4.0, 1.5, 0.5), (0.05, 1.0, 0.1)]
)
def test_an_emulated_machine_waits_as_long_as_the_shortest_heartbeat_of_its_file(nodes_s: float, master_s: float, silence_s: float) -> None:
    machine = load_machine("carm")
    assert machine.bus is not None
    nodes = tuple(replace(node, heartbeat_period_s=nodes_s) for node in machine.bus.nodes)
    bus = replace(machine.bus, nodes=nodes, master_heartbeat_period_s=master_s)
    machine = replace(machine, bus=bus)
    assert emulated_bus(machine, Physics(machine.plant)).silence_s == silence_s


def test_nothing_passes_between_syncs_of_any_usual_rate() -> None:
    for period_s in (0.001, PERIOD_S, 0.01, 0.04):
        silence = Silence()
        for _ in range(100):
            silence.idle.sync()
            silence.wait(period_s)
        assert silence.periods == 0


def test_hesitations_in_a_burst_of_frames_take_no_time() -> None:
    silence = Silence()
    silence.wait(SILENCE_S - 0.002)  # a quiet moment before the burst
    for _ in range(60):
        silence.idle.frame()
    for k in range(3000):
        silence.idle.frame()
        silence.wait(0.030 if k % 20 == 0 else 0.001)  # a loaded computer
    assert silence.periods == 0


@pytest.mark.parametrize("pause_s", [QUIET_S, 0.005, 0.01, 0.1, 0.5])
def test_a_master_that_polls_waits_too(pause_s: float) -> None:
    silence = Silence()
    for _ in range(round(4.0 / pause_s)):
        silence.idle.frame()
        silence.wait(pause_s)
    assert silence.passed_s == pytest.approx(4.0, rel=0.05)


def test_after_a_device_has_spoken_time_waits_for_an_answer_and_is_then_made_up_for() -> None:
    silence = Silence()
    silence.talkative = True
    silence.wait(SILENCE_S + 0.001)
    assert silence.periods == 1
    silence.wait(ANSWER_S - 0.003)
    assert silence.periods == 1
    silence.wait(0.006)
    assert silence.periods == 2
    silence.talkative = False
    silence.wait(1.0 - 0.006)
    assert silence.passed_s == pytest.approx(1.0 + ANSWER_S + SILENCE_S, abs=2 * PERIOD_S)


def test_an_answer_in_time_finds_the_machine_where_it_spoke() -> None:
    silence = Silence()
    silence.talkative = True
    silence.wait(SILENCE_S + 0.010)
    assert silence.periods == 1
    silence.idle.sync()
    silence.wait(SILENCE_S - 0.002)
    assert silence.periods == 1
