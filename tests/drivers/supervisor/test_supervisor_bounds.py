"""The supervisor's parts at their bounds, with numbers that floating point holds exactly."""

from __future__ import annotations

import statistics
import struct
from collections.abc import Sequence
from dataclasses import replace

import pytest
from bench_machines import CARM
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.pdo import PdoCodec
from drivers.settings import BusSettings, Pdo
from drivers.supervisor import laws as rules
from drivers.supervisor.laws import Entry
from drivers.supervisor.memory import axis_of, encoder_of
from drivers.supervisor.supervisor import NMT_RESET, NMT_STOP, Supervisor

assert CARM.bus is not None
PERIOD_S, COUNT, SPEED, TRACKING = 2.0**-8, 2.0**-16, 0.25, 2.0**-5
FASTEST = rules.SPEED_MARGIN * SPEED
LARGEST_STEP = int(FASTEST * PERIOD_S / COUNT + rules.COUNTS)  # counts: 96 and the flicker
STATUS, POSITION, LINK, CONTROL, TORQUE = (0x6041, 0, 16), (0x6064, 0, 32), (0x6004, 0, 32), (0x6040, 0, 16), (0x6071, 0, 16)
ON, OFF, QUICK_STOP = 0x1637, 0x1633, 0x1617
SYNC, SENT, ASKED = 0x80, 0x181, 0x201


def settings(**changes: object) -> BusSettings:
    """One axis with a link encoder."""
    assert CARM.bus is not None
    node = replace(
        CARM.bus.nodes[0],
        node_id=1,
        tpdos=(Pdo(1, SENT, 1, (STATUS, POSITION)), Pdo(2, 0x281, 1, (LINK,))),
        rpdos=(Pdo(1, ASKED, 1, (CONTROL, TORQUE)),),
    )
    scaling = replace(
        CARM.bus.scalings[0], position_resolution=COUNT, link_resolution=COUNT, link_zero_counts=0, sign=1, rated=4.0, limit=8.0
    )
    motion = replace(CARM.bus.motions[0], lower=-1.0, upper=1.0, speed=SPEED, tracking_error=TRACKING)
    whole = replace(
        CARM.bus,
        sync_cob_id=SYNC,
        sync_period_s=PERIOD_S,
        nodes=(node,),
        scalings=(scaling,),
        motions=(motion,),
        master_heartbeat_period_s=0.125,
    )
    return replace(whole, **changes)  # type: ignore[arg-type]


class Line:
    """A supervisor, and frames to it."""

    def __init__(self, of: BusSettings | None = None) -> None:
        self.supervisor = Supervisor(of or settings())
        self.time_s = 1.0

    def sync(self, seconds: float = PERIOD_S) -> None:
        self.time_s += seconds
        self.supervisor.frame(self.time_s, SYNC, b"")

    def sent(self, position: int, link: int, status: int = ON) -> None:
        self.supervisor.frame(self.time_s, SENT, struct.pack("<Hi", status, position))
        self.supervisor.frame(self.time_s, 0x281, struct.pack("<i", link))

    def tick(self, position: int = 0, link: int | None = None, status: int = ON) -> bool:
        self.sync()
        self.sent(position, position if link is None else link, status)
        return self.supervisor.check(self.time_s)


def told_by(entries: Sequence[tuple[int, int, int]], data: bytes) -> dict[int, int]:
    """Return what a supervisor takes from a frame of a drive that maps these objects."""
    supervisor = Supervisor(settings(nodes=(replace(settings().nodes[0], tpdos=(Pdo(1, SENT, 1, tuple(entries)),)),)))
    supervisor.frame(1.0, SENT, data)
    (axis,) = supervisor._axes
    read = {index: encoder.counts for index, encoder in ((0x6064, axis.motor), (0x6004, axis.link)) if encoder.was_read}
    return read | ({0x6041: axis.statusword} if axis.statusword >= 0 else {})


@given(st.lists(st.sampled_from([8, 16, 32]), min_size=1, max_size=4).filter(lambda bits: sum(bits) <= 64), st.data())
def test_what_a_frame_tells_is_what_the_codec_packs(bits: list[int], data: st.DataObject) -> None:
    indices = data.draw(
        st.lists(st.sampled_from([0x6041, 0x6064, 0x6004, 0x6071, 0x6077]), min_size=len(bits), max_size=len(bits), unique=True)
    )
    entries = [(index, 0, width) for index, width in zip(indices, bits, strict=True)]
    codec = PdoCodec.of(entries)
    values = [
        data.draw(st.integers(-(1 << width - 1), (1 << width - 1) - 1) if signed else st.integers(0, (1 << width) - 1))
        for width, signed in zip(codec.bits, codec.signed, strict=True)
    ]
    packed = codec.pack(*values)
    for length in range(len(packed) + 1):
        whole = {index for k, index in enumerate(indices) if sum(bits[: k + 1]) <= 8 * length} & {0x6041, 0x6064, 0x6004}
        expected = {index: value for index, value in zip(indices, values, strict=True) if index in whole}
        assert told_by(entries, packed[:length]) == expected


def encoder(furthest: float = TRACKING) -> Entry:
    """One that was not read."""
    return encoder_of(COUNT, replace(settings().motions[0], tracking_error=furthest))


def take(of: Entry, counts: int, bits: int = 32, took_s: float = PERIOD_S) -> None:
    """Let it be read so long after the reading before."""
    rules.take_reading(of, of.seen_at_s + took_s, counts, 1 << bits - 1, PERIOD_S)


@pytest.mark.parametrize("bits", [16, 32])
@pytest.mark.parametrize("step", [1, -1, 90, -90])
@pytest.mark.parametrize("where", [0, -1, 0.5])
def test_an_encoder_counts_over_its_wrap(bits: int, step: int, where: float) -> None:
    turned = encoder()
    assert (turned.moved, rules.speed(turned), turned.too_fast_steps, turned.jumped) == (0.0, 0.0, 0, False)
    at = int(where * (1 << bits))
    for number in range(20):
        take(turned, (at + number * step) & (1 << bits) - 1, bits)
    assert turned.moved == 19 * step * COUNT
    assert rules.speed(turned) == (step * COUNT / PERIOD_S if abs(step) > rules.COUNTS else 0.0)
    assert turned.too_fast_steps == 0


def test_three_steps_of_five_beyond_the_largest_are_too_fast() -> None:
    turned, at = encoder(), 0
    take(turned, at)
    for step, fast in ((98, False), (99, False), (99, False), (98, False), (99, True), (0, True), (0, False), (0, False)):
        at += step
        take(turned, at)
        assert (turned.too_fast_steps > rules.SPEED_STEPS // 2) is fast, at
    assert LARGEST_STEP == 98


def test_a_step_is_a_jump_beyond_four_times_the_largest() -> None:
    turned = encoder(furthest=1.0)
    take(turned, 0)
    most = int(rules.JUMP * FASTEST * PERIOD_S / COUNT + rules.COUNTS)
    take(turned, most)
    assert (turned.jumped, turned.moved) == (False, most * COUNT)
    take(turned, 2 * most + 1)
    assert (turned.jumped, turned.moved) == (True, most * COUNT)


def test_speed_needs_three_steps_and_is_the_median_of_the_last_five() -> None:
    turned, at = encoder(), 0
    for number, step in enumerate((0, 10, 20, 30, 40, 50)):
        at += step
        take(turned, at, took_s=2.0 * PERIOD_S)
        middle = (0.0, 0.0, 0.0, 20.0, 25.0, 30.0)[number]
        assert rules.speed(turned) == middle * COUNT / (2.0 * PERIOD_S)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=32), min_size=1, max_size=5), st.integers(0, 4))
def test_a_median_is_that_of_the_library(values: list[float], more: int) -> None:
    assert rules.median([*values, *[0.0] * more], len(values)) == statistics.median(values)


def test_what_is_beyond_sixteen_bits_of_torque_is_cut() -> None:
    assert CARM.bus is not None
    strong = replace(settings().scalings[0], rated=1.0, limit=1000.0)
    assert axis_of(strong, settings().motions[0], 1.0, PERIOD_S).torque_permille == 32767


def test_readings_are_a_period_apart_at_least() -> None:
    for took_s, counted_s in ((0.0, PERIOD_S), (0.5 * PERIOD_S, PERIOD_S), (-PERIOD_S, PERIOD_S), (2.0 * PERIOD_S, 2.0 * PERIOD_S)):
        turned = encoder()
        for k in range(4):
            take(turned, 16 * k, took_s=took_s)
        assert rules.speed(turned) == 16 * COUNT / counted_s


@pytest.mark.parametrize("way", [1, -1])
def test_encoders_may_be_the_tracking_error_apart(way: int) -> None:
    line, apart = Line(), int(TRACKING / COUNT)
    for position in range(0, apart + 1, 64):
        assert line.tick(way * position, 0)
    assert line.tick(way * apart, 0)
    assert not line.tick(way * (apart + 1), 0)


@pytest.mark.parametrize("way", [1, -1])
def test_an_axis_may_be_the_tracking_error_out_of_range(way: int) -> None:
    line = Line()
    edge = int((1.0 + TRACKING) / COUNT)
    for position in range(edge - 64 * 10, edge + 1, 64):
        assert line.tick(way * position)
    assert not line.tick(way * (edge + 32))


def test_a_link_at_its_limit_moves_inwards() -> None:
    line = Line()
    for position in range(int(1.0 / COUNT) + 600, int(1.0 / COUNT) - 1, -50):
        assert line.tick(position)


def test_bounds_of_time_belong_to_what_is_allowed() -> None:
    line = Line()
    assert line.tick()
    silent_s = rules.SYNC_SILENT_PERIODS * 0.125
    assert line.supervisor.check(line.time_s + silent_s)
    assert not line.supervisor.check(line.time_s + silent_s + 2.0**-20)
    assert line.supervisor.commands(line.time_s + silent_s) == []
    assert line.supervisor.commands(line.time_s + silent_s + 2.0**-20) == [(NMT_STOP, 1)]


def test_a_second_producer_is_judged_over_all_its_syncs() -> None:
    line = Line()
    line.tick()
    line.sync(1.0)  # before: is not counted
    for _ in range(rules.FAST_SYNCS - 1):
        line.sync(rules.FAST_SHARE * PERIOD_S)
        line.sent(0, 0)
        assert line.supervisor.check(line.time_s)
    line.sync(rules.FAST_SHARE * PERIOD_S)
    assert line.supervisor.check(line.time_s)
    line.sync(0.5 * PERIOD_S)
    assert not line.supervisor.check(line.time_s)
    assert line.supervisor.reason == "SYNC comes faster than it may: a second producer"
    assert line.supervisor.commands(line.time_s + rules.OBEYED_S) == []


def moving(line: Line, speed: int, ticks: int, at: int = 0) -> int:
    """Let the axis move by so many counts a tick, and return where it is."""
    for _ in range(ticks):
        at += speed
        line.tick(at)
    return at


OBEYED = int(rules.OBEYED_S / PERIOD_S)


def test_who_asked_is_named_and_when() -> None:
    line = Line()
    at = moving(line, 90, 10)
    line.supervisor.io(line.time_s, False, True)
    at = moving(line, 90, OBEYED, at)
    assert line.supervisor.reason == ""
    moving(line, 90, 1, at)
    assert line.supervisor.reason == "propeller: it is still led 0.2 s after hold-to-run or the door asked for a stop"
    assert line.supervisor.commands(line.time_s) == [(NMT_STOP, 1)]


def test_an_axis_that_goes_on_is_stopped_by_its_network_after_its_time() -> None:
    line = Line()
    at = moving(line, 50, 10)
    line.supervisor.refuse(line.time_s, "a reason")
    refused_s = line.time_s
    assert line.supervisor.commands(refused_s) == []  # from here on it should stand
    at = moving(line, 1, int(TRACKING / COUNT), at)
    assert line.supervisor.commands(line.time_s) == []
    assert line.supervisor.commands(refused_s + rules.OBEYED_S) == []
    at = moving(line, 1, 1, at)
    assert line.supervisor.commands(refused_s + rules.OBEYED_S) == []
    assert line.supervisor.commands(line.time_s) == [(NMT_STOP, 1)]
    assert line.supervisor.commands(line.time_s + 0.999 * rules.NMT_EVERY_S) == []
    line.tick(at, status=QUICK_STOP)
    assert line.supervisor.commands(line.time_s + rules.NMT_EVERY_S) == []  # what holds is left to hold
    line.tick(at)
    assert line.supervisor.commands(line.time_s + 2.0 * rules.NMT_EVERY_S) == [], "from here it is led anew"
    moving(line, 50, int(TRACKING / COUNT / 50) + 1, at)
    assert line.supervisor.commands(line.time_s + 3.0 * rules.NMT_EVERY_S) == [(NMT_STOP, 1)]


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("begins", [0, 64])
def test_a_hold_may_miss_its_way_by_the_tracking_error_and_a_half(way: int, begins: int) -> None:
    line = Line(settings(motions=(replace(settings().motions[0], acceleration=SPEED, quick_stop=2.0 * SPEED),)))
    at = moving(line, way * begins, 10)
    line.tick(at, status=QUICK_STOP)
    most = int(rules.HOLD_MARGIN * TRACKING / COUNT)
    speed = begins * COUNT / PERIOD_S
    for tick in range(1, 400):
        ramp_s = min(tick * PERIOD_S, speed / SPEED)
        beyond = int((ramp_s * (speed - 0.5 * SPEED * ramp_s)) / COUNT)
        line.tick(at + way * (beyond + min(8 * tick, most)), status=QUICK_STOP)
    assert line.supervisor.reason == ""
    line.tick(at + way * (beyond + most + 2), status=QUICK_STOP)
    assert line.supervisor.reason.startswith("propeller: its drive does not hold it, as its ")
    assert line.supervisor.commands(line.time_s) == [(NMT_RESET, 1)]


def test_a_hold_may_go_back_from_its_furthest_place_by_as_much() -> None:
    line, most = Line(), int(rules.HOLD_MARGIN * TRACKING / COUNT)
    at = moving(line, 64, 10)
    for _ in range(10):
        at += 32
        line.tick(at, status=QUICK_STOP)
    for back in range(0, most, 48):
        line.tick(at - back, status=QUICK_STOP)
    line.tick(at - most, status=QUICK_STOP)
    assert line.supervisor.reason == ""
    line.tick(at - most - 1, status=QUICK_STOP)
    assert line.supervisor.reason != ""


def test_a_counter_that_is_set_begins_a_hold_anew() -> None:
    line = Line()
    for _ in range(20):
        line.tick(0, status=QUICK_STOP)
    for _ in range(20):
        line.tick(1 << 20, 0, status=QUICK_STOP)
    assert line.supervisor.reason == ""


def test_a_drive_that_is_reset_and_pushes_on_is_reset_again() -> None:
    line, at, resets = Line(), 0, 0
    for _ in range(400):
        at += 60
        line.tick(at, status=QUICK_STOP)
        resets += line.supervisor.commands(line.time_s) == [(NMT_RESET, 1)]
    assert resets >= 2


def test_a_drive_in_quick_stop_holds_while_both_encoders_stand_and_are_told() -> None:
    line = Line()
    line.tick(status=ON)
    assert line.supervisor.torque == "torque on"
    line.tick(status=QUICK_STOP)
    assert line.supervisor.torque == "held"
    for motor, link in ((10, 0), (0, 10)):
        for number in range(1, 6):
            line.tick(number * motor, number * link, QUICK_STOP)
        assert line.supervisor.torque == "torque on"
        for _ in range(5):
            line.tick(number * motor, number * link, QUICK_STOP)
        assert line.supervisor.torque == "held"
    for silent in range(1, rules.SPEED_STEPS + 1):
        line.sync()
        assert line.supervisor.torque == ("held" if silent < rules.SPEED_STEPS else "torque on")
    line.tick(status=OFF)
    assert line.supervisor.torque == "no torque"


def test_an_axis_whose_brake_is_open_is_watched_without_torque() -> None:
    line = Line()
    line.tick(0, status=OFF)
    at = 0
    for brake_open in (False, True):
        line.supervisor.io(line.time_s, True, True, [brake_open])
        for _ in range(10):
            at += 110
            line.tick(at, status=OFF)
        assert line.supervisor.reason.startswith("propeller: its motor shows") is brake_open


def test_nothing_is_permitted_between_sessions_and_each_begins_with_what_it_sees() -> None:
    line = Line()
    assert line.supervisor.torque == "unknown"
    line.tick()
    assert line.supervisor.torque == "torque on"
    line.supervisor.end()
    assert (line.supervisor.reason, line.supervisor.answer(line.time_s, 1)) == ("no bench runs", None)
    line.supervisor.begin()
    assert line.supervisor.torque == "unknown"
    assert line.supervisor.answer(line.time_s + 100.0, 1) is not None


def test_syncs_that_came_while_it_was_held_up_are_no_second_producer() -> None:
    line = Line()
    for _ in range(2):
        for _ in range(rules.FAST_SYNCS - 1):
            line.sync(0.1 * PERIOD_S)
            line.sent(0, 0)
            assert line.supervisor.check(line.time_s)
        line.supervisor.held_up()
    line.supervisor.held_up()


def test_an_effort_beside_a_target_position_is_limited_too() -> None:
    node = settings().nodes[0]
    target, offset = (0x607A, 0, 32), (0x60B2, 0, 16)
    line = Line(settings(nodes=(replace(node, rpdos=(Pdo(1, ASKED, 1, (CONTROL, target, offset)),)),)))
    line.tick()
    line.supervisor.frame(line.time_s, ASKED, struct.pack("<Hih", 15, 1000, -2000))
    assert line.supervisor.reason == ""
    line.supervisor.frame(line.time_s, ASKED, struct.pack("<Hih", 15, 0, -2001))
    assert line.supervisor.reason == "propeller: a torque of -2001 per mille was asked for, 2000 are allowed"


def led(mode: str, sign: int = 1) -> Line:
    """A supervisor of a drive that is led to positions, at count 1000 with its link at 1/8 rad."""
    node, scaling = settings().nodes[0], settings().scalings[0]
    pdo = Pdo(1, ASKED, 1, (CONTROL, (0x607A, 0, 32)))
    line = Line(settings(nodes=(replace(node, rpdos=(pdo,)),), scalings=(replace(scaling, mode=mode, sign=sign),)))
    line.sync()
    line.sent(1000, int(0.125 / COUNT))
    return line


def asked(line: Line, target: int) -> str:
    line.supervisor.frame(line.time_s, ASKED, struct.pack("<Hi", 15, (target + 2**31) % 2**32 - 2**31))
    return line.supervisor.reason


LEAD = int((SPEED * rules.LEAD_S + TRACKING) / COUNT)


@pytest.mark.parametrize("way", [1, -1])
def test_a_cyclic_target_position_leads_by_a_second_at_the_speed_limit_at_most(way: int) -> None:
    assert asked(led("position"), 1000 + way * LEAD) == ""
    words = f"propeller: a way of {way * (LEAD + 1)} counts was asked for, {LEAD} are allowed"
    assert asked(led("position"), 1000 + way * (LEAD + 1)) == words


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("way", "room"), [(1, 1.0 - 0.125 + TRACKING), (-1, 1.0 + 0.125 + TRACKING)])
def test_a_set_point_of_a_profile_is_within_the_range_by_the_link(sign: int, way: int, room: float) -> None:
    there = int(room / COUNT)
    assert asked(led("profile_position", sign), 1000 + sign * way * there) == ""
    assert "a way of" in asked(led("profile_position", sign), 1000 + sign * way * (there + 1))


@pytest.mark.parametrize("way", [1, -1])
def test_a_set_point_of_a_profile_is_as_far_as_the_range_is_wide_where_no_link_encoder_tells(way: int) -> None:
    node, there = replace(settings().nodes[0], rpdos=(Pdo(1, ASKED, 1, (CONTROL, (0x607A, 0, 32))),)), int((2.0 + TRACKING) / COUNT)

    def line() -> Line:
        scaling = replace(settings().scalings[0], mode="profile_position", link_resolution=0.0)
        found = Line(settings(nodes=(node,), scalings=(scaling,)))
        found.tick(1000)
        return found

    assert asked(line(), 1000 + way * there) == ""
    assert "a way of" in asked(line(), 1000 + way * (there + 1))


def test_a_target_that_an_enabled_drive_was_not_newly_asked_for_is_none() -> None:
    line = led("position")
    line.sent(1000, int(0.125 / COUNT), OFF)
    assert asked(line, 1000 + 2 * LEAD) == ""
    line.sent(1000, int(0.125 / COUNT), ON)
    assert asked(line, 1000 + 2 * LEAD) == "", "a drive that homes is enabled, and keeps the target of before"
    assert asked(line, 1001 + 2 * LEAD) != ""


def test_before_a_position_has_come_no_way_is_known() -> None:
    node, status = settings().nodes[0], Pdo(1, SENT, 1, (STATUS,))
    asks = Pdo(1, ASKED, 1, (CONTROL, (0x607A, 0, 32)))
    line = Line(
        settings(nodes=(replace(node, tpdos=(status,), rpdos=(asks,)),), scalings=(replace(settings().scalings[0], mode="position"),))
    )
    line.supervisor.frame(line.time_s, SENT, struct.pack("<H", ON))
    assert asked(line, 2**30) == ""


def test_the_way_to_a_target_is_the_shorter_one_over_the_end_of_the_counter() -> None:
    line = led("position")
    for step in (0x7FFF_FFF0, 0x7FFF_FFF0):
        line.sent(step, int(0.125 / COUNT))
    assert asked(line, 0x7FFF_FFF0 + LEAD) == ""


def test_a_reason_has_a_time_whatever_it_is() -> None:
    line = Line()
    line.tick()
    line.supervisor.frame(line.time_s, ASKED, struct.pack("<Hh", 15, 2001))
    assert line.supervisor.reason == "propeller: a torque of 2001 per mille was asked for, 2000 are allowed"
    assert line.supervisor.commands(line.time_s + rules.OBEYED_S) == []
    silent = Line()
    silent.tick()
    while not silent.supervisor.reason:
        silent.sync()
        silent.supervisor.check(silent.time_s)
    assert silent.supervisor.reason == "propeller: its drive sends no position while it has torque or the brake is open"
    assert silent.supervisor.commands(silent.time_s + rules.OBEYED_S) == []


def test_a_speed_is_told_with_what_is_allowed() -> None:
    line = Line()
    moving(line, 110, 10)
    assert line.supervisor.reason == "propeller: its motor shows more than the 0.38 rad/s allowed in most of its last 5 readings"


def test_a_frame_that_lacks_a_byte_says_nothing() -> None:
    assert told_by((STATUS, POSITION), bytes(5)) == {0x6041: 0}
    assert told_by((STATUS, POSITION), bytes(6)) == {0x6041: 0, 0x6064: 0}


def test_a_counter_that_is_half_its_range_away_was_set() -> None:
    turned = encoder()
    take(turned, 0)
    take(turned, 1 << 31)
    assert (turned.jumped, turned.moved) == (True, 0.0)


def test_a_drive_that_was_never_heard_has_as_long_as_any() -> None:
    line = Line()
    line.supervisor.io(line.time_s, True, True, [True])
    for _ in range(int(rules.SYNC_SILENT_PERIODS * 0.125 / PERIOD_S)):
        line.sync()
        assert line.supervisor.check(line.time_s)
    line.sync()
    assert not line.supervisor.check(line.time_s)


def test_a_field_whose_last_bits_are_missing_says_nothing() -> None:
    entries = ((0x6041, 0, 48), (0x6064, 0, 12))
    assert 0x6064 not in told_by(entries, bytes(7))
    assert told_by(entries, bytes(8))[0x6064] == 0


def test_an_axis_that_moves_on_after_the_session_is_stopped_by_its_network() -> None:
    line = Line()
    at = moving(line, 50, 10)
    line.supervisor.end()
    assert line.supervisor.commands(line.time_s) == []  # from here on it should stand
    moving(line, 50, int(TRACKING / COUNT / 50) + 1, at)
    assert line.supervisor.commands(line.time_s) == [(NMT_STOP, 1)]


def test_a_supervisor_that_was_held_up_knows_the_last_sync() -> None:
    line = Line()
    line.tick()
    line.supervisor.held_up()
    assert not line.supervisor.check(line.time_s + 1.0)


@pytest.mark.parametrize("zero", [0, 0x5000])
def test_a_link_encoder_counts_to_half_its_range_both_ways(zero: int) -> None:
    axis = axis_of(replace(settings().scalings[0], link_zero_counts=zero), settings().motions[0], 1.0, PERIOD_S)
    for counts in (0x6000, -0x6000, 0x7FFF, -0x8000):
        rules.take_link_position(axis, 1.0, (zero + counts) & 0xFFFF, 1 << 15)
        assert axis.link_at == counts * COUNT


def test_a_loop_has_its_whole_time_to_stop_an_axis() -> None:
    line = Line()
    at = moving(line, 50, 10)
    line.supervisor.refuse(0.0, "a reason")
    assert line.supervisor.commands(rules.OBEYED_S) == []
    moving(line, 50, int(TRACKING / COUNT / 50) + 1, at)
    assert line.supervisor.commands(rules.OBEYED_S) == []
    assert line.supervisor.commands(rules.OBEYED_S + 1e-9) == [(NMT_STOP, 1)]


def test_every_axis_has_limits() -> None:
    with pytest.raises(ValueError, match="shorter"):
        Supervisor(settings(motions=()))
