"""Configuration of a node from the machine file, every write read back: SYNC, heartbeats, PDOs, option codes, scaling.

Nothing is assumed about the node's stored parameters: all that matters to the loop is written, and all other transmissions are switched
off.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf

from drivers.canopen.cia402 import HOMING_AT_PRESENT_POSITION, NO_HOMING
from drivers.canopen.heartbeat_consumer import HEARTBEAT_TOLERANCE
from drivers.canopen.own_limits import allow_following_error
from drivers.canopen.ramps import write_ramps
from drivers.canopen.sdo import SdoNode
from drivers.canopen.units import OBJECTS, check_positions, check_units, in_data_sheet, units_of
from drivers.errors import ConfigurationRefusedError
from drivers.settings import AxisScaling, BusSettings, Node, Pdo

PDO_INVALID = 1 << 31
NO_RTR = 1 << 30  # TPDOs: no remote requests; a node without RTR refuses a COB-ID that allows it, so it may set the bit by itself
RPDO_COMMUNICATION, RPDO_MAPPING, TPDO_COMMUNICATION, TPDO_MAPPING = 0x1400, 0x1600, 0x1800, 0x1A00
PDO_COUNT = 0x200
EVENT_TIMER = 5  # subindex of a PDO's communication; of an RPDO its deadline [ms]
SYNC_COB_ID, CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT = 0x1005, 0x1016, 0x1017
MAX_TORQUE, MAX_CURRENT, RATED_CURRENT, RATED_TORQUE = 0x6072, 0x6073, 0x6075, 0x6076
INTERPOLATION_TIME = 0x60C2
INTERPOLATION_TOLERANCE = 1e-2  # two digits say a period to half a per cent; what is further off is told
ADDED_COMMANDS = (0x6071, 0x60B0, 0x60B1, 0x60B2)
"""Target torque and the offsets of position, velocity and torque: a drive adds them to what the loop commands, from any earlier master."""

OPTION_CODES = (
    (0x6007, 3),  # abort connection (heartbeat of the bench lost, bus off): quick stop, so the drive holds; after a fault it holds nothing
    (0x605A, 6),  # quick stop: slow down on the quick stop ramp and hold; the bench takes the voltage once the brakes are proven
    (0x605B, 0),  # shutdown: disable the drive function; the brake holds by then
    (0x605C, 1),  # disable operation: slow down on the slow down ramp
    (0x605E, 2),  # fault reaction: slow down on the quick stop ramp
)
"""Option codes for stops by the drive itself, written where the drive has the object and the machine file's `writes` do not name it."""


def configure_node(sdo: SdoNode, node: Node, settings: BusSettings, scaling: AxisScaling | None = None) -> tuple[str, ...]:
    """Bring a pre-operational node to the state the machine file describes.

    Parameters
    ----------
    sdo : SdoNode
        Opened with the node's EDS.
    node : Node
    settings : BusSettings
        Of the whole bus: SYNC identifier, the bench's heartbeat.
    scaling : AxisScaling, optional
        Of the axis when the node is a drive.

    Returns
    -------
    tuple of str
        What the node cannot do and an operator should know, one line each.

    Raises
    ------
    ConfigurationRefusedError
        An abort in words, or a value that reads back differently.
    NodeAbsentError
        The node stopped answering.
    """
    own_writes = {(index, subindex) for index, subindex, _ in node.writes}
    notes = []
    if not sdo.knows(SYNC_COB_ID):
        notes.append(f"{sdo.who}: it has no SYNC COB-ID (1005h); it must take {settings.sync_cob_id:03X}h for SYNC")
    elif sdo.read_integer(SYNC_COB_ID) & 0x1FFF_FFFF != settings.sync_cob_id:
        sdo.write_checked(SYNC_COB_ID, 0, settings.sync_cob_id)
    _configure_pdos(sdo, node)
    _set_command_deadline(sdo, node, settings)
    sdo.write_checked(PRODUCER_HEARTBEAT, 0, round(node.heartbeat_period_s * 1000))
    watches = _watch_bench(sdo, settings)
    if node.role == "drive":
        lacking = [] if watches else ["heartbeat consumer (1016h) that watches a heartbeat of the bench"]
        lacking += [f"option code {index:04X}h" for index in _write_option_codes(sdo, own_writes)]
        if lacking:
            notes.append(_stopped_otherwise(sdo, node, lacking))
        _clear_commands(sdo, node)
        _write_own(sdo, node, units=True)
        if scaling is not None:
            check_positions(sdo.integer_if_there, scaling, sdo.who)
        if scaling is not None and _moves_by_itself(node, settings, scaling):
            _check_units(sdo, node, scaling)
        if scaling is not None and scaling.mode == "position":
            limits = next(motion for motion in settings.motions if motion.axis == scaling.axis)
            notes += allow_following_error(sdo, node, limits, scaling.position_resolution)
        if scaling is not None and scaling.mode in ("velocity", "position"):
            notes += _set_interpolation_time(sdo, settings)
    if scaling is not None:
        _configure_scaling(sdo, scaling, own_writes)
        notes += write_ramps(sdo, scaling, next(each for each in settings.motions if each.axis == scaling.axis), node.writes)
    _write_own(sdo, node, units=False)
    _check_answer_time(sdo, settings)
    return tuple(notes)


def _check_answer_time(sdo: SdoNode, settings: BusSettings) -> None:
    """Refuse a node for which commands would pause for so long, while it is asked between two ticks, that drives miss them."""
    missed_s = HEARTBEAT_TOLERANCE * settings.master_heartbeat_period_s
    if missed_s and inf > sdo.fastest_read_s > missed_s:
        raise ConfigurationRefusedError(
            f"{sdo.who}: it answers SDOs after {sdo.fastest_read_s:.2f} s at best; drives miss commands that pause for {missed_s:.2f} s; "
            f"raise bus.master_heartbeat_s above {sdo.fastest_read_s / HEARTBEAT_TOLERANCE:.2f}"
        )


def _write_own(sdo: SdoNode, node: Node, *, units: bool) -> None:
    """Write what the machine file has of its own: a drive's units first, because speeds and ramps are written in them."""
    for index, subindex, value in node.writes:
        if units == (node.role == "drive" and index in OBJECTS):
            sdo.write_checked(index, subindex, value)


def _moves_by_itself(node: Node, settings: BusSettings, scaling: AxisScaling) -> bool:
    """Return whether a drive is told velocities or accelerations: by the loop, or for homing."""
    finds = any(homing.axis == node.axis and homing.method not in (*HOMING_AT_PRESENT_POSITION, NO_HOMING) for homing in settings.homings)
    return scaling.mode != "torque" or finds


def _check_units(sdo: SdoNode, node: Node, scaling: AxisScaling) -> None:
    check_units(sdo.integer_if_there, units_of(in_data_sheet(sdo.dictionary, node.writes), scaling, sdo.who), scaling, sdo.who)


def configure_pdo(sdo: SdoNode, pdo: Pdo, *, transmit: bool) -> None:
    """Map one PDO by the procedure of CiA 301 (7.5.2.36): invalid, count 0, entries, count, transmission type, valid."""
    communication = (TPDO_COMMUNICATION if transmit else RPDO_COMMUNICATION) + pdo.number - 1
    mapping = (TPDO_MAPPING if transmit else RPDO_MAPPING) + pdo.number - 1
    cob_id = pdo.cob_id | (NO_RTR if transmit else 0)
    sdo.write_checked(communication, 1, cob_id | PDO_INVALID, ignore_bits=NO_RTR)
    wanted = [index << 16 | subindex << 8 | bits for index, subindex, bits in pdo.entries]
    if sdo.may_write(mapping, 0):
        sdo.write_checked(mapping, 0, 0)
        for position, entry in enumerate(wanted, start=1):
            sdo.write_checked(mapping, position, entry)
        sdo.write_checked(mapping, 0, len(wanted))
    else:
        _check_fixed_mapping(sdo, mapping, wanted)
    sdo.write_checked(communication, 2, pdo.transmission_type)
    sdo.write_checked(communication, 1, cob_id, ignore_bits=NO_RTR)


def _configure_pdos(sdo: SdoNode, node: Node) -> None:
    """Switch the machine file's PDOs on and all others off, because an unused PDO costs bus time in every tick."""
    for communication, pdos in ((RPDO_COMMUNICATION, node.rpdos), (TPDO_COMMUNICATION, node.tpdos)):
        used = {communication + pdo.number - 1 for pdo in pdos}
        for index in range(communication, communication + PDO_COUNT):
            if index in used or not sdo.knows(index, 1):
                continue
            cob_id = sdo.read_integer(index, 1)
            if not cob_id & PDO_INVALID:
                sdo.write_checked(index, 1, cob_id | PDO_INVALID, ignore_bits=NO_RTR)
        for pdo in pdos:
            configure_pdo(sdo, pdo, transmit=communication == TPDO_COMMUNICATION)


def _check_fixed_mapping(sdo: SdoNode, mapping: int, wanted: list[int]) -> None:
    have = [sdo.read_integer(mapping, position) for position in range(1, sdo.read_integer(mapping, 0) + 1)]
    if have != wanted:
        raise ConfigurationRefusedError(
            f"{sdo.who}: the mapping {mapping:04X}h is fixed to {_mapping_words(have)}, the machine file wants {_mapping_words(wanted)}"
        )


def _mapping_words(entries: Iterable[int]) -> str:
    return ", ".join(f"{entry >> 16:04X}h:{entry >> 8 & 0xFF:02X}/{entry & 0xFF}" for entry in entries) or "nothing"


def _watch_bench(sdo: SdoNode, settings: BusSettings) -> bool:
    """Let the node watch the bench's heartbeat; return False when it cannot or the bench sends none."""
    if not (settings.master_heartbeat_period_s > 0.0 and sdo.may_write(CONSUMER_HEARTBEAT, 1)):
        return False
    milliseconds = round(HEARTBEAT_TOLERANCE * settings.master_heartbeat_period_s * 1000)
    sdo.write_checked(CONSUMER_HEARTBEAT, 1, settings.master_node_id << 16 | milliseconds)
    return True


def _set_command_deadline(sdo: SdoNode, node: Node, settings: BusSettings) -> None:
    """Let a drive miss its commands as it misses the bench's heartbeat, where it can: somebody else may send that."""
    milliseconds = round(HEARTBEAT_TOLERANCE * settings.master_heartbeat_period_s * 1000)
    for pdo in node.rpdos:
        communication = RPDO_COMMUNICATION + pdo.number - 1
        if milliseconds and sdo.may_write(communication, EVENT_TIMER):
            sdo.write_checked(communication, EVENT_TIMER, milliseconds)


def _stopped_otherwise(sdo: SdoNode, node: Node, lacking: list[str]) -> str:
    """Return the note on a drive that does not stop by itself; refuse it where the machine file does not say what stops it."""
    without = f"{sdo.who}: it has no {' and no '.join(lacking)}, so it does not stop by itself when the bench is gone"
    if not node.stopped_by:
        raise ConfigurationRefusedError(
            f'{without}; wire what does, e.g. safe torque off, and name it: bus.nodes.{node.name}.stopped_by = "…"'
        )
    return f"{without}; what stops it, by the machine file: {node.stopped_by}"


def _write_option_codes(sdo: SdoNode, own_writes: set[tuple[int, int]]) -> list[int]:
    """Write the option codes that the drive has; return which it lacks of the two that act when the bench is gone."""
    for index, code in OPTION_CODES:
        if sdo.may_write(index) and (index, 0) not in own_writes:
            sdo.write_checked(index, 0, code)
    return [index for index in (0x6007, 0x605E) if not sdo.knows(index)]


def _set_interpolation_time(sdo: SdoNode, settings: BusSettings) -> tuple[str, ...]:
    """Write the time between targets (60C2h) where a drive has it: whole units of a power of ten, as near as they come."""
    if not sdo.may_write(INTERPOLATION_TIME, 1):
        return ()
    exponent = min(range(-6, 1), key=lambda power: (_interpolation_error(settings.sync_period_s, power), -power))
    units = round(settings.sync_period_s / 10.0**exponent)
    sdo.write_checked(INTERPOLATION_TIME, 1, units)
    if sdo.may_write(INTERPOLATION_TIME, 2):
        sdo.write_checked(INTERPOLATION_TIME, 2, exponent)
    error = units * 10.0**exponent / settings.sync_period_s - 1.0
    if abs(error) <= INTERPOLATION_TOLERANCE:
        return ()
    return (f"{sdo.who}: its interpolation time (60C2h) is {units}e{exponent} s, {error:+.1%} off the period of SYNC: targets may jerk",)


def _interpolation_error(period_s: float, power: int) -> float:
    """Return the relative error of a period in whole units of a power of ten that fit into eight bits; endless where none does."""
    units = round(period_s / 10.0**power)
    return abs(units * 10.0**power / period_s - 1.0) if 1 <= units <= 255 else inf


def _clear_commands(sdo: SdoNode, node: Node) -> None:
    """Set to zero what a drive would add to the loop's commands; a reset of its communication leaves it."""
    mapped = {index for pdo in node.rpdos for index, _, _ in pdo.entries}
    for index in ADDED_COMMANDS:
        if index not in mapped and sdo.may_write(index) and any(sdo.read_if_present(index) or b""):
            sdo.write_checked(index, 0, 0)


def _configure_scaling(sdo: SdoNode, scaling: AxisScaling, own_writes: set[tuple[int, int]]) -> None:
    """Write the rated values to which per mille refer, and the drive's own limits, which are per mille of them."""
    for index, value, what in (
        (RATED_CURRENT, scaling.rated_current_mA, "rated current in mA"),
        (RATED_TORQUE, scaling.rated_torque_mNm, "rated torque in mNm"),
    ):
        if not value or not sdo.knows(index):
            continue
        have = sdo.read_integer(index)
        if have == value:
            continue
        try:
            sdo.write_checked(index, 0, value)
        except ConfigurationRefusedError as error:
            raise ConfigurationRefusedError(
                f"{sdo.who}: {what} ({index:04X}h) is {have}, the machine file says {value}; "
                f"every effort would be off by {have / value - 1:+.1%} ({error})"
            ) from error
    for index in (MAX_TORQUE, MAX_CURRENT):
        if sdo.may_write(index) and (index, 0) not in own_writes:
            sdo.write_checked(index, 0, round(scaling.limit / scaling.rated * 1000))
