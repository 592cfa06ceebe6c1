"""What the supervisor judges: frames of the bus and states of the I/O go in, a permission comes out.

It shares no code with the sample loop, has no model and no clock of its own. The permission ends in the round in which hold-to-run, door
or a user ask for a stop, or something is wrong, and stays so until the next session. Without it no refresh reaches the I/O device, whose
outputs then fall: brakes close, whatever loop, recorder and poller do.

Of an axis whose drive may apply torque, or whose brake reports open, this is watched: SYNC goes on, and no faster than it may; torques,
velocities and ways asked for keep to their limits; the drive sends its position, and measures no more torque than it was asked for; no
encoder is faster than the limit and a half; with a link encoder, both move alike and within the range. Without permission no drive leads
its axis on, or its communication is stopped; one that is told to hold its axis and does not is reset, on which it has no voltage.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from math import copysign, inf, isfinite, nan
from statistics import median

from drivers.canopen.units import velocity_units
from drivers.modbus.refresh import following_word
from drivers.settings import AxisScaling, BusSettings, MotionLimits, Pdo

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
WRITES_MODE, TORQUE_MODE = b"\x2f\x60\x60\x00", 10  # an SDO request that chooses the mode of operation that follows: a drive may home
NMT, NMT_STOP, NMT_RESET = 0x000, 0x02, 0x81  # identifier, and commands that stop a node's communication, and reset it (CiA 301)
_TORQUE_ON = 0x04  # of the statusword: the drive may apply torque, in operation enabled, quick stop and fault reaction active
_ENABLED_MASK, _ENABLED = 0x6F, 0x27  # of a statusword in operation enabled; a drive with torque in another state is to hold
_STATUSWORD, _POSITION, _LINK_POSITION, _CURRENT, _TORQUE = 0x6041, 0x6064, 0x6004, 0x6078, 0x6077
_ASKED = {0x6071: ("torque", "per mille"), 0x60B2: ("torque", "per mille"), 0x60FF: ("velocity", "counts/s"), 0x607A: ("way", "counts")}
_SIGNED = (_POSITION, _CURRENT, _TORQUE, *_ASKED)


class _Field:
    """Where a mapped object lies in the data of its PDO."""

    def __init__(self, shift: int, bits: int, *, signed: bool) -> None:
        self.shift, self.bits, self.signed = shift, bits, signed
        self.end, self.mask, self.half = shift + bits, (1 << bits) - 1, 1 << bits - 1

    def read(self, data: bytes) -> int | None:
        """Return the value, or None where the frame is too short."""
        if 8 * len(data) < self.end:
            return None
        value = int.from_bytes(data, "little") >> self.shift & self.mask
        return value - 2 * self.half if self.signed and value >= self.half else value


def _fields(entries: Iterable[tuple[int, int, int]]) -> dict[int, _Field]:
    """Return where the objects lie that a PDO maps, by their index."""
    found: dict[int, _Field] = {}
    shift = 0
    for index, _, bits in entries:
        found.setdefault(index, _Field(shift, bits, signed=index in _SIGNED))
        shift += bits
    return found


class _Encoder:
    """The motion of one encoder: its last steps, and how far it went since torque was switched on."""

    def __init__(self, resolution: float, fastest: float, furthest: float) -> None:
        self.resolution = resolution
        self.moved = 0.0
        self.jumped = False
        self.steps: deque[float] = deque(maxlen=SPEED_STEPS)  # rad or m
        self._too_fast: deque[bool] = deque(maxlen=SPEED_STEPS)
        self._times: deque[float] = deque(maxlen=SPEED_STEPS)  # s that they took
        self._fastest, self._furthest = fastest, furthest
        self._last: int | None = None
        self.hold(-inf)

    def take(self, counts: int, bits: int, took_s: float) -> None:
        """Take a reading, `took_s` after the one before."""
        if self._last is not None:
            step = self.resolution * self.way_to(counts, bits)
            beyond = abs(step) - COUNTS * self.resolution
            self.jumped = beyond > min(JUMP * self._fastest * took_s, self._furthest)
            self._too_fast.append(beyond > self._fastest * took_s)
            self.moved += 0.0 if self.jumped else step
            self.steps.append(step)
            self._times.append(took_s)
        self._last = counts

    def way_to(self, counts: int, bits: int) -> float:
        """Return how many counts the last reading is away, the shorter way round; NaN before there is one."""
        half = 1 << bits - 1
        return nan if self._last is None else (counts - self._last + half) % (2 * half) - half

    def hold(self, time_s: float) -> None:
        """Judge from here on whether it comes to rest and stays."""
        self.held_at_s, self._held_from, self._held_speed, self._way = time_s, self.moved, self.speed, 0.0

    def strays(self, time_s: float, deceleration: float) -> float:
        """Return how far it is beyond where that deceleration brings it since `hold`, or back from the furthest place on that way."""
        speed = abs(self._held_speed)
        ramp_s = min(time_s - self.held_at_s, speed / deceleration)
        way, most = copysign(1.0, self._held_speed) * (self.moved - self._held_from), ramp_s * (speed - 0.5 * deceleration * ramp_s)
        self._way = max(self._way, min(way, most))
        return max(way - most, self._way - way)

    @property
    def too_fast(self) -> bool:
        """Whether most of the last steps were faster than the axis may move."""
        return self._too_fast.count(True) > SPEED_STEPS // 2

    @property
    def speed(self) -> float:
        """The median over the last steps [rad/s or m/s], 0 before there are so many, and where it is a flicker."""
        if len(self.steps) <= SPEED_STEPS // 2 or abs(median(self.steps)) <= COUNTS * self.resolution:
            return 0.0
        return median(step / took for step, took in zip(self.steps, self._times, strict=True))


class _Axis:
    """What is known of one axis."""

    def __init__(self, scaling: AxisScaling, limits: MotionLimits, units_per_count: float, period_s: float) -> None:
        self.name, self.limits, self.scaling = scaling.axis, limits, scaling
        fastest = SPEED_MARGIN * limits.speed
        self.motor = _Encoder(scaling.position_resolution, fastest, limits.tracking_error)
        self.link = _Encoder(scaling.link_resolution, fastest, limits.tracking_error) if scaling.link_resolution else None
        self.link_at = nan  # rad or m
        self.torque_permille = min(32767, round(scaling.limit / scaling.rated * 1000.0))
        self.holding_permille, self._pushed, self._since_s = limits.holding_effort / scaling.rated * 1000.0, 0.0, inf
        self.fastest_counts_s, self.counts_per_unit = fastest / scaling.position_resolution, 1.0 / units_per_count
        self.encoders = {"motor": self.motor} | ({"link": self.link} if self.link is not None else {})
        self.powered = self.enabled = self.holds = self.brake_open = self.known = False
        self.mode = TORQUE_MODE if scaling.mode == "torque" else 0
        self._torques, self._off = deque([0] * SPEED_STEPS, SPEED_STEPS), deque([0] * SPEED_STEPS, SPEED_STEPS)  # asked for; beyond that
        self._deceleration = min(limits.acceleration, limits.quick_stop or limits.acceleration)
        self._ramp_s = limits.speed / self._deceleration
        self.unanswered = 0  # SYNCs since the last position
        self.seen_at_s = self.link_seen_at_s = -inf  # when each encoder was read last
        self._led_from: dict[str, float] = {}  # how far each encoder had moved when the axis was to be led no more
        self._target: int | None = None  # position asked for last
        self._period_s = period_s

    def asks(self, kind: str, value: int, bits: int) -> tuple[float, float]:
        """Return how much is asked for, and how much is allowed; of a new position, that is the way there of an enabled drive."""
        if kind == "torque":
            self._torques.append(value)
        if kind != "way":
            return (value, self.torque_permille) if kind == "torque" else (value * self.counts_per_unit, self.fastest_counts_s)
        new, self._target = value != self._target, value
        way, limits, most = self.motor.way_to(value, bits), self.limits, LEAD_S * self.limits.speed
        if self.scaling.mode == "profile_position":
            most = limits.upper - self.link_at if self.scaling.sign * way > 0.0 else self.link_at - limits.lower
            most = most if isfinite(most) else limits.upper - limits.lower  # where no link encoder tells
        return way, (most + limits.tracking_error) / self.motor.resolution if new and self.enabled else inf

    def status(self, time_s: float, word: int, bits: int) -> None:
        """Take a statusword; from the moment at which torque is on, the encoders count from zero."""
        powered, self.enabled = bool(word & _TORQUE_ON), word & _ENABLED_MASK == _ENABLED
        holds = powered and not self.enabled
        if (powered and not self.powered) or (holds and not self.holds):
            self.hold(time_s, anew=not self.powered)
        self.powered, self.holds, self.known = powered, holds, True

    def hold(self, time_s: float, *, anew: bool) -> None:
        """Judge effort and encoders from here on: the drive has just been told; `anew`: whether both encoders move alike, too."""
        self._pushed, self._since_s = 0.0, time_s
        self._rebase(time_s, anew=anew)

    def _rebase(self, time_s: float, *, anew: bool = True) -> None:
        self._led_from = {}
        for encoder in self.encoders.values():
            encoder.moved = 0.0 if anew else encoder.moved
            encoder.hold(time_s)

    def strays(self, time_s: float) -> str:
        """Return what shows that a drive which is to hold the axis does not, an encoder or its effort; '' where nothing does."""
        if self.holds and abs(self._pushed) > self.holding_permille:
            return "effort"
        for side, encoder in self.encoders.items() if self.holds else ():
            if time_s - encoder.held_at_s > HELD_AFRESH_S and abs(encoder.speed) * CREEP_S <= self.limits.tracking_error:
                encoder.hold(time_s)
            if encoder.strays(time_s, self._deceleration) > HOLD_MARGIN * self.limits.tracking_error:
                return side
        return ""

    def effort(self, time_s: float, permille: int, bits: int) -> None:
        """Take a measured torque: a drive in torque mode gives no more than was asked for, one that holds no more than some pose takes."""
        if time_s - self._since_s > self._ramp_s:
            self._pushed += (permille - self._pushed) * self._period_s / PUSHED_S
        low, high = min(0, *self._torques) - EFFORT_OFF, max(0, *self._torques) + EFFORT_OFF
        self._off.append(permille if self.enabled and self.mode == TORQUE_MODE and not low <= permille <= high else 0)

    def position(self, time_s: float, counts: int, bits: int) -> None:
        self.motor.take(counts, bits, self._took(time_s, self.seen_at_s))
        self.seen_at_s, self.unanswered = time_s, 0
        if self.motor.jumped:  # which says nothing of the effort
            self._rebase(time_s)

    def link_position(self, time_s: float, counts: int, bits: int) -> None:
        assert self.link is not None
        self.link.take(counts, bits, self._took(time_s, self.link_seen_at_s))
        self.link_seen_at_s = time_s
        half = 1 << bits - 1
        self.link_at = self.scaling.link_resolution * ((counts - self.scaling.link_zero_counts + half) % (2 * half) - half)

    def led_on(self) -> bool:
        """Whether an encoder of an enabled axis has moved by more than the tracking error since this was first asked."""
        now = {side: encoder.moved for side, encoder in self.encoders.items()}
        self._led_from = self._led_from if self.enabled and self._led_from else now
        return max(abs(now[side] - self._led_from[side]) for side in now) > self.limits.tracking_error

    def _took(self, now_s: float, before_s: float) -> float:
        """Return the time between two readings; frames that were held up come together, but were sampled a period apart."""
        return max(now_s - before_s, self._period_s)

    @property
    def stands(self) -> bool:
        """Whether the drive holds the axis, tells its position, and the axis stands."""
        return self.holds and not self.motor.speed and not (self.link and self.link.speed) and self.unanswered < SPEED_STEPS

    def wrong(self) -> str:
        """Return what is wrong with the motion, in words; '' where nothing is."""
        limits, unit = self.limits, self.scaling.position_unit
        if SPEED_STEPS - self._off.count(0) > SPEED_STEPS // 2:
            return f"{self.name}: its drive measures a torque of {max(self._off, key=abs)} per mille, {self._torques[-1]} was asked for"
        for side, encoder in self.encoders.items():
            if encoder.too_fast:
                allowed = f"{SPEED_MARGIN * limits.speed:.2f} {unit}/s"
                return f"{self.name}: its {side} shows more than the {allowed} allowed in most of its last {SPEED_STEPS} readings"
        if self.link is None:
            return ""
        apart = self.scaling.sign * self.motor.moved - self.link.moved
        if abs(apart) > limits.tracking_error:
            return f"{self.name}: its encoders are {apart:+.2e} {unit} apart since it was released"
        beyond = max(limits.lower - self.link_at, self.link_at - limits.upper)
        if beyond > limits.tracking_error and (self.link.speed if self.link_at > limits.upper else -self.link.speed) > 0.0:
            return f"{self.name}: its link shows {self.link_at:+.3f} {unit}, out of its range and moving on"
        return ""


class Supervisor:
    """Judges a machine by what passes on its bus and by the state of its I/O; `reason` says what was wrong, '' where nothing was."""

    def __init__(self, settings: BusSettings) -> None:
        self._sync_id, self._period_s = settings.sync_cob_id, settings.sync_period_s
        self._silent_s = max(SYNC_SILENT_PERIODS * settings.master_heartbeat_period_s, SILENT_AT_LEAST_S)
        self._settings = settings
        self._units = [velocity_units(scaling, settings) for scaling in settings.scalings]
        self.begin()

    def begin(self) -> None:
        """Begin a session: permit again, and forget what was seen."""
        settings = self._settings
        self.reason = ""
        self._sync_s: deque[float] = deque(maxlen=FAST_SYNCS + 1)
        self._ended_at_s = inf  # of the permission
        self._nmt_at_s = -inf
        self.asked_by = ""
        self._axes = [_Axis(*each, settings.sync_period_s) for each in zip(settings.scalings, settings.motions, self._units, strict=True)]
        self._axis_of = {axis.name: axis for axis in self._axes}
        self._drives = [(self._axis_of[node.axis], node.node_id) for node in settings.nodes if node.role == "drive"]
        self._requests = {0x600 + node: axis for axis, node in self._drives}
        self._sent = {pdo.cob_id: self._seen_in(node.axis, pdo) for node in settings.nodes for pdo in node.tpdos}
        self._asked = {pdo.cob_id: self._asked_in(node.axis, pdo) for node in settings.nodes for pdo in node.rpdos}

    def _seen_in(self, name: str, pdo: Pdo) -> list[tuple[_Field, Callable[[float, int, int], object]]]:
        """Return what a TPDO tells of its axis: where it lies, and who takes it."""
        axis, fields = self._axis_of[name], _fields(pdo.entries)
        effort = _CURRENT if _CURRENT in fields else _TORQUE
        takes = {_STATUSWORD: axis.status, effort: axis.effort, _POSITION: axis.position}
        if axis.link is not None:
            takes[_LINK_POSITION] = axis.link_position
        return [(fields[index], take) for index, take in takes.items() if index in fields]

    def _asked_in(self, name: str, pdo: Pdo) -> tuple[_Axis, list[tuple[_Field, str, str]]]:
        """Return what an RPDO asks of its axis: where it lies, its kind and its unit."""
        fields = _fields(pdo.entries)
        return self._axis_of[name], [(fields[index], *what) for index, what in _ASKED.items() if index in fields]

    def end(self) -> None:
        """End the session: nothing is permitted before the next."""
        self.refuse(-inf, "no bench runs")

    @property
    def torque(self) -> str:
        """What the drives' torque does: "torque on", "held" where it only holds axes that stand, "no torque", or "unknown"."""
        if any(axis.powered for axis in self._axes):
            return "torque on" if any(axis.powered and not axis.stands for axis in self._axes) else "held"
        return "no torque" if all(axis.known for axis in self._axes) else "unknown"

    def frame(self, time_s: float, can_id: int, data: bytes) -> None:
        """Take a data frame with an 11-bit identifier, whoever sent it."""
        if can_id == self._sync_id:
            self._sync_s.append(time_s)
            for axis in self._axes:
                axis.unanswered += 1
        elif (asked := self._asked.get(can_id)) is not None:
            axis, fields = asked
            for field, kind, unit in fields:
                value = field.read(data)
                much, most = (0.0, 0.0) if value is None else axis.asks(kind, value, field.bits)
                if abs(much) > most:
                    self.refuse(time_s, f"{axis.name}: a {kind} of {much:.0f} {unit} was asked for, {most:.0f} are allowed")
        elif data[:4] == WRITES_MODE and can_id in self._requests:
            self._requests[can_id].mode = data[4]
        elif (sent := self._sent.get(can_id)) is not None:
            for field, take in sent:
                if (value := field.read(data)) is not None:
                    take(time_s, value, field.bits)

    def io(self, time_s: float, hold_to_run: bool, door_closed: bool, brakes_open: Iterable[bool] = ()) -> None:
        """Take a state of the I/O; `brakes_open` in the order of the axes, empty where it is not known."""
        for axis, brake_open in zip(self._axes, brakes_open, strict=False):
            axis.brake_open = bool(brake_open)
        if not (hold_to_run and door_closed) and any(axis.powered or axis.brake_open for axis in self._axes):
            self._ended_at_s = min(self._ended_at_s, time_s)

    def ask_to_stop(self, time_s: float, who: str) -> None:
        """Take the permission back because somebody asks for a stop."""
        self.asked_by, self._ended_at_s = self.asked_by or who, min(self._ended_at_s, time_s)

    def refuse(self, time_s: float, reason: str) -> None:
        """Take the permission back; the first reason stays."""
        self.reason, self._ended_at_s = self.reason or reason, min(self._ended_at_s, time_s)

    def held_up(self) -> None:
        """Take note that frames were not taken for a while: SYNCs that come together now are no second producer."""
        while len(self._sync_s) > 1:
            self._sync_s.popleft()

    def check(self, time_s: float) -> bool:
        """Judge, and return whether motion is permitted; call it at least every period."""
        if not self.reason and (watched := [axis for axis in self._axes if axis.powered or axis.brake_open]):
            self._check(time_s, watched)
        return self._ended_at_s == inf

    def answer(self, time_s: float, word: int) -> int | None:
        """Return the word that refreshes a device which shows this one; None without permission."""
        return following_word(word) if self.check(time_s) else None

    def commands(self, time_s: float) -> list[tuple[int, int]]:
        """Return what the supervisor now commands itself (NMT), as command and node, because the loop does not stop these axes.

        A drive in operation enabled loses its communication where SYNC is silent or the axis is led on; one that does not hold is reset.
        """
        if self._ended_at_s == inf or time_s - self._nmt_at_s < NMT_EVERY_S:
            return []
        silent = bool(self._sync_s) and time_s - self._sync_s[-1] > self._silent_s
        overdue = time_s - self._ended_at_s > OBEYED_S
        found = [(NMT_STOP, node) for axis, node in self._drives if (axis.led_on() and overdue) or (silent and axis.enabled)]
        for axis, node in self._drives:
            if axis.strays(time_s):
                found.append((NMT_RESET, node))
                axis.hold(time_s, anew=False)
        self._nmt_at_s = time_s if found else self._nmt_at_s
        return found

    def _check(self, time_s: float, watched: list[_Axis]) -> None:
        silent_s = time_s - self._sync_s[-1] if self._sync_s else 0.0
        if silent_s > self._silent_s:
            self.refuse(time_s, f"no SYNC for {silent_s:.2f} s while a drive has torque or a brake is open")
        if len(self._sync_s) > FAST_SYNCS and (self._sync_s[-1] - self._sync_s[0]) < FAST_SHARE * FAST_SYNCS * self._period_s:
            self.refuse(time_s, "SYNC comes faster than it may: a second producer")
        for axis in watched:
            if axis.unanswered * self._period_s > self._silent_s:
                self.refuse(time_s, f"{axis.name}: its drive sends no position while it has torque or the brake is open")
            if wrong := axis.wrong():
                self.refuse(time_s, wrong)
            if side := axis.strays(time_s):
                self.refuse(time_s, f"{axis.name}: its drive does not hold it, as its {side} shows; its voltage is taken")
            if self._ended_at_s < inf and axis.led_on() and time_s - self._ended_at_s > OBEYED_S:
                who = self.asked_by or "hold-to-run or the door"
                self.refuse(time_s, f"{axis.name}: it is still led {time_s - self._ended_at_s:.1f} s after {who} asked for a stop")
