"""Random sequences of commands and faults on the whole bench and the emulated machine: what the truth must show whatever happens.

The bench says what it has seen; here it is judged by what it cannot see: the plant, the brake's armature, the drive's power stage.
"""

from __future__ import annotations

import contextlib
import math
import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from falling_arm import EFFORT_Nm_A, INERTIA_kg_m2, falling_arm
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule, run_state_machine_as_test

from drivers.errors import KEEP_AWAY, DriverError
from hil.bench.attendant import LockstepAttendant
from hil.bench.bench import Bench
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.bench.start_pose import standing
from hil.errors import BenchError
from hil.experiments import Move, Plan, Scan, Static
from hil.machine.faults_file import places_of
from virtual_bus.canopen.power_state import Command, PowerState, command_of
from virtual_bus.faults.condition import MOVING_SPEED
from virtual_bus.faults.fault import FaultKind
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.faults.motion_log import MotionLog
from virtual_bus.faults.registry import fault_kinds
from virtual_bus.faults.schedule import Injection
from virtual_bus.faults.seam import Undo

ARM = falling_arm()
AXIS = "turn"
PLACES = places_of(ARM)
SYNC, NMT, RPDO = 0x080, 0x000, 0x201
HOLDING = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
TAKES_VOLTAGE = (Command.DISABLE_VOLTAGE, Command.SHUTDOWN, Command.SWITCH_ON)
AT_ONCE = 2
"""Faults that act together: any two, or one that has slept until it is needed and one that needs it."""
CREEP = 5e-3
"""rad by which an axis may still move after it was said to be at rest: the travel that a first move shows, five times."""

RAMP_S = ARM.limits[0].speed / ARM.limits[0].acceleration
"""In which a stop ends the axis's greatest speed: for no longer may its energy grow after the stop, or a fault in it, began."""
NOTICED_J = 0.5 * INERTIA_kg_m2 * MOVING_SPEED**2
"""By which its kinetic energy has grown: that of a motion which is more than a push of a brake's proof."""

OPERATOR = ("hold_to_run_released", "door_opened")


@dataclass(frozen=True)
class Fault:
    """One fault at its place."""

    kind: FaultKind
    at: str
    values: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        return f"{self.kind.name} at {self.at} {dict(self.values) or ''}".strip()


def faults(*, of_the_operator: bool) -> dict[str, list[Fault]]:
    """Every fault that this machine can have, with the parameters of each row of the table, by its class."""
    all_ = [
        Fault(kind, at, tuple((p.name, trial.values.get(p.name, p.default)) for p in kind.parameters))
        for kind in fault_kinds().values()
        if kind.begin is not None and (kind.name in OPERATOR) is of_the_operator
        for at in PLACES.of(kind.at)
        for trial in {str(dict(trial.values)): trial for trial in kind.trials}.values()
    ]
    return {group: [fault for fault in all_ if fault.kind.group == group] for group in dict.fromkeys(fault.kind.group for fault in all_)}


FAULTS = faults(of_the_operator=False)
ANY = st.sampled_from(list(FAULTS)).flatmap(lambda group: st.sampled_from(FAULTS[group]))
ASLEEP = [fault for fault in FAULTS["brake"] if fault.kind.name not in ("brake_closes_in_motion", "brake_feedback_stuck_closed")]


class Truth:
    """What the emulated machine knows and the bench does not."""

    def __init__(self, bench: Bench, machine: FaultyMachine) -> None:
        self.machine = machine
        self.taken: list[str] = []
        self.moved: list[str] = []
        self.driven: list[str] = []  # energy grew in a stop, under voltage
        self.fell: list[str] = []  # it grew without voltage: brake and drive are lost, which must be said
        self._link = bench.wiring.link
        self.said_before = 0  # lines that were said when the last stop began
        self._least_J, self._grown_s = math.inf, 0.0
        self._holds = bench.model.holding_effort
        self._drive = next(iter(machine.drives.values()))
        self._brake_effort = ARM.plant.tree.joints[0].brake_effort
        self._word = 0
        self._rests_at = math.nan
        self._hear, machine.receive = machine.receive, self._receive
        machine.samples.add("", self._watch)

    @property
    def position(self) -> float:
        return self.machine.quantity(f"position_{AXIS}")

    def said_at_rest(self) -> None:
        """From here on the axis must not move."""
        self._rests_at = self.position

    def nothing_said(self) -> None:
        """The axis may move again."""
        self._rests_at = math.nan

    def held_by_its_brake(self) -> bool:
        load = abs(float(self._holds(np.array([self.position]))[0])) * EFFORT_Nm_A
        return float(self.machine.brakes.share[0]) * self._brake_effort >= load

    def _receive(self, can_id: int, data: bytes) -> None:
        """Take a frame of the bench: whether it takes the voltage from a drive that holds, and whether the brake holds what it held."""
        if can_id == RPDO and len(data) == 4:
            (self._word, _) = struct.unpack("<Hh", data)
        may_take = can_id == NMT or (can_id == SYNC and command_of(self._word) in TAKES_VOLTAGE)
        holds = may_take and self._drive.power_state in HOLDING and not self.machine.efforts.at(AXIS)
        held = not holds or self.held_by_its_brake()
        self._hear(can_id, data)
        if holds and not held and self._drive.power_state not in HOLDING:
            what = f"controlword {self._word:04X}h" if can_id == SYNC else f"NMT {data.hex()}"
            self.taken.append(f"{self.machine.time_s:.2f} s: {what} at {self.position:+.3f} rad, brake {self.machine.brakes.share}")

    def energy_counts_anew(self) -> None:
        """From here on it must not grow for longer than a ramp, if a stop is under way: a fault has come or gone."""
        self._least_J, self._grown_s = math.inf, 0.0

    def _watch_energy(self) -> None:
        """In a stop, see whether the arm's kinetic energy is beyond its least for longer than a ramp takes."""
        if not self._link.stopping:
            self.said_before = len(self._link.attendant.said)
            self.energy_counts_anew()
            return
        energy_J = 0.5 * INERTIA_kg_m2 * self.machine.quantity(f"speed_{AXIS}") ** 2
        self._least_J = min(self._least_J, energy_J)
        self._grown_s = self._grown_s + self.machine.period_s if energy_J > self._least_J + NOTICED_J else 0.0
        if self._grown_s > RAMP_S:
            powered = self._drive.power_state in HOLDING and self.machine.quantity(f"command_{AXIS}") != 0.0
            (self.driven if powered else self.fell).append(f"{self.machine.time_s:.2f} s: {energy_J:.2f} J, {self._least_J:.2f} J before")
            self.energy_counts_anew()

    def _watch(self) -> None:
        self._watch_energy()
        if abs(self.position - self._rests_at) > CREEP:
            speed = self.machine.quantity(f"speed_{AXIS}")
            self.moved.append(
                f"{self.machine.time_s:.2f} s: {self.position:+.4f} rad, {speed:+.4f} rad/s; at rest at {self._rests_at:+.4f}"
            )
            self.nothing_said()


class Attendant(LockstepAttendant):
    """Leaves a hold after this time: before or after the brakes were told to close once more."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self._seconds = seconds

    def stays(self, held_s: float) -> bool:
        return held_s < self._seconds


class Sequences(RuleBasedStateMachine):
    """An operator, a bench, and a machine with faults."""

    def __init__(self) -> None:
        super().__init__()
        self._stack = contextlib.ExitStack()
        self.stage = "away"
        self.acting: dict[str, Undo] = {}

    # ---- opening and leaving --------------------------------------------------------------------------
    @initialize(position=st.sampled_from([0.3, 0.0, -1.1]), asleep=st.sampled_from([*ASLEEP, None]), stays_s=st.sampled_from([0.2, 6.0]))
    def open(self, position: float, asleep: Fault | None, stays_s: float) -> None:
        """The bench with a machine that it holds, and perhaps a fault of the brake or its feedback that nobody has noticed yet."""
        self.folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
        options = BenchOptions("lockstep:", motion=MotionLog(ARM.axes), noise=False)
        self.bench = self._stack.enter_context(open_bench(ARM, options, np.array([position])))
        machine = self.bench.wiring.faulty
        assert machine is not None
        self.machine, self.link = machine, self.bench.wiring.link
        self.attendant = self.link.attendant = Attendant(stays_s)
        self.truth = Truth(self.bench, machine)
        self.stage = "away"
        self.take_hold(push=False)
        if asleep is not None:
            self.inject([asleep], 0.0, math.inf)

    def teardown(self) -> None:
        self._stack.close()  # the machine's time goes on without the bench until all is at rest
        if hasattr(self, "truth"):
            self.the_truth_shows_nothing_forbidden()

    # ---- faults ---------------------------------------------------------------------------------------
    def _inject(self, fault: Fault, after_s: float, for_s: float) -> None:
        label = str(fault)

        def begin() -> Undo:
            self.truth.energy_counts_anew()
            if fault.kind.group == "brake":
                self.truth.nothing_said()  # what held it then holds no more
            assert fault.kind.begin is not None
            undo = fault.kind.begin(self.machine, fault.at, dict(fault.values))

            def end() -> None:
                self.truth.energy_counts_anew()
                self.acting.pop(label, None)
                undo()

            self.acting[label] = end
            return end

        self.machine.schedule.add(Injection(label, begin, None, self.machine.time_s + after_s, for_s))

    @precondition(lambda self: len(self.acting) < AT_ONCE)
    @rule(
        faults=st.lists(ANY, min_size=1, max_size=AT_ONCE),
        after_s=st.sampled_from([0.0, 0.3, 1.0]),
        for_s=st.sampled_from([math.inf, 0.5, 0.03]),
    )
    def inject(self, faults: list[Fault], after_s: float, for_s: float) -> None:
        """One fault, or two at the same instant."""
        for fault in faults[: AT_ONCE - len(self.acting)]:
            if str(fault) not in self.acting:
                self.acting[str(fault)] = lambda: None
                self._inject(fault, after_s, for_s)

    @rule(
        what=st.sampled_from(faults(of_the_operator=True)["I/O"]),
        after_s=st.sampled_from([0.3, 0.0, 1.0]),
        for_s=st.sampled_from([0.5, math.inf]),
    )
    def let_go(self, what: Fault, after_s: float, for_s: float) -> None:
        """Hold-to-run is released, the door opened."""
        if str(what) not in self.acting:
            self._inject(what, after_s, for_s)

    @precondition(lambda self: self.acting)
    @rule()
    def withdraw(self) -> None:
        for undo in list(self.acting.values()):
            undo()
        self.acting.clear()

    # ---- commands -------------------------------------------------------------------------------------
    def _try(self, command: Callable[[], object], leads_to: str) -> None:
        """Do it; the bench may refuse or stop, in its own words."""
        before = self.link.rests
        try:
            command()
        except (DriverError, BenchError):
            self.stage = "stopped"
        else:
            self.stage = leads_to
        if self.link.rests is not before and all(rest.safe for rest in self.link.rests) and self.link.rests:
            self.truth.said_at_rest()

    @precondition(lambda self: self.stage != "held")
    @rule(push=st.booleans())
    def take_hold(self, push: bool) -> None:
        """Boot, first move, homing, drives enabled, brakes open."""
        self.truth.nothing_said()

        def take_hold() -> None:
            if self.stage != "homed":
                self.link.start()
                pose, windup = standing(ARM, self.bench.model, self.link.exchange(np.zeros(1)))
                self.link.home(self.bench.model.holding_effort(pose), windup, check_first_move=push)
            self.bench.take_hold()
            self.link.watch.lead()

        self._try(take_hold, "held")

    @precondition(lambda self: self.stage == "held")
    @rule(by=st.sampled_from([-0.3, 0.1, 0.4]), rows=st.sampled_from([20, 1000]))
    def move(self, by: float, rows: int) -> None:
        """A motion from where the axis is led to, perhaps broken off."""
        begins = float(self.bench.pose[0])
        (leg, *_) = (
            Move({AXIS: begins}, {AXIS: begins + by}).plans(ARM) if abs(begins + by) < 1.5 else Static(0.3, {AXIS: begins}).plans(ARM)
        )
        part = replace(leg, **{name: getattr(leg, name)[:rows] for name in ("reference", "reference_raw", "excitation")})
        self._try(lambda: self.bench.loop.run(part), "held")
        self.bench.pose = part.reference[-1].copy()

    @precondition(lambda self: self.stage == "held")
    @rule(seconds=st.sampled_from([0.1, 1.5]))
    def idle(self, seconds: float) -> None:
        (plan,) = Static(seconds, {AXIS: float(self.bench.pose[0])}).plans(ARM)
        self._try(lambda: self.bench.loop.run(plan), "held")

    @precondition(lambda self: self.stage == "held")
    @rule(seconds=st.sampled_from([0.02, 0.3, 2.0]))
    def stall(self, seconds: float) -> None:
        """The bench's process does not run for a while."""
        self.link.clock.wait(seconds)

    @precondition(lambda self: self.stage == "held")
    @rule()
    def come_to_rest(self) -> None:
        self._try(lambda: self.link.close_brakes(self.bench.holding()), "homed")
        if self.stage == "homed":
            self.truth.said_at_rest()

    @precondition(lambda self: self.stage in ("held", "homed"))
    @rule()
    def stop(self) -> None:
        self._try(self.link.stop, "stopped")

    @precondition(lambda self: self.stage != "away")
    @rule()
    def leave(self) -> None:
        self._try(self.link.close, "away")

    @precondition(lambda self: self.stage == "away")
    @rule(sweeps=st.booleans())
    def run(self, sweeps: bool) -> None:
        """A whole run: boot, first move, homing, way, settling, rows, brakes."""
        self.truth.nothing_said()
        at = float(np.clip(self.bench.pose[0], -1.2, 1.2))
        plan: Plan = (Scan(AXIS, at, at - math.copysign(0.4, at), 0.5, dwell_s=0.1) if sweeps else Static(0.5, {AXIS: at})).plans(ARM)[0]
        self._try(lambda: self.bench.run(plan, self.folder / "run.mf4"), "away")
        self.stage = "away"

    def said(self) -> str:
        """Return all that an operator was told."""
        return "; ".join([*self.attendant.said, self.link.outcome])

    # ---- what must hold -------------------------------------------------------------------------------
    @invariant()
    def the_truth_shows_nothing_forbidden(self) -> None:
        if hasattr(self, "truth"):
            assert not self.truth.taken, f"voltage taken from an axis that its brake does not hold: {self.truth.taken}"
            assert not self.truth.driven, f"a drive went on driving in a stop: {self.truth.driven}; {self.said()}"
            told = "; ".join([*self.attendant.said[self.truth.said_before :], self.link.outcome])
            assert not self.truth.fell or KEEP_AWAY in told, f"fell, and nobody is told: {self.truth.fell}; {self.said()}"
            self.truth.fell.clear()  # of the last stop: what was said then excuses no later one
            assert not self.truth.moved, f"moved after it was said to be at rest: {self.truth.moved}; {self.link.outcome}"


def check(examples: int, steps: int) -> None:
    run_state_machine_as_test(
        Sequences,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            deadline=None,
            derandomize=True,
            database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )


def test_no_sequence_of_commands_and_faults_drops_the_arm_or_belies_what_was_said() -> None:
    check(50, 4)


@pytest.mark.nightly
def test_nor_does_any_of_many_more() -> None:
    check(2000, 8)
    check(100, 25)  # long histories
