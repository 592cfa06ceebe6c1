"""The laws by which the supervisor judges, one a function, over the entries of its memory (`memory.py`).

Every entry is changed in place. A law that finds something ends the permission by `refuse`, with its number and two values for its words.
The functions are plain Python; `hil.bench.compiled_supervising` makes machine code of the same text. So they use what both know: numbers,
fields of entries, loops.
"""

from __future__ import annotations

from math import copysign, inf, isfinite, nan
from typing import Any, TypeAlias

Entry: TypeAlias = Any
"""An entry of the memory with its fields as attributes. No checker knows the fields."""
Entries: TypeAlias = Any
"""A list, or a structured array, of them."""

SYNC_SILENT_PERIODS = 2.5
"""Periods of the bench's heartbeat without a SYNC: what the drives allow the heartbeat. A foreign heartbeat does not replace a SYNC."""
SILENT_AT_LEAST_S = 0.05
FAST_SHARE = 0.75  # of its period, after which SYNC comes too early
FAST_SYNCS = 64
"""SYNCs in a row, on average too early, that are a second producer: a supervisor that was held up for 50 ms finds a dozen together."""
SPEED_MARGIN = 1.5
"""Multiple of its speed limit that an axis may reach: the reference keeps to the limit, excitation adds to it."""
SPEED_STEPS = 5  # SYNCs over which speed is the median: a drive that sets its counter, and a damaged frame, make one step
JUMP = 4.0
"""Multiple of the highest speed that is a counter which was set, not a motion; a step by the tracking error is one, too."""
COUNTS = 2.0  # of an encoder, by which a position may flicker
LEAD_S = 1.0
"""Time at the speed limit by which a cyclic target position may lead: a position loop follows by the reciprocal of its gain."""
EFFORT_OFF = 300  # per mille of the rated torque beyond all that was asked for: current sensors of drives are off by a tenth of it
OBEYED_S = 0.15  # from the end of the permission to the command to a drive's communication to stop: a loop that works takes three SYNCs
HOLD_MARGIN = 1.5  # multiple of the tracking error by which a drive may miss what a hold is: the loop judges by the tracking error itself
HELD_AFRESH_S, CREEP_S = 5.0, 50.0  # after which an axis is held where it is that takes so long for its tracking error: own loops creep
PUSHED_S = 7.5
"""Time constant of the effort of a hold, half as long again as that of a loop, which then has taken the voltage itself."""
NMT_EVERY_S = 0.1  # between two commands of its own: somebody may go on commanding
WRITES_MODE, TORQUE_MODE = 0x00_6060_2F, 10  # an SDO request that chooses the mode of operation that follows: a drive may home
_MOST = SPEED_STEPS // 2  # of the last steps that may be wrong: more than these are most of them
_TORQUE_ON = 0x04  # of the statusword: the drive may apply torque, in operation enabled, quick stop and fault reaction active
_ENABLED_MASK, _ENABLED = 0x6F, 0x27  # of a statusword in operation enabled; a drive with torque in another state is to hold

# What a field of a frame says.
SYNC, ASKED_TORQUE, ASKED_VELOCITY, ASKED_WAY, MODE, STATUS, EFFORT, POSITION, LINK_POSITION = range(9)
ASKS = (ASKED_TORQUE, ASKED_VELOCITY, ASKED_WAY)

# What was found first; the words of each are the supervisor's. `SAID`: somebody else found it, and said so in words.
NOTHING, SAID = range(2)
NO_SYNC, FAST_SYNC, TORQUE, VELOCITY, WAY, NO_POSITION, TORQUE_OFF, MOTOR_FAST = range(2, 10)
LINK_FAST, APART, OUT_OF_RANGE, NOT_HELD_BY_EFFORT, NOT_HELD_BY_MOTOR, NOT_HELD_BY_LINK, LED_ON = range(10, 17)

# What is asked of the supervisor beside taking frames.
TAKE, CHECK, COMMAND = range(3)


def judged(machine: Entry, axes: Entries, question: int, time_s: float) -> bool:
    """Check, or find what to command, where that is the question; return whether motion is permitted."""
    if question == CHECK:
        check(machine, axes, time_s)
    elif question == COMMAND:
        command(machine, axes, time_s)
    return bool(machine.ended_at_s == inf)


def refuse(machine: Entry, time_s: float, law: int, axis: int, much: float, most: float) -> None:
    """Take the permission back; what was found first stays."""
    if machine.law == NOTHING:
        machine.law, machine.axis, machine.much, machine.most = law, axis, much, most
    machine.ended_at_s = min(machine.ended_at_s, time_s)


# ---- what frames say ------------------------------------------------------------------------------------
def take_frame(machine: Entry, axes: Entries, fields: Entries, place: int, length: int, word: int, time_s: float) -> None:
    """Take a frame of so many bytes, which are the number `word`, by its fields from `place` on; those it is too short for say nothing."""
    while True:
        field = fields[place]
        if length >= field.length:
            axis, kind = axes[field.axis], field.kind
            value = (word >> field.shift & field.mask ^ field.sign) - field.sign
            if kind == POSITION:
                take_position(axis, time_s, value, field.half)
            elif kind == STATUS:
                take_status(axis, time_s, value)
            elif kind == EFFORT:
                take_effort(axis, time_s, value)
            elif kind == LINK_POSITION:
                take_link_position(axis, time_s, value, field.half)
            elif kind == ASKED_TORQUE:
                take_asked_torque(machine, axis, time_s, value)
            elif kind == SYNC:
                take_sync(machine, axes, time_s)
            elif kind == ASKED_VELOCITY:
                take_asked_velocity(machine, axis, time_s, value)
            elif kind == ASKED_WAY:
                take_asked_position(machine, axis, time_s, value, field.half)
            elif word & 0xFFFF_FFFF == WRITES_MODE:
                axis.mode = value
                return
        if field.is_last:
            return
        place += 1


def take_sync(machine: Entry, axes: Entries, time_s: float) -> None:
    """Take a SYNC, which every drive answers with a position."""
    machine.newest_sync = (machine.newest_sync + 1) % (FAST_SYNCS + 1)
    machine.sync_s[machine.newest_sync] = time_s
    machine.syncs = min(machine.syncs + 1, FAST_SYNCS + 1)
    for axis in axes:
        axis.unanswered += 1


def take_asked_torque(machine: Entry, axis: Entry, time_s: float, permille: int) -> None:
    """Take a torque that is asked for: no more than the axis may have."""
    axis.newest_torque = (axis.newest_torque + 1) % SPEED_STEPS
    axis.torques[axis.newest_torque] = permille
    if abs(permille) > axis.torque_permille:
        refuse(machine, time_s, TORQUE, axis.number, float(permille), float(axis.torque_permille))


def take_asked_velocity(machine: Entry, axis: Entry, time_s: float, value: int) -> None:
    """Take a velocity that is asked for: no more than the axis may have."""
    counts_s = value * axis.counts_per_unit
    if abs(counts_s) > axis.fastest_counts_s:
        refuse(machine, time_s, VELOCITY, axis.number, counts_s, axis.fastest_counts_s)


def take_asked_position(machine: Entry, axis: Entry, time_s: float, counts: int, half: int) -> None:
    """Take a position that is asked for: a new one is no further from an enabled drive than it may go, or may lead."""
    is_new = not (axis.was_asked and counts == axis.target)
    axis.was_asked, axis.target = True, counts
    if is_new and axis.is_enabled:
        way, room = way_to(axis.motor, counts, half), LEAD_S * axis.speed
        if axis.goes_by_profile:
            room = axis.upper - axis.link_at if axis.sign * way > 0.0 else axis.link_at - axis.lower
            if not isfinite(room):  # where no link encoder tells
                room = axis.upper - axis.lower
        most = (room + axis.tracking_error) / axis.motor.resolution
        if abs(way) > most:
            refuse(machine, time_s, WAY, axis.number, way, most)


def take_status(axis: Entry, time_s: float, word: int) -> None:
    """Take a statusword; from the moment at which torque is on, the encoders count from zero."""
    if word == axis.statusword:
        return
    powered, enabled = word & _TORQUE_ON != 0, word & _ENABLED_MASK == _ENABLED
    holds = powered and not enabled
    if (powered and not axis.is_powered) or (holds and not axis.holds):
        hold_axis(axis, time_s, not axis.is_powered)
    axis.statusword, axis.is_powered, axis.is_enabled, axis.holds = word, powered, enabled, holds


def take_effort(axis: Entry, time_s: float, permille: int) -> None:
    """Take a measured torque: a drive in torque mode gives no more than was asked for, one that holds no more than some pose takes."""
    if time_s - axis.since_s > axis.ramp_s:
        axis.pushed += (permille - axis.pushed) * axis.period_s / PUSHED_S
    off = permille if axis.is_enabled and axis.mode == TORQUE_MODE and not was_asked(axis, permille) else 0
    if off or axis.off_steps:
        axis.newest_off = (axis.newest_off + 1) % SPEED_STEPS
        axis.off_steps += (1 if off else 0) - (1 if axis.off[axis.newest_off] else 0)
        axis.off[axis.newest_off] = off


def was_asked(axis: Entry, permille: int) -> bool:
    """Whether a measured torque is none, or any of those asked for last was as much or more that way, both but for the sensor's error."""
    is_asked = abs(permille) <= EFFORT_OFF
    for asked in axis.torques:
        is_asked = is_asked or (asked >= permille - EFFORT_OFF if permille > 0 else asked <= permille + EFFORT_OFF)
    return is_asked


def take_position(axis: Entry, time_s: float, counts: int, half: int) -> None:
    """Take a position of the drive; a counter that was set says nothing of the effort."""
    take_reading(axis.motor, time_s, counts, half, axis.period_s)
    axis.unanswered = 0
    if axis.motor.jumped:
        count_anew(axis, time_s, True)


def take_link_position(axis: Entry, time_s: float, counts: int, half: int) -> None:
    """Take a position of the link encoder."""
    take_reading(axis.link, time_s, counts, half, axis.period_s)
    axis.link_at = axis.link.resolution * ((counts - axis.link_zero_counts + half) % (2 * half) - half)


# ---- an encoder -----------------------------------------------------------------------------------------
def take_reading(encoder: Entry, time_s: float, counts: int, half: int, period_s: float) -> None:
    """Take a reading; frames that were held up come together, but were sampled a period apart."""
    if encoder.was_read:
        took_s = time_s - encoder.seen_at_s
        if took_s < period_s:
            took_s = period_s
        step = encoder.resolution * way_to(encoder, counts, half)
        beyond, fastest_step = abs(step) - COUNTS * encoder.resolution, encoder.fastest * took_s
        is_fast = 1 if beyond > fastest_step else 0
        encoder.jumped = beyond > JUMP * encoder.fastest * took_s or beyond > encoder.furthest
        if not encoder.jumped:
            encoder.moved += step
        newest = (encoder.newest + 1) % SPEED_STEPS
        encoder.too_fast_steps += is_fast - encoder.too_fast[newest]
        encoder.too_fast[newest], encoder.steps[newest], encoder.speeds[newest] = is_fast, step, step / took_s
        encoder.newest, encoder.readings = newest, max(encoder.readings, newest + 1)
    encoder.was_read, encoder.counts, encoder.seen_at_s = True, counts, time_s


def way_to(encoder: Entry, counts: int, half: int) -> float:
    """Return how many counts the last reading is away, the shorter way round; NaN before there is one."""
    return float((counts - encoder.counts + half) % (2 * half) - half) if encoder.was_read else nan


def speed(encoder: Entry) -> float:
    """Return the median over the last steps [rad/s or m/s], 0 before there are so many, and where it is a flicker."""
    if encoder.readings <= _MOST or abs(median(encoder.steps, encoder.readings)) <= COUNTS * encoder.resolution:
        return 0.0
    return median(encoder.speeds, encoder.readings)


def median(values: Entries, number: int) -> float:
    """Return the median of the first so many values: the one, or the mean of the two, with as many before as behind them in order."""
    low = high = 0.0
    for k in range(number):
        before = 0
        for j in range(number):
            if values[j] < values[k] or (values[j] == values[k] and j < k):
                before += 1
        if before == (number - 1) // 2:
            low = values[k]
        if before == number // 2:
            high = values[k]
    return float(low if number % 2 else (low + high) / 2.0)


def hold(encoder: Entry, time_s: float) -> None:
    """Judge from here on whether it comes to rest and stays."""
    encoder.held_at_s, encoder.held_from, encoder.held_speed, encoder.held_way = time_s, encoder.moved, speed(encoder), 0.0


def strays(encoder: Entry, time_s: float, deceleration: float) -> float:
    """Return how far it is beyond where that deceleration brings it since `hold`, or back from the furthest place on that way."""
    speed_then = abs(encoder.held_speed)
    ramp_s = min(time_s - encoder.held_at_s, speed_then / deceleration)
    way = copysign(1.0, encoder.held_speed) * (encoder.moved - encoder.held_from)
    most = ramp_s * (speed_then - 0.5 * deceleration * ramp_s)
    encoder.held_way = max(encoder.held_way, min(way, most))
    return float(max(way - most, encoder.held_way - way))


# ---- an axis --------------------------------------------------------------------------------------------
def hold_axis(axis: Entry, time_s: float, anew: bool) -> None:
    """Judge effort and encoders from here on: the drive has just been told; `anew`: whether both encoders move alike, too."""
    axis.pushed, axis.since_s = 0.0, time_s
    count_anew(axis, time_s, anew)


def count_anew(axis: Entry, time_s: float, anew: bool) -> None:
    """Judge the encoders from here on, and let them count from zero where they are to do it anew."""
    axis.is_led_from = False
    for encoder in (axis.motor, axis.link):
        if anew:
            encoder.moved = 0.0
        hold(encoder, time_s)


def led_on(axis: Entry) -> bool:
    """Whether an encoder of an enabled axis has moved by more than the tracking error since this was first asked."""
    motor, link = axis.motor, axis.link
    if not (axis.is_enabled and axis.is_led_from):
        axis.is_led_from, motor.led_from, link.led_from = True, motor.moved, link.moved
    return bool(max(abs(motor.moved - motor.led_from), abs(link.moved - link.led_from)) > axis.tracking_error)


def not_held(axis: Entry, time_s: float) -> int:
    """Return which law shows that a drive which is to hold the axis does not, by its effort or an encoder; `NOTHING` where none does."""
    if not axis.holds:
        return NOTHING
    if abs(axis.pushed) > axis.holding_permille:
        return NOT_HELD_BY_EFFORT
    law = NOT_HELD_BY_MOTOR
    for encoder in (axis.motor, axis.link):
        if encoder.is_there:
            if time_s - encoder.held_at_s > HELD_AFRESH_S and abs(speed(encoder)) * CREEP_S <= axis.tracking_error:
                hold(encoder, time_s)
            if strays(encoder, time_s, axis.deceleration) > HOLD_MARGIN * axis.tracking_error:
                return law
        law = NOT_HELD_BY_LINK
    return NOTHING


def stands(axis: Entry) -> bool:
    """Whether the drive holds the axis, tells its position, and the axis stands."""
    return bool(axis.holds and speed(axis.motor) == 0.0 and speed(axis.link) == 0.0 and axis.unanswered < SPEED_STEPS)


def check_motion(machine: Entry, axis: Entry, time_s: float) -> None:
    """Find what is wrong with the motion."""
    motor, link = axis.motor, axis.link
    if axis.off_steps > _MOST:
        refuse(machine, time_s, TORQUE_OFF, axis.number, most_off(axis), float(axis.torques[axis.newest_torque]))
    elif motor.too_fast_steps > _MOST:
        refuse(machine, time_s, MOTOR_FAST, axis.number, nan, motor.fastest)
    elif link.is_there:
        check_link(machine, axis, time_s)


def check_link(machine: Entry, axis: Entry, time_s: float) -> None:
    """Find what is wrong with the motion that the link encoder sees: alone, beside the drive's, and in its range."""
    link = axis.link
    apart = axis.sign * axis.motor.moved - link.moved
    if link.too_fast_steps > _MOST:
        refuse(machine, time_s, LINK_FAST, axis.number, nan, link.fastest)
    elif abs(apart) > axis.tracking_error:
        refuse(machine, time_s, APART, axis.number, apart, axis.tracking_error)
    elif axis.link_at - axis.upper > axis.tracking_error and speed(link) > 0.0:
        refuse(machine, time_s, OUT_OF_RANGE, axis.number, axis.link_at, axis.upper)
    elif axis.lower - axis.link_at > axis.tracking_error and speed(link) < 0.0:
        refuse(machine, time_s, OUT_OF_RANGE, axis.number, axis.link_at, axis.lower)


def most_off(axis: Entry) -> float:
    """Return the torque that was furthest from zero of those that were not asked for, the earliest of equal ones."""
    most = 0
    for k in range(1, SPEED_STEPS + 1):
        off = axis.off[(axis.newest_off + k) % SPEED_STEPS]
        if abs(off) > abs(most):
            most = off
    return float(most)


# ---- the machine ----------------------------------------------------------------------------------------
def check(machine: Entry, axes: Entries, time_s: float) -> None:
    """Find what is wrong with a machine of which an axis has torque or an open brake, until something is."""
    if machine.law != NOTHING:
        return
    is_watched = False
    for axis in axes:
        is_watched = is_watched or axis.is_powered or axis.brake_open
    if is_watched:
        check_syncs(machine, time_s)
        for axis in axes:
            if axis.is_powered or axis.brake_open:
                check_axis(machine, axis, time_s)


def check_syncs(machine: Entry, time_s: float) -> None:
    """Judge SYNC: it goes on, and no faster than it may."""
    newest, syncs = machine.newest_sync, FAST_SYNCS + 1
    if machine.syncs and time_s - machine.sync_s[newest] > machine.silent_s:
        refuse(machine, time_s, NO_SYNC, 0, time_s - machine.sync_s[newest], machine.silent_s)
    if machine.syncs == syncs:
        took_s = machine.sync_s[newest] - machine.sync_s[(newest + 1) % syncs]
        if took_s < FAST_SHARE * FAST_SYNCS * machine.period_s:
            refuse(machine, time_s, FAST_SYNC, 0, took_s, FAST_SHARE * FAST_SYNCS * machine.period_s)


def check_axis(machine: Entry, axis: Entry, time_s: float) -> None:
    """Judge a watched axis: it tells its position, moves as it may, is held where it is to be, and stops when it was asked to."""
    if axis.unanswered * machine.period_s > machine.silent_s:
        refuse(machine, time_s, NO_POSITION, axis.number, nan, machine.silent_s)
    check_motion(machine, axis, time_s)
    law = not_held(axis, time_s)
    if law != NOTHING:
        refuse(machine, time_s, law, axis.number, nan, nan)
    if machine.ended_at_s < inf and led_on(axis) and time_s - machine.ended_at_s > OBEYED_S:
        refuse(machine, time_s, LED_ON, axis.number, time_s - machine.ended_at_s, OBEYED_S)


def command(machine: Entry, axes: Entries, time_s: float) -> None:
    """Find what the supervisor commands itself without a permission, because the loop does not stop these axes.

    A drive in operation enabled loses its communication where SYNC is silent or the axis is led on; one that does not hold is reset.
    """
    machine.commands = False
    if machine.ended_at_s == inf or time_s - machine.commanded_at_s < NMT_EVERY_S:
        return
    is_silent = machine.syncs > 0 and time_s - machine.sync_s[machine.newest_sync] > machine.silent_s
    is_overdue = time_s - machine.ended_at_s > OBEYED_S
    for axis in axes:
        axis.is_to_stop = (led_on(axis) and is_overdue) or (is_silent and axis.is_enabled)
        axis.is_to_reset = not_held(axis, time_s) != NOTHING
        if axis.is_to_reset:
            hold_axis(axis, time_s, False)
        machine.commands = machine.commands or axis.is_to_stop or axis.is_to_reset
    if machine.commands:
        machine.commanded_at_s = time_s
