"""Whatever moves an axis that should stand, or moves it further than it may, is seen and stopped: the emulated C-arm with one thing broken.

How far an axis went is the plant's own truth, from the tick in which the thing broke until the machine was at rest: what the watch allows,
the brake's 0.1 s, and the swing of the structure behind it.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM, edited

from drivers.errors import MotionRefusedError
from hil.bench.bench import Bench
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import LoopAbortedError
from hil.experiments import Static
from hil.machine import Machine, machine_from_text
from virtual_bus.canopen.drive import Cia402Drive
from virtual_bus.canopen.homing import Homing, Reference

START = np.array([0.1, -0.2])
HOMING = 6
SWITCH_HOMING = machine_from_text(edited(r"(\[bus.homing.propeller\]\nmethod = )37", r"\g<1>17\ntravel_limit_deg = 3.0"))


def frozen(drive: Cia402Drive, bench: Bench) -> None:
    """The motor-side encoder says what it said last."""
    last, latch = drive.servo.absolute - drive.servo.origin, drive.latch
    drive.latch = lambda counts, *more: latch(last, *more)


def flipped(drive: Cia402Drive, bench: Bench) -> None:
    """The motor-side encoder counts the wrong way."""
    turned, latch = drive.servo.absolute - drive.servo.origin, drive.latch
    drive.latch = lambda counts, *more: latch(2 * turned - counts, *more)


def mute(drive: Cia402Drive, bench: Bench) -> None:
    """The drive's TPDO is lost; its heartbeat is not."""
    emit, own = drive.emit, 0x180 + drive.node_id
    drive.emit = lambda can_id, data: None if can_id == own else emit(can_id, data)


def powerless(drive: Cia402Drive, bench: Bench) -> None:
    """The power stage says it is enabled and brings no current; the brake's feedback contact does not close."""
    command, io = drive.command, bench.wiring.link.network.can_bus.machine.io
    drive.command = lambda: 0.0 * command()
    io.layout = dataclasses.replace(io.layout, brake_feedback_inputs={})


def nothing(drive: Cia402Drive, bench: Bench) -> None:
    """All is well."""


class Broken:
    """A bench on which one thing breaks the first time that something is so."""

    def __init__(self, bench: Bench, axis: str, fault: Callable[[Cia402Drive, Bench], None], when: Callable[[Broken], bool]) -> None:
        self.bench, self.axis, self.fault, self.when = bench, axis, fault, when
        self.emulated = bench.wiring.link.network.can_bus.machine
        self.drive = next(drive for drive in self.emulated.drives.values() if drive.settings.axis == axis)
        self.index = CARM.axis_index(axis)
        self.way: list[float] = []
        self.emulated._witness = self.watch

    @property
    def brake_open(self) -> bool:
        return not self.emulated.io.brakes_closed[self.index]

    @property
    def told_to_open(self) -> bool:
        return self.emulated.io.coils[self.emulated.io.layout.brake_coils[self.axis]]

    def position(self) -> float:
        joints = {encoder.channel: encoder.joints for encoder in CARM.plant.encoders}[f"link_position_{self.axis}"]
        positions = self.emulated.physics.truth()["joint_position"]
        return float(sum(positions[CARM.plant.tree.joint_index(name)] for name in joints))

    def watch(self, time_s: float) -> None:
        if not self.way and self.when(self):
            self.fault(self.drive, self.bench)
            self.way.append(self.position())
        elif self.way:
            self.way.append(self.position())

    def moved(self) -> float:
        """Furthest from where it broke [rad], the machine being at rest again."""
        self.bench.wiring.clock.wait(0.2)  # the nodes are reset; a brake whose feedback lies may still be closing
        self.way.append(self.position())
        assert not any(drive.power_state.name == "OPERATION_ENABLED" for drive in self.emulated.drives.values())
        assert not self.brake_open
        return float(np.abs(np.array(self.way) - self.way[0]).max())


def still(folder: Path, bench: Bench) -> None:
    bench.run(Static(0.5, dict(zip(CARM.axes, map(float, START), strict=True))).plans(CARM)[0], folder / "run.mf4")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "words", "moved"),
    [
        (frozen, r"roll: link encoder: moved by [+-]5\.\d\de-03 rad while it should stand; 5\.24e-03 rad is allowed", 8e-3),
        (flipped, r"roll: moved -3\.\d\de-04 rad on a positive effort", 1e-3),
        (mute, r"roll: motor side: no position for 4 ticks, timing\.stale_ticks bridges 3", 1e-4),
        (
            powerless,
            r"roll: moves by -1\.\d\de-03 rad under its holding effort of 1\.92 alone; the holding effort is wrong or not given",
            6e-3,
        ),
    ],
)
def test_the_first_move_is_watched_tick_by_tick(fault: Callable[..., object], words: str, moved: float) -> None:
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        broken = Broken(bench, "roll", fault, lambda b: b.told_to_open)
        with pytest.raises(MotionRefusedError, match=words):
            bench.commission()
        assert broken.moved() < moved


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "words", "moved"),
    [
        (mute, r"roll: motor side: no position for 4 ticks", 1e-4),
        (powerless, r"roll: .* moved by -5\.\d\de-03 rad while it should stand", 14e-3),
    ],
)
def test_an_axis_is_watched_while_its_brake_opens_for_a_run(tmp_path: Path, fault: Callable[..., object], words: str, moved: float) -> None:
    """Without, roll falls for as long as its brake's feedback is waited for, a second."""
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        bench.commission()
        broken = Broken(bench, "roll", fault, lambda b: b.told_to_open)
        with pytest.raises(MotionRefusedError, match=words):
            still(tmp_path, bench)
        assert broken.moved() < moved


def test_an_axis_is_watched_while_its_brake_closes_after_a_run(tmp_path: Path) -> None:
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        opened = []
        broken = Broken(bench, "roll", mute, lambda b: bool(opened) and b.brake_open and not b.told_to_open)
        close = bench.wiring.link.close_brakes
        bench.wiring.link.close_brakes = lambda hold: (opened.append(True), close(hold))[1]
        with pytest.raises(MotionRefusedError, match="roll: motor side: no position for 4 ticks"):
            still(tmp_path, bench)
        assert broken.moved() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "share", "moved"), [(frozen, 0.0, 65e-3), (flipped, -1.0, 110e-3)])
def test_an_encoder_that_lies_is_found_by_the_links_while_the_loop_holds(
    tmp_path: Path, fault: Callable[..., object], share: float, moved: float
) -> None:
    """Feedback on a frozen position holds nothing, on a reversed one drives the axis away: the tracking error tells late, or never.

    `share` is what the motor side shows of the link's motion. Which way a reversed one drives is up to how the axis stood.
    """
    with open_bench(CARM, BenchOptions("lockstep:"), START) as bench:
        bench.commission()
        broken = Broken(bench, "roll", fault, lambda b: b.told_to_open)
        words = r"roll: its motor side moved by (\S+) rad, its link encoder by (\S+) while it was led"
        with pytest.raises(LoopAbortedError, match=words) as raised:
            still(tmp_path, bench)
        assert broken.moved() < moved
    told = re.search(words, str(raised.value))
    assert told is not None
    motor, link = map(float, told.groups())
    assert motor == pytest.approx(share * link, abs=0.05 * abs(link))
    assert 20e-3 < abs(link) < 60e-3


def home_on_a_switch(machine: Machine, fault: Callable[[Cia402Drive, Bench], None], switch: float) -> tuple[float, str]:
    """Propeller homes on a limit switch at that joint position; how far it went, and what was said."""
    with open_bench(machine, BenchOptions("lockstep:"), START) as bench:
        bench.commissioning = ("the first move is checked elsewhere",)
        broken = Broken(bench, "propeller", fault, lambda b: b.brake_open and b.drive._mode_display.value == HOMING)
        drive, resolution = broken.drive, CARM.bus.scalings[0].position_resolution
        reference = Reference(drive.homing.reference.counts_per_turn, drive.servo.origin + round((switch - START[0]) / resolution), None)
        drive.homing = Homing(reference)
        with pytest.raises(MotionRefusedError) as refused:
            bench.commission()
        return broken.moved(), str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "words", "moved"),
    [
        (nothing, "propeller: motor side: moved by -5.24e-02 rad while it homed by method 17; 5.24e-02 rad is allowed", 60e-3),
        (frozen, "propeller: its motor side moved by +0.00e+00 rad, its link encoder by -5.", 18e-3),
        (flipped, "propeller: its motor side moved by +3.2", 20e-3),
        (mute, "propeller: motor side: no position for 4 ticks", 1e-3),
        (powerless, r"propeller: motor side: moved by -2.", 50e-3),
    ],
    ids=["no switch", "frozen", "flipped", "mute", "powerless"],
)
def test_homing_that_moves_keeps_to_its_travel_and_speed_and_its_encoders_agree(
    fault: Callable[..., object], words: str, moved: float
) -> None:
    way, said = home_on_a_switch(SWITCH_HOMING, fault, -10.0)
    assert said.startswith(words)
    assert way < moved


def test_homing_that_finds_its_switch_may_travel_there() -> None:
    """The switch is 0.02 rad away, its counter jumps there, and only the agreement with the link encoder refuses the zero it took."""
    _, said = home_on_a_switch(SWITCH_HOMING, nothing, START[0] - 0.02)
    assert "they differ by" in said
    assert "home anew" in said
