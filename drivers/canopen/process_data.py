"""What the PDOs of a machine carry: the values received and sent of each axis, and their conversion between the wire and SI."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite, nan
from operator import itemgetter

import can

from drivers.canopen.can_imu import COUNTER, FORCE, OBJECTS, FORCE_STEP_m_s2, RATE_STEP_rad_s
from drivers.canopen.cia402 import DISABLE_VOLTAGE, State, decode_state
from drivers.canopen.cia406 import signed_counts
from drivers.canopen.network import frame_sender
from drivers.canopen.pdo import PdoCodec
from drivers.canopen.units import MotionUnits
from drivers.errors import ConfigurationRefusedError, MotionRefusedError, ProtocolError
from drivers.interface import Sample
from drivers.settings import AxisScaling, BusSettings, Node, Pdo

CONTROLWORD, TARGET_TORQUE, TORQUE_OFFSET, TARGET_POSITION, TARGET_VELOCITY = 0x6040, 0x6071, 0x60B2, 0x607A, 0x60FF
STATUSWORD, POSITION, TORQUE_ACTUAL, CURRENT_ACTUAL, LINK_POSITION = 0x6041, 0x6064, 0x6077, 0x6078, 0x6004
CYCLIC_TARGETS = {"position": TARGET_POSITION, "velocity": TARGET_VELOCITY}
PROFILE_TARGETS = {"profile_position": TARGET_POSITION, "profile_velocity": TARGET_VELOCITY}
_HALF_RANGE, _RANGE = 1 << 31, 1 << 32
_MOST_BACK = -_HALF_RANGE  # of the counter's steps
INT16_MAX, _INT32_MAX = 32767, 0x7FFF_FFFF


class AxisInput:
    """The values received of one axis, and their conversion from counts and per mille to SI.

    position = sign * counts * resolution + offset, continued over wraps of the 32-bit counter.
    """

    def __init__(self, scaling: AxisScaling) -> None:
        self.scaling = scaling
        self.offset = 0.0
        self.statusword = -1  # newest ever received
        self._counts_scale = scaling.sign * scaling.position_resolution
        self.effort_scale = scaling.sign * scaling.rated / 1000.0  # drive's unit in one of a current or torque actual value (6078h, 6077h)
        self._link_zero, self._link_resolution = scaling.link_zero_counts, scaling.link_resolution
        self.last_raw: int | None = None  # newest position actual value
        self.turns = 0  # whole ranges of the 32-bit counter

    def position(self, raw: int) -> float:
        """Return the joint position [rad or m] of a position actual value (6064h)."""
        last_raw, self.last_raw = self.last_raw, raw
        if last_raw is not None and not _MOST_BACK <= raw - last_raw < _HALF_RANGE:
            self.turns += 1 if raw < last_raw else -1
        if self.turns:
            raw += self.turns * _RANGE
        return self._counts_scale * raw + self.offset

    def counts(self, position: float) -> float:
        """Return the drive's count of a joint position: the reverse of `position`, not in whole counts."""
        return (position - self.offset) / self._counts_scale

    def link_position(self, raw: int) -> float:
        """Return the position of the absolute link encoder [rad or m]."""
        return signed_counts(raw, self._link_zero) * self._link_resolution

    def counter_was_set(self) -> None:
        """Forget the counter's last value, because the drive has set its counter (homing)."""
        self.last_raw = None
        self.turns = 0


class AxisOutput:
    """Controlword, effort and target of one drive, in the RPDOs that carry them.

    The effort is a torque target (6071h) or, where it is mapped, a torque offset (60B2h): in torque mode it then is all of the torque, in
    velocity and position mode it is beside what the drive's loops give. The target is a position (607Ah) or a velocity (60FFh).

    Attributes
    ----------
    takes_effort : bool
        Whether an RPDO carries an effort. A drive without one cannot be pushed, not even against its brake.
    """

    def __init__(self, node: Node, scaling: AxisScaling, source: AxisInput, units: MotionUnits = MotionUnits()) -> None:  # noqa: B008 - frozen
        self.controlword = DISABLE_VOLTAGE
        self.target = 0  # counts, or the drive's unit of velocity
        self._effort = 0  # target torque (6071h) or torque offset (60B2h), per mille
        self._is_all = scaling.mode == "torque"
        self._left = 0.0  # what the last target lacks by rounding
        self._source = source
        self._speed_scale = scaling.sign / scaling.position_resolution * units.velocity
        self._permille = scaling.sign * 1000.0 / scaling.rated
        self._limit = min(INT16_MAX, round(scaling.limit / scaling.rated * 1000.0))
        carried = [index for pdo in node.rpdos for index, _, _ in pdo.entries]
        effort = TARGET_TORQUE if scaling.mode not in CYCLIC_TARGETS and TORQUE_OFFSET not in carried else TORQUE_OFFSET
        target = CYCLIC_TARGETS.get(scaling.mode) or PROFILE_TARGETS.get(scaling.mode)
        self.takes_effort = effort in carried or scaling.mode not in PROFILE_TARGETS
        filled = [CONTROLWORD, *([effort] if self.takes_effort else []), *([] if target is None else [target])]
        if sorted(carried) != sorted(filled):
            raise ConfigurationRefusedError(
                f"{node.name}: its RPDOs map {', '.join(f'{index:04X}h' for index in carried) or 'nothing'}; in {scaling.mode} mode the "
                f"loop fills {', '.join(f'{index:04X}h' for index in filled)} and nothing else"
            )
        places = {CONTROLWORD: 0, effort: 1, target: 2}
        self._rpdos = [(pdo.cob_id, PdoCodec.of(pdo.entries).pack, [places[index] for index, _, _ in pdo.entries]) for pdo in node.rpdos]
        self._frames: list[tuple[Callable[[bytes], None], Callable[..., bytes], Callable[[tuple[int, ...]], tuple[int, ...]]]] = []

    def command(self, effort: float) -> float:
        """Set the effort [drive's unit] that is sent next, clipped to the axis limit.

        Returns it as it is on the wire, in whole per mille of the drive's rating; NaN where the drive's own loops add to it.
        """
        value, limit = round(effort * self._permille), self._limit
        self._effort = value = limit if value > limit else -limit if value < -limit else value
        return value / self._permille if self._is_all else nan

    def lead_to(self, target: float) -> None:
        """Set the position [rad or m] or velocity [rad/s or m/s] that the drive's own loops follow from the next tick on.

        A cyclic target makes up for what the one before has lost by rounding: the drive's integrator would add that up.
        """
        if not isfinite(target):
            raise MotionRefusedError(f"{self._source.scaling.axis}: the target is {target}; no number, no motion")
        mode = self._source.scaling.mode
        is_position = mode.endswith("position")
        wanted = self._left + (self._source.counts(target) if is_position else target * self._speed_scale)
        whole = round(wanted)
        self._left = wanted - whole if mode in CYCLIC_TARGETS else 0.0
        if mode == "profile_position" and not -_HALF_RANGE <= whole - self._source.turns * _RANGE < _HALF_RANGE:
            scaling = self._source.scaling
            raise MotionRefusedError(
                f"{scaling.axis}: between it and {target:.4f} {scaling.position_unit} its drive's counter of 32 bits ends, and the drive "
                f"would go the other way round; set its counter: bus.homing.{scaling.axis}.method = 35 or 37"
            )
        self.target = signed_32(whole) if is_position else min(max(whole, -_INT32_MAX), _INT32_MAX)

    def stand(self) -> None:
        """Let the drive's own loops stand from the next tick on: without speed, or, unless it is enabled, at the position where it is."""
        source = self._source
        if source.scaling.mode.endswith("velocity"):
            self.target = 0
        elif source.last_raw is not None and decode_state(source.statusword) is not State.OPERATION_ENABLED:
            self.target = source.last_raw

    def connect(self, bus: can.BusABC) -> None:
        """Set the bus that `send` sends to."""
        self._frames = [(frame_sender(bus, cob_id), pack, _picker(places)) for cob_id, pack, places in self._rpdos]

    def send(self) -> None:
        """Send the drive's RPDOs with controlword, effort and target."""
        values = self.controlword, self._effort, self.target
        for send, pack, pick in self._frames:
            send(pack(*pick(values)))


class Tpdo:
    """One TPDO of one node, and the destination of its values."""

    def __init__(self, node: Node, pdo: Pdo, axis: int, source: AxisInput, bit: int = 0) -> None:
        self.bit, self.mask = bit, 1 << bit  # its place among all
        self.who = f"{node.name}: TPDO {pdo.number} ({pdo.cob_id:03X}h)"
        self.cob_id = pdo.cob_id
        self.malformed = ""  # what was wrong with the last frame that was dropped
        self.axis = axis
        self.source = source
        self.every_sync = pdo.transmission_type == 1
        codec = PdoCodec.of(pdo.entries)
        self._codec, self._unpack, self.size = codec, codec.unpack_whole, codec.size
        self.owed = 0  # SYNCs that it has left unanswered and may still answer
        self.usual_s = nan  # when after SYNC it answers; it has not yet
        self.alone_s = nan  # when the last one came that may be of an earlier SYNC
        self.unanswered = self.longer = 0  # SYNCs without its answer in time; frames longer than what they map
        objects = [index for index, _, _ in pdo.entries]
        self.statusword, self.position, self.link = (
            objects.index(i) if i in objects else -1 for i in (STATUSWORD, POSITION, LINK_POSITION)
        )
        effort = CURRENT_ACTUAL if CURRENT_ACTUAL in objects else TORQUE_ACTUAL
        self.effort = objects.index(effort) if effort in objects else -1
        self.is_of_axis = node.role != "imu"  # what an axis is judged stale by
        mapped = [] if self.is_of_axis else [(index, subindex) for index, subindex, _ in pdo.entries]
        self.imu = [
            (place, OBJECTS.index(each), FORCE_STEP_m_s2 if each[0] == FORCE else RATE_STEP_rad_s)
            for place, each in enumerate(mapped)
            if each in OBJECTS
        ]
        self.imu_counter = -1 if self.is_of_axis or COUNTER not in objects else objects.index(COUNTER)
        self.take = self._taker()
        """Put the values of one frame into the sample; return False where it is malformed: the row lacks the values."""

    def _taker(self) -> Callable[[bytes | bytearray, Sample], bool]:
        """Return `take`, which looks up nothing that is known beforehand."""
        size, unpack, axis, source, imu, imu_counter = self.size, self._unpack, self.axis, self.source, self.imu, self.imu_counter
        statusword, position, effort, link = self.statusword, self.position, self.effort, self.link
        position_of, effort_scale, link_position_of = source.position, source.effort_scale, source.link_position

        def take(data: bytes | bytearray, sample: Sample) -> bool:
            if len(data) == size:
                values = unpack(data)
            else:
                try:
                    values = self._codec.unpack(data)
                except ProtocolError as error:
                    self.malformed = str(error)
                    return False
                self.longer += 1
            if statusword >= 0:
                source.statusword = sample.statusword[axis] = values[statusword]
            if position >= 0:
                sample.position[axis] = position_of(values[position])
            if effort >= 0:
                sample.effort[axis] = effort_scale * values[effort]
            if link >= 0:
                sample.link_position[axis] = link_position_of(values[link])
            for place, channel, step in imu:
                sample.bus_imu[channel] = step * values[place]
            if imu_counter >= 0:
                sample.bus_imu_counter = values[imu_counter]
            return True

        return take

    def rehearse(self) -> None:
        """Decode a frame of zeros."""
        self._unpack(bytes(self.size))

    def forget(self, sample: Sample, *, late: bool) -> None:
        """Remove the values of its frames from the sample; `late`: there were some, of an earlier SYNC."""
        if self.position >= 0:
            sample.position_late[self.axis] = late
        if self.link >= 0:
            sample.link_late[self.axis] = late
        if self.statusword >= 0:
            sample.statusword[self.axis] = -1
        for _, channel, _ in self.imu:
            sample.bus_imu[channel] = nan
        if self.imu_counter >= 0:
            sample.bus_imu_counter = -1
        for index, values in ((self.position, sample.position), (self.effort, sample.effort), (self.link, sample.link_position)):
            if index >= 0:
                values[self.axis] = nan


def _picker(places: Sequence[int]) -> Callable[[tuple[int, ...]], tuple[int, ...]]:
    """Return what picks the values at these places."""
    return itemgetter(*places) if len(places) > 1 else itemgetter(slice(places[0], places[0] + 1))


def signed_32(value: int) -> int:
    """Return the value of a signed counter of 32 bits."""
    return (value + _HALF_RANGE) % _RANGE - _HALF_RANGE


def drives(settings: BusSettings) -> list[Node]:
    """Return the drive of each axis, in axis order.

    Raises
    ------
    ConfigurationRefusedError
        An axis has no drive, or more than one.
    """
    found = []
    for scaling in settings.scalings:
        candidates = [node for node in settings.nodes if node.role == "drive" and node.axis == scaling.axis]
        if len(candidates) != 1:
            names = ", ".join(node.name for node in candidates) or "none"
            raise ConfigurationRefusedError(f"axis {scaling.axis} needs exactly one node of role drive, the machine file gives: {names}")
        found += candidates
    return found


def check_inputs(tpdos: Sequence[Tpdo], axes: Sequence[str]) -> None:
    """Check that every axis has what the loop needs of it.

    Raises
    ------
    ConfigurationRefusedError
        No TPDO that answers each SYNC carries its statusword, or its position.
    """
    for axis, name in enumerate(axes):
        for what, present in (
            ("statusword", any(t.statusword >= 0 for t in tpdos if t.axis == axis and t.every_sync)),
            ("position_actual_value", any(t.position >= 0 for t in tpdos if t.axis == axis and t.every_sync)),
        ):
            if not present:
                raise ConfigurationRefusedError(f"axis {name}: no TPDO with transmission type 1 maps {what}")
