"""States, fault reset, modes and brakes tick by tick, on a machine that answers by script: bounds, order, and who is left alone."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.canopen import power_and_brakes
from drivers.canopen.cia402 import Mode, State
from drivers.errors import BusTimeoutError, DeviceFaultError, MotionRefusedError
from drivers.interface import Sample

PERIOD_S = 2.0**-8
SECOND = 256  # ticks
OFF, READY, ON, ENABLED, QUICK, REACTING, FAULT = 0x240, 0x231, 0x233, 0x237, 0x217, 0x20F, 0x208
WALK = {(OFF, 0x06): READY, (READY, 0x07): ON, (ON, 0x0F): ENABLED, (ENABLED, 0x00): OFF, (READY, 0x00): OFF, (ON, 0x00): OFF}
MAXON = 0x000000FB


class Objects:
    """The object dictionary of a drive; it shows a mode some time after it was written."""

    def __init__(self, who: str) -> None:
        self.who, self.objects, self.log, self.settings = who, {0x6061: 0}, [], {}
        self.shown_after_s, self.now_s = 0.0, 0.0
        self.network = SimpleNamespace(pump_for=self._pump)
        self._due: list[tuple[float, int]] = []

    def _pump(self, seconds: float) -> None:
        assert seconds == 0.01
        self.now_s += 2.0**-7  # exact, and near enough
        self.log.append("waits")

    def read_integer(self, index: int) -> int:
        for due_s, mode in self._due:
            if self.now_s >= due_s:
                self.objects[0x6061] = mode
        return self.objects[index]

    def write_integer(self, index: int, subindex: int, value: int) -> None:
        self.log.append((index, subindex, int(value)))
        self._due.append((self.now_s + self.shown_after_s, int(value)))

    def read_if_present(self, index: int) -> bytes | None:
        return self.objects.get(index)


class Machine:
    """Three drives that follow their controlwords at the next tick; brakes whose feedback follows their command some ticks later.

    `log` keeps what was asked of it, in order; `at` what happens before a tick's answer.
    """

    def __init__(self) -> None:
        self.axes, self.period_s, self.now_s, self.ticks = ("propeller", "roll", "tilt"), PERIOD_S, 0.0, 0
        self.log: list[object] = []
        self.clock = SimpleNamespace(now=lambda: self.now_s + sum(each.now_s for each in self.objects))
        self.drives = tuple(
            SimpleNamespace(name=f"{axis}_drive", node_id=k + 1, identity=SimpleNamespace(vendor_id=MAXON))
            for k, axis in enumerate(self.axes)
        )
        self.inputs = [SimpleNamespace(statusword=OFF) for _ in self.axes]
        self.objects = [Objects(f"{drive.name} (node {drive.node_id})") for drive in self.drives]
        self.emergencies: dict[int, str] = {}
        self.heartbeats = SimpleNamespace(last_emergency=lambda node_id: self.emergencies.get(node_id, ""))
        self.sample = Sample(3)
        self.open_brakes: set[str] = set()
        self.judged = lambda sample: ""
        self.forbidden = self.seen = ""
        self.watch = SimpleNamespace(check=lambda sample: self.seen if sample is self.sample else "another sample")
        self.modes: list[Mode | None] = [Mode.HOMING] * 3
        self.notes: tuple[str, ...] = ("before",)
        self.commands: list[list[float]] = []
        self.words = [0] * 3
        self.stuck: set[int] = set()  # axes whose drive follows no controlword
        self.braked, self.follows_after, self._feedback = {0, 1, 2}, 1, []
        self.at: Callable[[int], None] = lambda tick: None

    def exchange(self, command: np.ndarray) -> Sample:
        self.now_s += PERIOD_S
        self.ticks += 1
        self.commands.append(command.tolist())
        for axis, each in enumerate(self.inputs):
            if axis not in self.stuck:
                each.statusword = WALK.get((each.statusword, self.words[axis]), each.statusword)
        for due, axis, is_open in self._feedback:
            if self.ticks >= due:
                self.sample.brakes_open[axis] = is_open
        self.at(self.ticks)
        return self.sample

    def set_controlword(self, axis: int, controlword: int) -> None:
        self.words[axis] = controlword
        self.log.append((self.ticks, axis, controlword))

    def arm(self, axis: int, armed: bool) -> None:
        self.log.append((self.ticks, axis, "armed" if armed else "disarmed"))

    def command_brakes(self, open_: dict[str, bool]) -> None:
        self.log.append((self.ticks, open_))
        self._feedback += [(self.ticks + self.follows_after, self.axes.index(axis), is_open) for axis, is_open in open_.items()]

    def has_brake(self, axis: int) -> bool:
        return axis in self.braked

    def rest_axes(self, axes: list[int], effort: np.ndarray) -> None:
        self.log.append((self.ticks, list(axes), effort.tolist(), self.sample.brakes_open.tolist()))

    def refusal(self) -> str:
        return self.forbidden

    def sdo(self, axis: int) -> Objects:
        return self.objects[axis]

    def resume_ticks(self) -> None:
        self.log.append("ticks again")


def holding(machine: Machine) -> Callable[[Sample], np.ndarray]:
    """Hold with the number of the tick, so that each is told from the others."""

    def hold(sample: Sample) -> np.ndarray:
        assert sample is machine.sample
        return np.array([machine.ticks, 0.0, -1.0])

    return hold


@pytest.fixture
def machine() -> Machine:
    return Machine()


# ---- states


def test_drives_are_led_one_transition_a_tick_and_armed_when_all_are_enabled(machine: Machine) -> None:
    machine.inputs[2].statusword = READY
    power_and_brakes.reach(machine, State.OPERATION_ENABLED, [0, 2], holding(machine))
    assert machine.log == [
        *((0, 0, "disarmed"), (0, 2, "disarmed")),
        *((0, 0, 0x06), (0, 2, 0x07), (1, 0, 0x07), (1, 2, 0x0F), (2, 0, 0x0F), (2, 2, 0x0F), (3, 0, 0x0F), (3, 2, 0x0F)),
        *((3, 0, "armed"), (3, 2, "armed")),
    ]
    assert machine.commands == [[0.0, 0.0, -1.0], [1.0, 0.0, -1.0], [2.0, 0.0, -1.0]], "the holding command acts all the time"
    assert [each.statusword for each in machine.inputs] == [ENABLED, OFF, ENABLED]


def test_drives_that_are_led_out_of_operation_are_not_armed(machine: Machine) -> None:
    machine.inputs[1].statusword = ENABLED
    power_and_brakes.reach(machine, State.SWITCH_ON_DISABLED, [1], holding(machine))
    assert machine.inputs[1].statusword == OFF
    assert (1, 1, "armed") not in machine.log


def test_a_state_that_no_controlword_leaves_is_waited_in_for_two_seconds(machine: Machine) -> None:
    machine.inputs[0].statusword = machine.inputs[1].statusword = 0x006  # a pattern that the standard gives to no state
    machine.at = lambda tick: setattr(machine.inputs[0], "statusword", ENABLED) if tick == 2 * SECOND else None
    with pytest.raises(BusTimeoutError) as refused:
        power_and_brakes.reach(machine, State.OPERATION_ENABLED, [0, 1], holding(machine))
    assert machine.ticks == 2 * SECOND + 1
    assert str(refused.value) == (
        "not operation enabled within 2.0 s: roll_drive is undefined (0006h); is its power stage supplied, is safe torque off released?"
    )
    assert not any("armed" in entry for entry in machine.log), "neither is armed"


def test_all_drives_that_stay_are_named(machine: Machine) -> None:
    machine.stuck = {0, 2}
    with pytest.raises(BusTimeoutError, match=r"2\.0 s: propeller_drive is switch on disabled.*; tilt_drive is switch on disabled.*; is"):
        power_and_brakes.reach(machine, State.OPERATION_ENABLED, [0, 1, 2], holding(machine))


@pytest.mark.parametrize("fault", [FAULT, REACTING])
def test_a_drive_that_falls_into_a_fault_on_its_way_ends_it_with_its_cause(machine: Machine, fault: int) -> None:
    machine.emergencies = {2: "EMCY 3210h: DC link overvoltage"}
    machine.at = lambda tick: setattr(machine.inputs[1], "statusword", fault) if tick == 2 else None
    with pytest.raises(DeviceFaultError, match=r"^roll_drive \(node 2\): fault.* \(02..h\); EMCY 3210h: DC link overvoltage$"):
        power_and_brakes.reach(machine, State.OPERATION_ENABLED, [0, 1], holding(machine))
    assert machine.ticks == 2


# ---- faults


def test_a_drive_without_a_fault_is_left_alone(machine: Machine) -> None:
    power_and_brakes.reset_fault(machine, 1)
    assert (machine.log, machine.ticks, machine.notes) == ([(0, 1, "disarmed")], 0, ("before",))


@pytest.mark.parametrize(("emergency", "was"), [("EMCY 8130h: heartbeat lost", "EMCY 8130h: heartbeat lost"), ("", r"fault \(0208h\)")])
def test_a_fault_that_a_rising_edge_clears_is_noted(machine: Machine, emergency: str, was: str) -> None:
    machine.emergencies = {2: emergency}
    machine.inputs[1].statusword = FAULT
    machine.at = lambda tick: setattr(machine.inputs[1], "statusword", OFF) if tick == 1 else None
    power_and_brakes.reset_fault(machine, 1)
    assert machine.log == [(0, 1, "disarmed"), (0, 1, 0x80), (2, 1, 0x00)]
    assert machine.commands == [[0.0, 0.0, 0.0]] * 4
    assert machine.notes[0] == "before"
    assert len(machine.notes) == 2
    assert machine.notes[1] == f"roll_drive (node 2): was in fault, {was}; it was reset".replace("\\", "")


def test_a_fault_has_a_second_to_clear(machine: Machine) -> None:
    for clears_at, gone in ((SECOND, True), (SECOND + 3, False)):
        slow = Machine()
        slow.inputs[0].statusword = REACTING

        def clear(tick: int, slow: Machine = slow, clears_at: int = clears_at) -> None:
            slow.inputs[0].statusword = OFF if tick >= clears_at else FAULT

        slow.at = clear
        if gone:
            power_and_brakes.reset_fault(slow, 0)
            assert "was in fault, fault reaction active (020Fh)" in slow.notes[1]
        else:
            power_and_brakes.reset_fault(slow, 0)  # by the second edge
            assert [entry for entry in slow.log if entry[2] == 0x80] == [(0, 0, 0x80), (SECOND + 2, 0, 0x80)]
        assert slow.log[1:3] == [(0, 0, 0x80), (SECOND, 0, 0x00)]
        assert slow.ticks == (SECOND + 2 if gone else SECOND + 2 + 2 + 2)


def test_a_fault_that_two_resets_do_not_clear_is_refused(machine: Machine) -> None:
    machine.inputs[0].statusword = FAULT
    with pytest.raises(DeviceFaultError, match=r"; 2 fault resets did not clear it within 1\.0 s each: remove its cause$"):
        power_and_brakes.reset_fault(machine, 0)
    assert machine.notes == ("before",)
    assert machine.ticks == 2 * (SECOND + 2)


def test_a_fault_that_comes_back_at_once_is_not_reset(machine: Machine) -> None:
    machine.inputs[0].statusword = FAULT
    machine.at = lambda tick: setattr(machine.inputs[0], "statusword", FAULT if tick % 4 == 0 else OFF)
    machine.objects[0].objects[0x603F] = (0x3210).to_bytes(2, "little")
    with pytest.raises(DeviceFaultError, match=r"^propeller_drive \(node 1\): fault \(0208h\); error code 3210h: .*; 2 fault resets"):
        power_and_brakes.reset_fault(machine, 0)


def test_an_error_code_is_read_with_the_table_of_the_drives_vendor_and_may_be_absent(machine: Machine) -> None:
    machine.inputs[0].statusword = FAULT
    machine.objects[0].objects[0x603F] = (0x8A82).to_bytes(2, "little")
    known = power_and_brakes.fault_words(machine, 0)
    machine.drives[0].identity.vendor_id = 1
    assert power_and_brakes.fault_words(machine, 0) != known
    del machine.objects[0].objects[0x603F]
    assert power_and_brakes.fault_words(machine, 0) == "propeller_drive (node 1): fault (0208h); error code 0000h: no error"


# ---- modes


def test_a_mode_that_is_shown_already_is_not_asked_for(machine: Machine) -> None:
    machine.objects[1].objects[0x6061] = 10
    power_and_brakes.set_mode(machine, 1, Mode.CYCLIC_SYNCHRONOUS_TORQUE)
    assert machine.modes == [Mode.HOMING, Mode.CYCLIC_SYNCHRONOUS_TORQUE, Mode.HOMING]
    assert machine.objects[1].log == []
    assert machine.log == [], "no time has passed"


@pytest.mark.parametrize("after_s", [0.0, 2.0**-5, 1.0 + 2.0**-7])
def test_a_mode_is_awaited_and_the_ticks_go_on_after_it(machine: Machine, after_s: float) -> None:
    machine.objects[1].shown_after_s = after_s
    power_and_brakes.set_mode(machine, 1, Mode.CYCLIC_SYNCHRONOUS_TORQUE)
    assert machine.objects[1].log == [(0x6060, 0, 10), *["waits"] * round(after_s * 128)]
    assert machine.modes == [Mode.HOMING, Mode.CYCLIC_SYNCHRONOUS_TORQUE, Mode.HOMING]
    assert machine.log == ["ticks again"]


def test_a_mode_that_is_not_shown_within_a_second_is_refused_and_no_mode_is_known(machine: Machine) -> None:
    machine.objects[1].objects[0x6061], machine.objects[1].shown_after_s = 6, 1.0 + 2.0**-6
    with pytest.raises(
        MotionRefusedError, match=r"^roll_drive \(node 2\): stays in mode 6, mode 10 \(cyclic synchronous torque\) was asked for$"
    ):
        power_and_brakes.set_mode(machine, 1, Mode.CYCLIC_SYNCHRONOUS_TORQUE)
    assert machine.modes == [Mode.HOMING, None, Mode.HOMING]
    assert machine.log == []


def test_a_drive_without_voltage_may_show_no_mode_for_seconds_and_the_ticks_go_on(machine: Machine) -> None:
    objects = machine.objects[1]
    objects.objects[0x6061], objects.shown_after_s = -1, np.inf
    machine.at = lambda tick: objects.objects.update({0x6061: 10}) if tick == 4 * SECOND else None
    power_and_brakes.set_mode(machine, 1, Mode.CYCLIC_SYNCHRONOUS_TORQUE)
    assert machine.ticks == 4 * SECOND
    assert machine.commands[-1] == [0.0, 0.0, 0.0]
    assert machine.modes[1] is Mode.CYCLIC_SYNCHRONOUS_TORQUE


@pytest.mark.parametrize(("statusword", "said"), [(OFF, r"shows no mode \(-1\) for 10 s"), (QUICK, "stays in mode -1")])
def test_a_drive_that_shows_no_mode_for_longer_or_has_voltage_is_refused(machine: Machine, statusword: int, said: str) -> None:
    machine.objects[1].objects[0x6061], machine.objects[1].shown_after_s = -1, np.inf
    machine.inputs[1].statusword = statusword
    with pytest.raises(MotionRefusedError, match=rf"^roll_drive \(node 2\): {said}, mode 10 "):
        power_and_brakes.set_mode(machine, 1, Mode.CYCLIC_SYNCHRONOUS_TORQUE)
    assert machine.ticks == (10 * SECOND + 1 if statusword == OFF else 0)


# ---- brakes


def test_brakes_of_the_axes_asked_for_open_after_a_twentieth_of_a_second_of_holding(machine: Machine) -> None:
    machine.braked, machine.follows_after = {1, 2}, 10
    power_and_brakes.open_brakes(machine, [0, 2], holding(machine))
    assert machine.log == [(13, {"tilt": True})]  # 13 ticks are the first whole ones of 0.05 s
    assert machine.sample.brakes_open.tolist() == [False, False, True]
    assert machine.commands == [[float(k), 0.0, -1.0] for k in range(23)]


def test_brakes_close_at_once_under_the_holding_command(machine: Machine) -> None:
    machine.sample.brakes_open[:] = True
    machine.follows_after = 5
    power_and_brakes.close_brakes(machine, [0, 1], holding(machine))
    assert machine.log == [(0, {"propeller": False, "roll": False})]
    assert machine.sample.brakes_open.tolist() == [False, False, True]
    assert machine.commands == [[float(k), 0.0, -1.0] for k in range(5)]


def test_axes_without_a_brake_have_none_to_wait_for(machine: Machine) -> None:
    machine.braked = set()
    power_and_brakes.close_brakes(machine, [0, 1], holding(machine))
    power_and_brakes.open_brakes(machine, [0, 1], holding(machine))
    assert machine.log == []
    assert machine.ticks == 13, "the drives hold before whatever comes next"


@pytest.mark.parametrize(("move", "word", "held"), [("open_brakes", "open", 13), ("close_brakes", "closed", 0)])
def test_a_feedback_that_does_not_follow_within_a_second_is_refused_with_all_that_do_not(
    machine: Machine, move: str, word: str, held: int
) -> None:
    machine.sample.brakes_open[:] = word == "closed"
    machine.follows_after = SECOND
    getattr(power_and_brakes, move)(machine, [0, 1, 2], holding(machine))
    late = Machine()
    late.sample.brakes_open[:] = word == "closed"
    late.follows_after = SECOND + 2
    late.at = lambda tick: late.sample.brakes_open.__setitem__(1, word == "open")
    with pytest.raises(
        MotionRefusedError,
        match=rf"^brake of propeller, tilt: not {word} within 1\.0 s by its feedback; check brake, relay and input$",
    ):
        getattr(power_and_brakes, move)(late, [0, 1, 2], holding(late))
    assert late.ticks == held + SECOND + 1


def test_axes_come_to_rest_with_the_effort_that_held_them_when_their_brakes_had_closed(machine: Machine) -> None:
    machine.sample.brakes_open[:] = True
    machine.follows_after = 3
    power_and_brakes.come_to_rest(machine, [0, 1], holding(machine))
    assert machine.log == [(0, {"propeller": False, "roll": False}), (3, [0, 1], [3.0, 0.0, -1.0], [False, False, True])]


# ---- ticks


def test_a_duration_is_whole_ticks_that_are_no_shorter_and_one_at_least(machine: Machine) -> None:
    durations = (0.0, PERIOD_S, 1.001 * PERIOD_S, 1.0)
    assert [power_and_brakes.ticks_in(machine, seconds) for seconds in durations] == [1, 1, 2, SECOND]
    power_and_brakes.run_for(machine, 2.5 * PERIOD_S, holding(machine))
    assert machine.commands == [[0.0, 0.0, -1.0], [1.0, 0.0, -1.0], [2.0, 0.0, -1.0]]


def test_a_tick_hands_out_its_sample_and_refuses_in_the_words_of_who_forbids(machine: Machine) -> None:
    zero = np.zeros(3)
    assert power_and_brakes.tick(machine, zero) is machine.sample
    machine.seen = "roll: moves by +0.1 rad with its brake closed"
    with pytest.raises(MotionRefusedError, match=r"^roll: moves by \+0\.1 rad with its brake closed$"):
        power_and_brakes.tick(machine, zero)
    machine.forbidden = "the door is open"
    with pytest.raises(MotionRefusedError, match=r"^the door is open$"):
        power_and_brakes.tick(machine, zero)
    machine.sample.fault = "roll_drive (node 2): EMCY 2310h"
    with pytest.raises(DeviceFaultError, match=r"^roll_drive \(node 2\): EMCY 2310h$"):
        power_and_brakes.tick(machine, zero)
