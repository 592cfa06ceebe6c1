"""What the supervisor permits, by frames that are put together here: positions, torques, SYNCs and states of the I/O."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest
from bench_machines import CARM, carm_text_in

from drivers.canopen.pdo import PdoCodec
from drivers.settings import BusSettings
from drivers.supervisor import laws as rules
from drivers.supervisor.supervisor import NMT_RESET, NMT_STOP, Supervisor
from hil.machine import machine_from_text

assert CARM.bus is not None
SETTINGS = CARM.bus
PERIOD_S = SETTINGS.sync_period_s
ROLL = CARM.axis_index("roll")
LIMITS, SCALING = SETTINGS.motions[ROLL], SETTINGS.scalings[ROLL]
OPERATION_ENABLED, SWITCHED_ON, QUICK_STOP_ACTIVE, FAULT_REACTION = 0x1637, 0x1633, 0x1617, 0x163F
FASTEST = rules.SPEED_MARGIN * LIMITS.speed


class Machine:
    """Roll as its devices tell it; propeller stands without torque."""

    def __init__(self, settings: BusSettings = SETTINGS) -> None:
        self.supervisor = Supervisor(settings)
        self.settings = settings
        self.time_s = 0.0
        self.motor = self.link = 0.0  # rad of roll, beside where the counters began
        self.status = OPERATION_ENABLED
        self.torque = self.torque_offset = self.velocity = self.measured = 0
        self.silent = False
        self.encoder_counts = 0  # added to the motor side's counter

    def tick(self, seconds: float = PERIOD_S) -> bool:
        """Let one SYNC and its answers pass; return whether motion is permitted then."""
        self.time_s += seconds
        self.supervisor.frame(self.time_s, self.settings.sync_cob_id, b"")
        for node in self.settings.nodes:
            for pdo in node.rpdos if node.axis == "roll" else ():
                asked = {0x6040: 15, 0x6071: self.torque, 0x60B2: self.torque_offset, 0x60FF: self.velocity}
                self.supervisor.frame(self.time_s, pdo.cob_id, self._packed(pdo.entries, asked))
            if self.silent and node.role == "drive":
                continue
            for pdo in node.tpdos:
                self.supervisor.frame(self.time_s, pdo.cob_id, self._packed(pdo.entries, self._values(node.axis)))
        return self.supervisor.check(self.time_s)

    def ticks(self, number: int) -> bool:
        """Let so many pass."""
        return all([self.tick() for _ in range(number)])

    def move(self, speed: float, seconds: float) -> bool:
        """Let both encoders of roll move."""
        permitted = True
        for _ in range(round(seconds / PERIOD_S)):
            self.motor += speed * PERIOD_S
            self.link += speed * PERIOD_S
            permitted = self.tick()
        return permitted

    def _values(self, axis: str) -> dict[int, int]:
        if axis != "roll":
            return {0x6041: SWITCHED_ON, 0x6064: 0, 0x6004: SETTINGS.scalings[0].link_zero_counts}
        return {
            0x6041: self.status,
            0x6064: self.encoder_counts + round(SCALING.sign * self.motor / SCALING.position_resolution),
            0x6004: round(self.link / SCALING.link_resolution) + self.settings.scalings[ROLL].link_zero_counts,
            0x6078: self.measured,
        }

    @staticmethod
    def _packed(entries: tuple[tuple[int, int, int], ...], values: dict[int, int]) -> bytes:
        codec = PdoCodec.of(entries)
        wrapped = []
        for (index, _, bits), signed in zip(entries, codec.signed, strict=True):
            value = values.get(index, 0) & (1 << bits) - 1
            wrapped.append(value - (1 << bits) if signed and value >> bits - 1 else value)
        return codec.pack(*wrapped)


@pytest.fixture
def machine() -> Machine:
    """One that has had torque for a while, and stands."""
    machine = Machine()
    assert machine.ticks(20)
    return machine


def test_a_machine_that_moves_as_it_may_is_permitted(machine: Machine) -> None:
    assert machine.move(0.99 * FASTEST, 0.2)
    assert machine.move(-0.99 * FASTEST, 0.4)
    assert machine.ticks(50)
    assert machine.supervisor.answer(machine.time_s, 1) is not None
    assert machine.supervisor.commands(machine.time_s) == []


def test_an_axis_that_is_too_fast_is_not(machine: Machine) -> None:
    assert not machine.move(1.05 * FASTEST, 0.1)
    assert "roll: its motor shows more than the" in machine.supervisor.reason
    assert machine.supervisor.answer(machine.time_s, 1) is None


def test_a_link_that_is_too_fast_is_not(machine: Machine) -> None:
    for _ in range(10):
        machine.link -= 1.05 * FASTEST * PERIOD_S
        machine.tick()
    assert "roll: its link shows more than the" in machine.supervisor.reason


@pytest.mark.parametrize("steps", [1, 2])
def test_a_step_or_two_of_a_damaged_reading_are_no_speed(machine: Machine, steps: int) -> None:
    for _ in range(steps):
        machine.motor += 1.5 * FASTEST * PERIOD_S
        assert machine.tick()
    assert machine.ticks(10)


def test_a_counter_that_is_set_is_no_motion(machine: Machine) -> None:
    machine.encoder_counts += 1_000_000
    assert machine.ticks(10)
    machine.encoder_counts = 0
    assert machine.ticks(10)


def test_a_counter_that_wraps_is_no_motion() -> None:
    machine = Machine()
    machine.encoder_counts = (1 << 31) - 50
    assert machine.ticks(10)
    assert machine.move(SCALING.sign * 0.1, 0.1)


def test_held_up_frames_are_a_period_apart(machine: Machine) -> None:
    for _ in range(20):
        machine.motor += 0.9 * LIMITS.speed * PERIOD_S
        machine.link += 0.9 * LIMITS.speed * PERIOD_S
        machine.tick(1e-5 if machine.supervisor.check(machine.time_s) else PERIOD_S)
    assert "shows more than" not in machine.supervisor.reason


def test_frames_that_were_lost_are_no_speed(machine: Machine) -> None:
    machine.motor += 5.0 * LIMITS.speed * PERIOD_S
    machine.link += 5.0 * LIMITS.speed * PERIOD_S
    assert machine.tick(5.0 * PERIOD_S)
    assert machine.ticks(10)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_encoders_that_part_are_seen(machine: Machine, side: float) -> None:
    for _ in range(200):
        machine.motor += side * 0.01 * LIMITS.tracking_error
        machine.tick()
        if abs(machine.motor) <= 0.98 * LIMITS.tracking_error:
            assert not machine.supervisor.reason
    assert f"roll: its encoders are {'+' if side > 0 else '-'}" in machine.supervisor.reason


def test_encoders_are_compared_from_torque_on() -> None:
    machine = Machine()
    machine.status = SWITCHED_ON
    for _ in range(200):
        machine.motor += 0.01 * LIMITS.tracking_error
        assert machine.tick()
    machine.status = OPERATION_ENABLED
    assert machine.ticks(20)


@pytest.mark.parametrize(("edge", "way"), [(LIMITS.upper, 1.0), (LIMITS.lower, -1.0)])
def test_an_axis_that_leaves_its_range_is_stopped_and_may_come_back(edge: float, way: float) -> None:
    machine = Machine()
    machine.link = machine.motor = edge + way * (0.9 * LIMITS.tracking_error)
    assert machine.ticks(10)
    machine.link += way * 0.2 * LIMITS.tracking_error
    machine.motor += way * 0.2 * LIMITS.tracking_error
    assert machine.ticks(10)  # it stands there
    assert machine.move(-way * 0.02, 0.1)
    assert not machine.move(way * 0.05, 1.0)
    assert "out of its range and moving on" in machine.supervisor.reason


def test_too_much_torque_is_refused_at_once(machine: Machine) -> None:
    most = round(1000.0 * SCALING.limit / SCALING.rated)
    machine.torque = -most
    assert machine.tick()
    machine.torque = -most - 1
    assert not machine.tick()
    assert f"a torque of {-most - 1} per mille was asked for, {most} are allowed" in machine.supervisor.reason


@pytest.mark.parametrize("mode", ["velocity", "position"])
@pytest.mark.parametrize("way", [1, -1])
def test_a_drive_with_loops_of_its_own_is_asked_for_no_more_either(mode: str, way: int) -> None:
    settings = machine_from_text(carm_text_in(mode)).bus
    assert settings is not None
    machine = Machine(settings)
    most = round(1000.0 * SCALING.limit / SCALING.rated)
    machine.torque_offset = way * most
    machine.velocity = way * math.floor(FASTEST / SCALING.position_resolution)
    assert machine.ticks(20)
    machine.torque_offset += way
    assert not machine.tick()
    assert f"a torque of {way * (most + 1)} per mille was asked for" in machine.supervisor.reason
    machine.supervisor.begin()
    machine.torque_offset = 0
    machine.velocity += way
    assert machine.tick() is (mode == "position")
    assert mode == "position" or f"roll: a velocity of {machine.velocity} counts/s was asked for" in machine.supervisor.reason


def test_a_velocity_in_rpm_of_the_motor_is_held_against_the_same_limit() -> None:
    settings = machine_from_text(carm_text_in("velocity").replace('mode = "velocity"', 'mode = "velocity"\nvelocity_unit = "rpm"')).bus
    assert settings is not None
    machine = Machine(settings)
    machine.velocity = math.floor(FASTEST * 500 / (2.0 * math.pi) * 60)
    assert machine.ticks(20)
    machine.velocity += 1
    assert not machine.tick()


def test_a_sync_that_stops_while_a_drive_has_torque(machine: Machine) -> None:
    allowed_s = max(rules.SYNC_SILENT_PERIODS * SETTINGS.master_heartbeat_period_s, rules.SILENT_AT_LEAST_S)
    assert machine.supervisor.check(machine.time_s + 0.99 * allowed_s)
    assert not machine.supervisor.check(machine.time_s + 1.01 * allowed_s)
    assert "no SYNC for" in machine.supervisor.reason
    assert machine.supervisor.commands(machine.time_s + 1.01 * allowed_s) == [(NMT_STOP, 2)]


@pytest.mark.parametrize("status", [QUICK_STOP_ACTIVE, FAULT_REACTION])
def test_a_drive_that_stops_has_torque(machine: Machine, status: int) -> None:
    machine.status = status
    machine.move(0.1, 0.1)
    assert machine.supervisor.torque == "torque on"
    machine.ticks(10)
    assert machine.supervisor.torque == "held"
    assert not machine.supervisor.check(machine.time_s + 10.0)


def test_a_machine_without_torque_may_be_silent(machine: Machine) -> None:
    machine.status = SWITCHED_ON
    machine.tick()
    assert machine.supervisor.torque == "no torque"
    assert machine.supervisor.check(machine.time_s + 100.0)


def test_a_heartbeat_is_no_sync(machine: Machine) -> None:
    """Whoever sends the bench's heartbeat in its place keeps the drives' own watch content, not the supervisor."""
    for _ in range(100):
        machine.time_s += PERIOD_S
        machine.supervisor.frame(machine.time_s, 0x700 + SETTINGS.master_node_id, b"\x05")
        machine.supervisor.check(machine.time_s)
    assert "no SYNC for" in machine.supervisor.reason


def test_a_second_sync_producer_is_seen(machine: Machine) -> None:
    for _ in range(rules.FAST_SYNCS + 1):
        machine.tick(0.5 * PERIOD_S)
    assert "second producer" in machine.supervisor.reason


def test_syncs_after_a_pause_are_no_second_producer(machine: Machine) -> None:
    assert machine.ticks(rules.FAST_SYNCS)
    machine.tick(0.05)
    for _ in range(12):  # that were held up meanwhile
        assert machine.tick(0.01 * PERIOD_S)
    assert machine.ticks(rules.FAST_SYNCS)


def test_a_drive_with_torque_that_sends_no_position(machine: Machine) -> None:
    machine.silent = True
    silent_s = max(rules.SYNC_SILENT_PERIODS * SETTINGS.master_heartbeat_period_s, rules.SILENT_AT_LEAST_S)
    assert machine.ticks(int(silent_s / PERIOD_S))
    assert not machine.ticks(2)
    assert "sends no position while" in machine.supervisor.reason


@pytest.mark.parametrize("released", [(False, True), (True, False)])
def test_a_release_ends_the_permission_in_its_round_and_for_the_session(machine: Machine, released: tuple[bool, bool]) -> None:
    machine.supervisor.io(machine.time_s, True, True)
    assert machine.supervisor.answer(machine.time_s, 1) is not None
    machine.supervisor.io(machine.time_s, *released)
    assert machine.supervisor.answer(machine.time_s, 1) is None
    assert machine.supervisor.reason == "", "the loop sees it itself"
    machine.supervisor.io(machine.time_s, True, True)
    assert not machine.ticks(1)
    machine.supervisor.begin()
    assert machine.ticks(2)


def test_a_release_while_nothing_has_torque_ends_nothing(machine: Machine) -> None:
    machine.status = SWITCHED_ON
    machine.tick()
    machine.supervisor.io(machine.time_s, False, True, [False, False])
    assert machine.tick()
    machine.supervisor.io(machine.time_s, False, True, [False, True])
    assert not machine.tick(), "with a brake open it does"


@pytest.mark.parametrize("sides", [("motor", "link"), ("motor",), ("link",)])
def test_an_axis_that_is_led_on_after_a_release_is_told_and_cut_off(machine: Machine, sides: tuple[str, ...]) -> None:
    machine.move(0.1, 0.5)
    machine.supervisor.io(machine.time_s, False, True)
    released_s = machine.time_s
    while not machine.supervisor.commands(machine.time_s):
        for side in sides:
            setattr(machine, side, getattr(machine, side) + LIMITS.speed * PERIOD_S)
        machine.tick()
    assert machine.time_s - released_s <= max(rules.OBEYED_S, LIMITS.tracking_error / LIMITS.speed) + 3.0 * PERIOD_S
    led = f"it is still led {machine.time_s - released_s:.1f} s after hold-to-run or the door asked"
    assert (led if len(sides) > 1 else "apart") in machine.supervisor.reason


def test_an_axis_that_was_stopped_after_a_release_may_be_proven(machine: Machine) -> None:
    assert machine.move(LIMITS.speed, 0.5)
    machine.supervisor.io(machine.time_s, False, True)
    machine.status, speed = QUICK_STOP_ACTIVE, LIMITS.speed
    while speed > 0.0:
        machine.move(speed, PERIOD_S)
        speed -= 1.2 * LIMITS.acceleration * PERIOD_S
    machine.ticks(50)
    machine.status = OPERATION_ENABLED
    machine.ticks(10)
    machine.motor += 0.5 * LIMITS.tracking_error  # the push
    machine.link += 0.5 * LIMITS.tracking_error
    machine.ticks(300)
    assert machine.supervisor.reason == ""
    assert machine.supervisor.commands(machine.time_s) == []


def test_a_question_for_a_stop_ends_the_permission_and_must_be_obeyed(machine: Machine) -> None:
    machine.supervisor.ask_to_stop(machine.time_s, "`isocenter stop`")
    assert machine.supervisor.answer(machine.time_s, 1) is None
    machine.supervisor.ask_to_stop(machine.time_s + 10.0, "somebody later")
    machine.move(0.5 * LIMITS.speed, 3.0 * rules.OBEYED_S)
    assert "after `isocenter stop` asked for a stop" in machine.supervisor.reason


def test_a_loop_that_does_not_stop_its_axes_is_taken_the_network(machine: Machine) -> None:
    machine.move(1.2 * FASTEST, 0.1)
    assert machine.supervisor.reason
    machine.move(1.2 * FASTEST, 0.3 * rules.OBEYED_S)
    assert machine.supervisor.commands(machine.time_s) == []
    machine.move(1.2 * FASTEST, 0.7 * rules.OBEYED_S)
    assert machine.supervisor.commands(machine.time_s) == [(NMT_STOP, 2)]


def test_a_loop_that_stops_its_axes_keeps_the_network(machine: Machine) -> None:
    machine.move(1.2 * FASTEST, 0.1)
    machine.status = QUICK_STOP_ACTIVE
    machine.move(0.2 * LIMITS.speed, 0.2)
    machine.ticks(500)
    assert machine.supervisor.reason
    assert machine.supervisor.commands(machine.time_s) == []


# ---- a drive that is to hold ----------------------------------------------------------------------------
def stopping(machine: Machine, speed: float, acceleration: float, seconds: float, *, side: str = "both", rests: bool = True) -> None:
    """Let roll go on with this speed and acceleration, to rest or for ever, its drive told to hold it."""
    machine.status, now = QUICK_STOP_ACTIVE, speed
    for _ in range(round(seconds / PERIOD_S)):
        for each in ("motor", "link") if side == "both" else (side,):
            setattr(machine, each, getattr(machine, each) + now * PERIOD_S)
        machine.tick()
        slower = now + acceleration * PERIOD_S
        now = 0.0 if rests and slower * speed <= 0.0 else slower


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("speed", [0.0, 0.2, 1.0])
def test_a_stop_within_the_limit_of_acceleration_is_left_to_its_drive(machine: Machine, sign: float, speed: float) -> None:
    machine.move(sign * speed, 0.2)
    stopping(machine, sign * speed, -sign * LIMITS.acceleration, 3.0)
    assert machine.supervisor.reason == ""
    assert machine.supervisor.commands(machine.time_s) == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("push", [3.0, -3.0])
@pytest.mark.parametrize("speed", [0.0, 1.0])
@pytest.mark.parametrize("status", [QUICK_STOP_ACTIVE, FAULT_REACTION])
def test_a_drive_that_pushes_is_reset(machine: Machine, sign: float, push: float, speed: float, status: int) -> None:
    machine.move(sign * speed, 0.2)
    stopping(machine, sign * speed, sign * push, 0.8, rests=False)
    assert re.fullmatch("roll: its drive does not hold it, as its (motor|link) shows; its voltage is taken", machine.supervisor.reason)
    assert machine.supervisor.commands(machine.time_s) == [(NMT_RESET, 2)]
    assert machine.supervisor.commands(machine.time_s + 0.99 * rules.NMT_EVERY_S) == []
    machine.status = 0x0650  # it has booted
    machine.ticks(100)
    assert machine.supervisor.commands(machine.time_s) == []


@pytest.mark.parametrize("side", ["motor", "link"])
def test_either_encoder_shows_a_drive_that_pushes(machine: Machine, side: str) -> None:
    stopping(machine, 0.0, 1.0, 0.5, side=side, rests=False)
    assert f"as its {side} shows" in machine.supervisor.reason or "apart" in machine.supervisor.reason
    assert machine.supervisor.commands(machine.time_s) == [(NMT_RESET, 2)]


def test_an_axis_that_creeps_under_its_drive_is_held_where_it_is(machine: Machine) -> None:
    stopping(machine, 5e-4, 0.0, 1.2 * rules.HOLD_MARGIN * LIMITS.tracking_error / 5e-4)
    assert machine.supervisor.reason == ""
    stopping(machine, 1e-2, 0.0, 1.5 * rules.HOLD_MARGIN * LIMITS.tracking_error / 1e-2)
    assert "does not hold it" in machine.supervisor.reason


def seen_after(status: int, effort_A: float, most_A: float, seconds: float, jumps_s: float = math.inf) -> tuple[float, Machine]:
    """Let a drive in a state give this effort while roll stands; return after how long that was no hold, NaN: it was to the end.

    Its counter is set elsewhere every `jumps_s`.
    """
    motions = [replace(limits, holding_effort=most_A) for limits in SETTINGS.motions]
    machine = Machine(replace(SETTINGS, motions=tuple(motions)))
    machine.ticks(20)
    machine.status, machine.measured = status, round(SCALING.sign * effort_A / SCALING.rated * 1000.0)
    for number in range(round(seconds / PERIOD_S)):
        if jumps_s < math.inf and number % round(jumps_s / PERIOD_S) == 0:
            machine.encoder_counts += 1_000_000
        machine.tick()
        if "does not hold it" in machine.supervisor.reason:
            return number * PERIOD_S, machine
    return math.nan, machine


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("status", [QUICK_STOP_ACTIVE, FAULT_REACTION])
def test_a_drive_that_holds_with_more_effort_than_any_pose_takes_is_reset_after_the_loop_may_have_acted(sign: float, status: int) -> None:
    after_s, machine = seen_after(status, sign * 8.0, 4.0, 20.0)
    ramp_s = LIMITS.speed / LIMITS.acceleration
    assert after_s == pytest.approx(ramp_s + 7.5 * math.log(2.0), abs=0.03), "a low pass of one and a half times the loop's 5 s"
    assert machine.supervisor.reason == "roll: its drive does not hold it, as its effort shows; its voltage is taken"
    assert machine.supervisor.commands(machine.time_s) == [(NMT_RESET, 2)]
    machine.ticks(round(5.0 / PERIOD_S))
    assert machine.supervisor.commands(machine.time_s) == [], "it is given as long again"
    machine.ticks(round(2.0 / PERIOD_S))
    assert machine.supervisor.commands(machine.time_s) == [(NMT_RESET, 2)]


def test_the_effort_of_a_hold_is_judged_in_a_hold_and_where_there_is_a_limit() -> None:
    assert math.isnan(seen_after(QUICK_STOP_ACTIVE, 3.99, 4.0, 15.0)[0])
    assert math.isnan(seen_after(QUICK_STOP_ACTIVE, 8.0, math.inf, 9.0)[0])
    assert math.isnan(seen_after(OPERATION_ENABLED, 8.0, 4.0, 9.0)[0])


def test_a_counter_that_jumps_hides_no_effort() -> None:
    after_s, machine = seen_after(QUICK_STOP_ACTIVE, 8.0, 4.0, 20.0, jumps_s=3.0)
    assert after_s == pytest.approx(LIMITS.speed / LIMITS.acceleration + 7.5 * math.log(2.0), abs=0.03)
    assert "as its effort shows" in machine.supervisor.reason


def test_the_effort_of_a_motion_does_not_count_for_the_hold_behind_it() -> None:
    motions = [replace(limits, holding_effort=4.0) for limits in SETTINGS.motions]
    machine = Machine(replace(SETTINGS, motions=tuple(motions)))
    machine.torque = machine.measured = 1600
    machine.ticks(round(15.0 / PERIOD_S))
    machine.status, machine.measured = QUICK_STOP_ACTIVE, 600
    machine.ticks(round(2.0 / PERIOD_S))
    assert machine.supervisor.reason == ""


# ---- torque that was not asked for ---------------------------------------------------------------------
@pytest.mark.parametrize("sign", [1, -1])
def test_a_drive_that_measures_more_than_it_was_asked_for_is_seen_within_ticks(machine: Machine, sign: int) -> None:
    machine.torque = sign * 1100
    machine.measured = sign * (1100 + rules.EFFORT_OFF)
    assert machine.ticks(50)
    machine.measured += sign
    assert machine.ticks(2)
    assert not machine.tick()
    gives = sign * (1100 + rules.EFFORT_OFF + 1)
    assert machine.supervisor.reason == f"roll: its drive measures a torque of {gives} per mille, {sign * 1100} was asked for"


def test_a_drive_that_pushes_the_other_way_is_seen(machine: Machine) -> None:
    machine.torque, machine.measured = 300, -rules.EFFORT_OFF - 1
    assert not machine.ticks(4)


def test_a_drive_that_follows_late_or_saturates_is_believed(machine: Machine) -> None:
    machine.torque = 1200
    machine.ticks(20)
    machine.torque, machine.measured = -1200, 1200
    assert machine.ticks(rules.SPEED_STEPS)
    machine.measured = 0
    assert machine.ticks(50), "what is less than was asked for does not push"


def test_a_drive_that_is_not_led_by_torques_gives_what_it_needs(machine: Machine) -> None:
    machine.torque, machine.measured = 100, 1500
    machine.supervisor.frame(machine.time_s, 0x602, b"\x2f\x60\x60\x00\x06\0\0\0")
    assert machine.ticks(50), "it homes"
    machine.supervisor.frame(machine.time_s, 0x602, b"\x2f\x60\x60\x00\x0a\0\0\0")
    assert not machine.ticks(50), "it is led again"
    machine.supervisor.begin()
    machine.status = QUICK_STOP_ACTIVE
    assert machine.ticks(50), "it stops by itself"
    own = machine_from_text(carm_text_in("velocity")).bus
    assert own is not None
    beside = Machine(own)
    beside.torque_offset, beside.measured = 100, 1500
    assert beside.ticks(50), "its own loops add to it"


def test_the_first_reason_stays_and_a_session_begins_anew(machine: Machine) -> None:
    machine.supervisor.refuse(machine.time_s, "the first")
    machine.supervisor.refuse(machine.time_s, "the second")
    assert machine.supervisor.reason == "the first"
    assert not machine.tick()
    machine.supervisor.begin()
    assert machine.ticks(10)


def test_short_frames_and_those_of_others_say_nothing(machine: Machine) -> None:
    for node in SETTINGS.nodes:
        for pdo in (*node.tpdos, *node.rpdos):
            machine.supervisor.frame(machine.time_s, pdo.cob_id, b"")
    machine.supervisor.frame(machine.time_s, 0x7E5, b"\x01\x02")
    assert machine.ticks(10)


def test_an_axis_without_a_link_encoder_has_no_range() -> None:
    without = replace(SETTINGS, scalings=tuple(replace(scaling, link_resolution=0.0) for scaling in SETTINGS.scalings))
    machine = Machine(without)
    assert machine.ticks(10)
    assert machine.move(0.5 * LIMITS.speed, 1.0)
    assert not machine.move(1.1 * FASTEST, 0.1)


def test_without_a_heartbeat_of_the_bench_silence_is_short() -> None:
    machine = Machine(replace(SETTINGS, master_heartbeat_period_s=0.0))
    assert machine.ticks(10)
    assert machine.supervisor.check(machine.time_s + 0.99 * rules.SILENT_AT_LEAST_S)
    assert not machine.supervisor.check(machine.time_s + 1.01 * rules.SILENT_AT_LEAST_S)


@pytest.mark.parametrize("zero", [0, 5, -5])
def test_an_absolute_encoder_that_wraps_within_the_range(zero: int) -> None:
    wrapping = replace(SETTINGS, scalings=tuple(replace(scaling, link_zero_counts=zero) for scaling in SETTINGS.scalings))
    for way in (1.0, -1.0):
        machine = Machine(wrapping)
        assert machine.ticks(10)
        assert machine.move(way * LIMITS.speed, 1.5)
        assert not machine.move(way * LIMITS.speed, 3.0)
        assert "out of its range" in machine.supervisor.reason


def test_before_the_first_sync_nothing_is_silent() -> None:
    machine = Machine()
    for node in SETTINGS.nodes:
        for pdo in node.tpdos:
            machine.supervisor.frame(0.0, pdo.cob_id, machine._packed(pdo.entries, machine._values(node.axis)))
    assert machine.supervisor.torque == "torque on"
    assert machine.supervisor.check(100.0)


@pytest.mark.parametrize("role", ["drive", "encoder"])
def test_what_comes_behind_the_objects_that_a_frame_maps_tells_nothing(machine: Machine, role: str) -> None:
    assert machine.supervisor.torque == "torque on"
    for node in SETTINGS.nodes:
        for pdo in node.tpdos if node.role == role and node.axis == "roll" else ():
            data = machine._packed(pdo.entries, machine._values("roll"))
            for behind in (b"\0", b"\xff\xff"):
                machine.supervisor.frame(machine.time_s, pdo.cob_id, data + behind)
    assert machine.supervisor.torque == "torque on"
    assert machine.supervisor.check(machine.time_s)
    assert machine.move(0.2, 1.0)
