"""What ends a run ends it safely: signals that come while the motors are being stopped, and what the drives do until the brakes hold."""

from __future__ import annotations

import signal
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM

from drivers.errors import MotionRefusedError
from hil.bench.bench import Bench
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import LoopAbortedError
from hil.experiments import Plan, Static
from virtual_bus.canopen.power_state import PowerState
from virtual_bus.lockstep import LockstepBus

START = np.array([0.1, -0.2])
POSE = dict(zip(CARM.axes, map(float, START), strict=True))
POWERED = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
SYNC, COMMANDS = 0x080, {0x201: "propeller_drive", 0x202: "roll_drive"}  # of a drive: controlword and target torque
VOLTAGE_OFF, NO_QUICK_STOP = 0x0000, 0x0004  # CiA 402: a controlword, and the bit that a stop clears


@dataclass(frozen=True)
class Tick:
    """What the drives were told last when a SYNC came, and what they and the brakes did."""

    controlwords: list[int]
    torques: list[int]
    powered: list[bool]
    enabled: list[bool]
    brake_open: list[bool]

    @property
    def stops(self) -> bool:
        return any(self.brake_open) and not any(word & NO_QUICK_STOP for word in self.controlwords)


class WatchedBus(LockstepBus):
    """Sees every frame to the emulated machine; calls `at_tick` with the ticks of a stop so far."""

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)
        self.ticks: list[Tick] = []
        self.at_tick: Callable[[int], None] = lambda number: None
        self._told = dict.fromkeys(COMMANDS, (VOLTAGE_OFF, 0))

    def send_frame(self, can_id: int, data: bytes) -> None:
        super().send_frame(can_id, data)
        if can_id in COMMANDS:
            self._told[can_id] = struct.unpack("<Hh", data)
        elif can_id == SYNC:
            words, torques = zip(*self._told.values(), strict=True)
            states = [self.machine.drives[name].power_state for name in COMMANDS.values()]
            powered, enabled = [state in POWERED for state in states], [state is PowerState.OPERATION_ENABLED for state in states]
            brake_open = [not closed for closed in self.machine.io.brakes_closed]
            self.ticks.append(Tick(list(words), list(torques), powered, enabled, brake_open))
            if stop := self.stop():
                self.at_tick(len(stop))

    def stop(self) -> list[Tick]:
        """Ticks from the first one that stops with open brakes."""
        first = next((k for k, tick in enumerate(self.ticks) if tick.stops), len(self.ticks))
        return self.ticks[first:]


@pytest.fixture(autouse=True)
def watched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.bench.wiring.LockstepBus", WatchedBus)


@pytest.mark.slow
def test_a_second_ctrl_c_while_the_motors_are_being_stopped_does_not_break_the_stop_off(tmp_path: Path) -> None:
    def interrupt() -> None:
        signal.raise_signal(signal.SIGINT)

    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        bus = bench.wiring.link.network.can_bus
        bus.at_tick = lambda number: interrupt() if number in (3, 4) else None
        with pytest.raises(LoopAbortedError, match="asked to stop by SIGINT"):
            bench.run(Static(1.0, POSE).plans(CARM)[0], tmp_path / "run.mf4", lambda row: interrupt() if row == 128 else None)
        assert bench.wiring.link.troubles == []
    seen = bus.stop()
    assert all(seen[3].brake_open), "the signals came before the brakes had closed"
    assert seen[-1].controlwords == [VOLTAGE_OFF, VOLTAGE_OFF]
    assert not any(seen[-1].powered)
    assert not any(
        word == VOLTAGE_OFF and is_open for tick in seen for word, is_open in zip(tick.controlwords, tick.brake_open, strict=True)
    )


@pytest.mark.slow
def test_a_drive_holds_its_axis_until_its_brake_has_closed(tmp_path: Path) -> None:
    """The brake's mechanics are slow here: a drive that switches itself off at standstill would let the axis fall before."""
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        bus = bench.wiring.link.network.can_bus
        bus.machine.io._brake_delay_s = 0.3
        with pytest.raises(LoopAbortedError, match="asked to stop"):
            bench.run(
                Static(1.0, POSE).plans(CARM)[0],
                tmp_path / "run.mf4",
                lambda row: bench.loop.stop_request.ask("asked to stop") if row == 128 else None,
            )
    seen = bus.stop()
    assert sum(all(tick.brake_open) for tick in seen) > 0.3 * CARM.sample_rate_Hz
    assert not any(is_open and not power for tick in seen for is_open, power in zip(tick.brake_open, tick.powered, strict=True))


def test_a_second_ctrl_c_elsewhere_interrupts_at_once() -> None:
    with open_bench(CARM, BenchOptions("lockstep:"), START):
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(LoopAbortedError, match="interrupted twice"):
            signal.raise_signal(signal.SIGINT)


@pytest.mark.slow
def test_the_first_command_an_enabled_drive_obeys_holds_its_axis(tmp_path: Path) -> None:
    """Roll stands where gravity turns it with 0.5 A and more; zero at the instant of enabling would let it fall."""
    start = np.array([0.0, 0.6])
    with open_bench(CARM, BenchOptions("lockstep:"), start) as bench:
        bus = bench.wiring.link.network.can_bus
        wanted = bench.model.holding_effort(start)
        assert abs(wanted[1]) > 0.3
        bench.run(Static(1.0, {"propeller": 0.0, "roll": 0.6}).plans(CARM)[0], tmp_path / "run.mf4")
    for axis, scaling in enumerate(CARM.bus.scalings):
        enabled = np.array([tick.enabled[axis] for tick in bus.ticks])
        last = np.flatnonzero(enabled[1:] & ~enabled[:-1])[-1] + 1  # homing has enabled it before
        torques = np.array([tick.torques[axis] for tick in bus.ticks[last : last + 5]])
        assert scaling.sign * scaling.rated * torques / 1000.0 == pytest.approx(wanted[axis], abs=0.1)


def moved_while_planning(bench: Bench, monkeypatch: pytest.MonkeyPatch, counts: float) -> None:
    """The operator turns roll by that many counts between two sessions."""
    way_to = bench._way_to

    def planned(pose: np.ndarray) -> tuple[list[Plan], Plan]:
        way = way_to(pose)
        bench.wiring.link.network.can_bus.machine.place(bench.pose + np.array([0.0, counts * CARM.bus.scalings[1].position_resolution]))
        return way

    monkeypatch.setattr(bench, "_way_to", planned)


@pytest.mark.slow
@pytest.mark.parametrize("goal", [START, START + 0.05], ids=["stay", "move"])
def test_a_machine_that_moved_while_its_way_was_planned_is_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, goal: np.ndarray
) -> None:
    pose = dict(zip(CARM.axes, map(float, goal), strict=True))
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        moved_while_planning(bench, monkeypatch, 1500.0)
        words = r"roll: stands at -0\.19\d+ rad, its way was planned from .* moved by \d\.\de-03 .*run again"
        with pytest.raises(MotionRefusedError, match=words):
            bench.run(Static(1.0, pose).plans(CARM)[0], tmp_path / "run.mf4")
        monkeypatch.undo()
        bench.run(Static(1.0, pose).plans(CARM)[0], tmp_path / "again.mf4")  # planned anew from where it stands


@pytest.mark.slow
def test_a_machine_that_moved_a_little_is_led_to_its_way_without_a_jump(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        moved_while_planning(bench, monkeypatch, 300.0)
        run, legs = bench.loop.run, []
        monkeypatch.setattr(bench.loop, "run", lambda plan, *more: (legs.append(plan.reference.copy()), run(plan, *more))[1])
        bench.run(Static(1.0, dict(zip(CARM.axes, map(float, START), strict=True))).plans(CARM)[0], tmp_path / "run.mf4")
    steps = np.abs(np.diff(np.vstack(legs[:2]), axis=0))
    assert 0.0 < steps.max() < 1e-5  # a thousandth of a radian over 256 ticks; the whole of it at once would be a hundred times that


def test_the_time_since_a_stop_is_that_of_its_own_session() -> None:
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        link = bench.wiring.link
        with bench.session():
            bench.take_hold()
            link.stop()
            assert link.since_stop_s > 0.0
        with bench.session(homes=False):
            assert np.isnan(link.since_stop_s)
