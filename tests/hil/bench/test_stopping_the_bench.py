"""What ends a run ends it safely: signals that come while the motors are being stopped, and what the drives do until the brakes hold."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from bench_machines import CARM

from drivers.errors import MotionRefusedError
from hil.bench.bench import Bench
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import LoopAborted
from hil.experiments import Static
from virtual_bus.canopen.power_state import PowerState

START = np.array([0.1, -0.2])
POSE = dict(zip(CARM.axes, map(float, START), strict=True))
VOLTAGE_OFF = 0x0000
POWERED = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)


@dataclass
class Tick:
    """One tick of a stop, on the emulated machine."""

    commanded_off: list[bool]
    powered: list[bool]
    brake_open: list[bool]


def watch_stops(bench: Bench, monkeypatch: pytest.MonkeyPatch, at_tick: dict[int, Callable[[], None]] | None = None) -> list[Tick]:
    """Every tick of the next stop that finds brakes open, and of what follows; `at_tick` is called after some."""
    link, seen = bench.wiring.link, []
    emulated, tick = link.network.can_bus.machine, link._tick_at_rest

    def watched() -> None:
        tick()
        brake_open = [not closed for closed in emulated.io.brakes_closed]
        if not seen and not any(brake_open):
            return
        seen.append(
            Tick(
                [output.controlword == VOLTAGE_OFF for output in link._cyclic.outputs],
                [drive.power_state in POWERED for drive in emulated.drives.values()],
                brake_open,
            )
        )
        (at_tick or {}).get(len(seen), lambda: None)()

    monkeypatch.setattr(link, "_tick_at_rest", watched)
    return seen


def test_a_second_ctrl_c_while_the_motors_are_being_stopped_does_not_break_the_stop_off(tmp_path, monkeypatch):
    def interrupt():
        signal.raise_signal(signal.SIGINT)

    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        seen = watch_stops(bench, monkeypatch, {3: interrupt, 4: interrupt})
        with pytest.raises(LoopAborted, match="asked to stop by SIGINT"):
            bench.run(Static(1.0, POSE).plans(CARM)[0], tmp_path / "run.mf4", lambda row: interrupt() if row == 128 else None)
        assert bench.wiring.link.troubles == []
    assert all(seen[3].brake_open), "the signals came before the brakes had closed"
    assert all(seen[-1].commanded_off) and not any(seen[-1].powered)
    assert not any(off and is_open for tick in seen for off, is_open in zip(tick.commanded_off, tick.brake_open, strict=True))


def test_a_drive_holds_its_axis_until_its_brake_has_closed(tmp_path, monkeypatch):
    """The brake's mechanics are slow here: a drive that switches itself off at standstill would let the axis fall before."""
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        bench.wiring.link.network.can_bus.machine.io._brake_delay_s = 0.3
        seen = watch_stops(bench, monkeypatch)
        with pytest.raises(LoopAborted, match="asked to stop"):
            bench.run(
                Static(1.0, POSE).plans(CARM)[0],
                tmp_path / "run.mf4",
                lambda row: bench.loop.stop_request.ask("asked to stop") if row == 128 else None,
            )
    assert sum(all(tick.brake_open) for tick in seen) > 0.3 * CARM.sample_rate_Hz
    assert not any(is_open and not power for tick in seen for is_open, power in zip(tick.brake_open, tick.powered, strict=True))


def test_a_second_ctrl_c_elsewhere_is_as_rude_as_ever():
    with open_bench(CARM, BenchOptions("lockstep:"), START):
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(LoopAborted, match="interrupted twice"):
            signal.raise_signal(signal.SIGINT)


def test_the_first_command_an_enabled_drive_obeys_holds_its_axis(tmp_path, monkeypatch):
    """Roll stands where gravity turns it with 0.5 A and more; zero at the instant of enabling would let it fall."""
    from virtual_bus.canopen.drive import Cia402Drive

    start = np.array([0.0, 0.6])
    efforts: dict[str, list[float]] = {}
    original = Cia402Drive.command

    def watch(drive):
        effort = original(drive)
        if holding and drive.power_state is PowerState.OPERATION_ENABLED:
            efforts.setdefault(drive.settings.axis, []).append(effort)
        return effort

    monkeypatch.setattr(Cia402Drive, "command", watch)
    holding = False
    with open_bench(CARM, BenchOptions("lockstep:"), start) as bench:
        wanted = bench.model.holding_effort(start)
        assert abs(wanted[1]) > 0.3
        take_hold = bench._take_hold

        def watched():
            nonlocal holding
            holding = True
            take_hold()
            holding = False

        monkeypatch.setattr(bench, "_take_hold", watched)
        bench.run(Static(1.0, {"propeller": 0.0, "roll": 0.6}).plans(CARM)[0], tmp_path / "run.mf4")
    for axis, expected in zip(CARM.axes, wanted, strict=True):
        assert np.array(efforts[axis]) == pytest.approx(expected, abs=0.1)


def moved_while_planning(bench: Bench, monkeypatch: pytest.MonkeyPatch, counts: float) -> None:
    """The operator turns roll by that many counts between two sessions."""
    way_to = bench._way_to

    def planned(pose):
        way = way_to(pose)
        bench.wiring.link.network.can_bus.machine.place(bench.pose + np.array([0.0, counts * CARM.bus.scalings[1].position_resolution]))
        return way

    monkeypatch.setattr(bench, "_way_to", planned)


@pytest.mark.parametrize("goal", [START, START + 0.05], ids=["stay", "move"])
def test_a_machine_that_moved_while_its_way_was_planned_is_not_run(tmp_path, monkeypatch, goal):
    pose = dict(zip(CARM.axes, map(float, goal), strict=True))
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        moved_while_planning(bench, monkeypatch, 1500.0)
        words = r"roll: stands at -0\.19\d+ rad, its way was planned from .* moved by \d\.\de-03 .*run again"
        with pytest.raises(MotionRefusedError, match=words):
            bench.run(Static(1.0, pose).plans(CARM)[0], tmp_path / "run.mf4")
        monkeypatch.undo()
        bench.run(Static(1.0, pose).plans(CARM)[0], tmp_path / "again.mf4")  # planned anew from where it stands


def test_a_machine_that_moved_a_little_is_led_to_its_way_without_a_jump(tmp_path, monkeypatch):
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        moved_while_planning(bench, monkeypatch, 300.0)
        run, legs = bench.loop.run, []
        monkeypatch.setattr(bench.loop, "run", lambda plan, *more: (legs.append(plan.reference.copy()), run(plan, *more))[1])
        bench.run(Static(1.0, dict(zip(CARM.axes, map(float, START), strict=True))).plans(CARM)[0], tmp_path / "run.mf4")
    steps = np.abs(np.diff(np.vstack(legs[:2]), axis=0))
    assert 0.0 < steps.max() < 1e-5  # a thousandth of a radian over 256 ticks; the whole of it at once would be a hundred times that
