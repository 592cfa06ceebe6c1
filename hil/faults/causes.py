"""What a run says of a cause: every sentence that is known, and the faults that make it true.

A sentence tells what was seen or concluded; it is true if a fault has begun that makes just that. Advice, and what a device reports in its
own words, need none. A sentence that is not here is new, and the tests ask for its line.
"""

from __future__ import annotations

import re
from collections.abc import Collection

BUS = r"bus_\w+"
NODE = r"node_\w+"
SILENT = rf"pdos_\w+|{BUS}|{NODE}|drive_(hangs|loses_power|reboots)|foreign_nmt|heartbeat_lost"
"""What keeps frames of a node from the bus, or from their time."""
TORQUE = r"torque_\w+|drive_(deaf|hangs|loses_power|loses_mains|coasts|current_reads_zero)|foreign_torque|pdos_(frozen|delayed)"
"""What makes a drive's measured effort another than the one that was sent."""
DRIVE_LEAVES = (
    r"(drive|torque)_\w+|fault_reset_refused|foreign_(tpdo|nmt|master|sdo|heartbeat)|setting_changes|winding_overheats|bus_\w+|node_\w+"
)
MOTOR, LINK = r"motor_encoder_\w+", r"link_encoder_\w+"
ENCODERS = rf"{MOTOR}|{LINK}|foreign_tpdo|pdos_(frozen|delayed)"
DEPARTS = rf"{ENCODERS}|{TORQUE}|brake_\w+|setting_changes|mode_never_follows"
"""What takes an axis from where it is led, or makes it seem so."""
IO = r"io_\w+"

CAUSES: tuple[tuple[str, str], ...] = (
    # ---- drives
    (r"drive_\w+: its drive measures .* where it was sent .*", TORQUE),
    (r"\w+: its drive measures a torque of .* per mille, .* was asked for", TORQUE),
    (r"drive_\w+: its drive warns .*", "drive_warns"),
    (r"drive_\w+: its mean effort over .* from what the machine file says of this motion.*", rf"brake_\w+|{TORQUE}|{DEPARTS}"),
    (r"\w+ \(node \d+\): left operation enabled: .*", DRIVE_LEAVES),
    (r"\w+ \(node \d+\): its power stage has lost its supply .*", "drive_loses_mains"),
    (r"\w+ \(node \d+\): (fault|was in fault) ?.*|\w+ \(node \d+\): was in fault, EMCY .*|it was reset",
     "fault_reset_refused|drive_starts_in_fault|drive_reports_fault"),
    (r"(a fault reset|\d+ fault resets) did not clear it within .*", "fault_reset_refused|drive_reports_fault"),
    (r"\w+ \(node \d+\): (stays in mode .*|shows no mode \(-1\) for .*) was asked for", "mode_never_follows"),
    (r"(\w+ \(node \d+\): )?EMCY [0-9A-F]{4}h: .*", rf"(drive|torque)_\w+|fault_reset_refused|{BUS}|{NODE}|foreign_\w+|heartbeat_lost"),
    (r"\w+ \(node \d+\): \w+:\w+ .* is .*, .* was written: somebody, or the device itself, has changed it",
     "setting_changes|foreign_sdo|drive_(loses_power|reboots|coasts)"),
    (r"(\w+: )?its drive (did not hold it|does not hold it).*", rf"{TORQUE}|{DEPARTS}"),
    (r"this program stood still( for [\d.]+ s|: the nodes heard no master for [\d.]+ s)", "loop_stopped"),
    # ---- nodes
    (r"\w+ \(node \d+\): rebooted", "drive_reboots|foreign_nmt|drive_loses_power|node_unplugged"),
    (r"\w+ \(node \d+\): left operational: .*", "node_leaves_operational|node_stops|foreign_(nmt|heartbeat)|drive_reboots"),
    (r"it came between two heartbeats, so a second device may have its id", "drive_reboots|foreign_(nmt|heartbeat)|node_babbles"),
    (r"\w+ \(node \d+\): no heartbeat for .* allowed", SILENT),
    (r"\w+ \(node \d+\): late heartbeats: .*", SILENT),
    (r"\w+ \(node \d+\): its heartbeat comes more often than every .* s: a second device has its id", "node_babbles|foreign_heartbeat"),
    (r"\w+ \(node \d+\): \d+ boot-up messages after one reset: two devices share this id(, or one says it twice)?", "node_id_twice"),
    (r"\w+ \(node \d+\): neither boot-up nor SDO answer within .*", "node_absent"),
    (r"\w+ \(node \d+\): its boot-up message came, but no answer to an SDO within .* of it", rf"sdo_silent|{SILENT}"),
    (r"is it powered, with this id and bit rate\? nodes that booted: .*", "node_absent"),
    (r"\w+ \(node \d+\): \w+ is \w+, the machine file says \w+", "identity_differs"),
    (r"\w+ \(node \d+\): reading .*: no SDO answer within .*", rf"sdo_silent|{SILENT}"),
    (r"\w+ \(node \d+\): reading .*: Node returned a value for .*", "sdo_wrong_object"),
    (r"\w+ \(node \d+\): writing .* refused: .*", "sdo_aborts"),
    (r"\w+ \(node \d+\): .* reads back .* after .* was written", "writes_forgotten"),
    (r"the device does not take this value", "writes_forgotten"),
    # ---- PDOs and the bus
    (r"\w+: TPDO .*: \d+ SYNCs were not answered in time since bring-up", SILENT),
    (r"\w+: TPDO .* comes more than once per SYNC: a second device sends it.*", "foreign_tpdo|bus_repeats_frames|node_id_twice"),
    (r"\w+: TPDO .*: \d+ frames were longer than .*|the rest was ignored", "pdos_long"),
    (r"dropped because malformed: \d+ frames .*", "frames_empty|pdos_short|bus_damages_frames"),
    (r"dropped because malformed: \d+ messages of the IMU", r"imu_(damaged|garbled)"),
    (r"ignored on the bus: \d+ error frames", "error_frames"),
    (r"ignored on the bus: \d+ frames with a 29-bit identifier", "frames_extended"),
    (r"ignored on the bus: \d+ remote frames", "frames_remote"),
    (r"a second SYNC producer sends .*|SYNC comes between those of .*|SYNC comes faster than it may: a second producer", "foreign_sync"),
    (r"a second master sends the bench's own heartbeat.*", "foreign_master|bus_repeats_frames"),
    (r"somebody else sends .*, the commands to .*", "foreign_torque|bus_repeats_frames"),
    (r"somebody else sends .*, SDO requests to .*", "foreign_sdo"),
    (r"\d+ frames in one period that nobody here asked for.*", "bus_flooded"),
    (r".*the CAN controller is bus off", "bus_off"),
    (r".*no SYNC for .* s(; .*| while .*)?", rf"sync_stops|{BUS}"),
    (r"\w+: its drive sends no position while it has torque or the brake is open", SILENT),
    # ---- encoders, and where an axis is
    (r"\w+: its motor side moved by .*, its link encoder by .* while it was led", ENCODERS),
    (r"they may differ by [^;A]*: one of them is frozen, counts the wrong way, or the gear between them slips", ENCODERS),
    (r"\w+: link encoder: no position for \d+ ticks, and its motor side moved by .*", SILENT),
    (r"\w+: (motor side: |link encoder: )?no position for \d+ ticks, .*|\w+: no (position|link encoder) for .* s", rf"{SILENT}|pdos_\w+"),
    (r"\w+: (motor side|link encoder): moved by .* (at once )?while it .*", rf"{ENCODERS}|{DEPARTS}|homing_\w+"),
    (r"\w+: its motor side shows no motion for .*", rf"{MOTOR}|brake_\w+|homing_\w+|{TORQUE}"),
    (r"\w+: tracking error .* exceeds .*", rf"{DEPARTS}|foreign_torque"),
    (r"\w+: its (motor|link) shows more than the .* allowed in most of its last \d+ readings", rf"{ENCODERS}|{DEPARTS}"),
    (r"\w+: its encoders are .* apart since it was released", ENCODERS),
    (r"\w+: its link shows .*, out of its range and moving on", rf"{ENCODERS}|{DEPARTS}"),
    (r"encoders_\w+: its (link encoder|motor side) (jumped by|stands|has departed) .*", ENCODERS),
    (r".* are allowed: one of them drifts.*", ENCODERS),
    (r"\w+: moved .* on a positive effort|motor wiring, encoder direction or the machine file's sign is reversed.*",
     r"motor_encoder_reversed|torque_inverted"),
    (r"\w+: the motor side moved .*, its link encoder .*|the link encoder counts the wrong way, or is not on this axis",
     r"link_encoder_\w+"),
    (r"\w+: moved .* where .* was expected within .*|brake, friction.* or a disconnected motor",
     rf"brake_\w+|{TORQUE}|motor_encoder_frozen"),
    (r"\w+: moves by .* under its holding effort of .* alone|the holding effort is wrong.*",
     rf"{TORQUE}|motor_encoder_reversed"),
    (r"\w+: \S+ s after its brake opened it still moves by more than .*|wait until the structure is at rest.*", TORQUE),
    (r"\w+: motor side .*, link encoder .*: they differ by .* is allowed|home anew, or check ratio, resolution and zero_counts",
     rf"{ENCODERS}|homing_\w+"),
    # ---- homing
    (r"\w+: homing by method \d+: homing error.*", "homing_error|limit_switch_stuck|index_pulse_missing|homing_wrong_direction"),
    (r"\w+: homing by method \d+: not completed within .*", r"homing_\w+|limit_switch_stuck|index_pulse_missing"),
    (r"the position is not known", r"homing_\w+|limit_switch_stuck|index_pulse_missing"),
    (r"\w+: homing by method \d+ has set the counter .*", r"homing_shifted|motor_encoder_\w+"),
    # ---- brakes and I/O
    (r"brake of [\w, ]+: not (open|closed) within .*", rf"brake_\w+|{IO}"),
    (r"[\w, ]+: its brake reports closed during the (run|motion)", rf"brake_(closes_in_motion|feedback_stuck_closed)|{IO}"),
    (r"the I/O has given no valid state .*|io: unit \d+ refuses function .*", IO),
    (r"\w+: it is still led .* after .* asked for a stop", r"hold_to_run_\w+|door_opened"),
    # ---- IMU and temperature
    (r"imu: \d+ damaged messages within .*", r"imu_(damaged|garbled)"),
    (r"imu: \d+ packets within .*", r"imu_(slow|silent)"),
    (r"imu: has started anew: .*", "imu_reboots"),
    (r"imu: its mean (angular rate|specific force) over .*", rf"imu_\w+|{ENCODERS}"),
    (r"imu: its readings are .* older than at first.*", r"imu_(late|repeats)"),
    (r"imu: no packet for more than .*", r"imu_(silent|garbled)"),
    (r"imu: [xyz] has not changed for \d+ packets|noise makes that impossible.*", r"imu_(frozen|repeats)"),
    (r"imu: [xyz] is (nan|inf|-inf), no number.*", r"imu_(nan|infinite)"),
    (r"imu: [xyz] reads .*, its full scale is .*", "imu_saturates"),
    (r"temperature_\w+: .* within .*|a winding changes by at most .*", "thermometer_rises|winding_overheats"),
    (r"temperature_\w+: .* degC, .* are allowed.*", r"thermometer_(high|rises)|winding_overheats"),
    (r"temperature_\w+: reads no temperature: .*", "thermometer_broken"),
)  # fmt: skip
"""Sentences about causes, and the faults of which each is true."""

ADVICE = re.compile(
    "|".join(
        (
            r"check (brake, relay and input|its line and supply|mains, contactor and fuse|wiring, termination and bit rate)",
            r"compare unit_id and addresses with the device's manual",
            r"give (one another id|one of them another id, or switch it off)",
            r"switch it off(, or name it as .*)?",
            r"read the device's own diagnosis",
            r"is it powered and on this bus\?",
            r"press and hold it",
            r"if it takes longer, raise bus\.nodes\.\w+\.boot_timeout_s",
            r"no EMCY",
            r"its (last state was|period is) .*",
            r"they may differ by [\d.e+-]+ (A|mA|N|Nm|V)( \(.*)?",
            r"[\d.e+-]+ (rad|m|rad/s|m/s)? ?(is|are) allowed( \(.*)?",
            r"motion makes at most .*",
            r"(from [\d.]+ s on, .*|\d+ of \d+ rows are marked\))",
            r"nobody knows of hold-to-run, door and brakes.*",
            r"stopping the motors ran into .*",
        )
    )
)
"""What is advised, allowed or counted: it claims nothing of the machine."""

PREFIX = re.compile(r"(row \d+: )?(the supervisor took its permission back: )?(from [\d.]+ s on, )?")


def told_cause(text: str) -> str | None:
    """Return the faults, as a regular expression, of which a sentence about a cause is true; None where it is not such a sentence."""
    bare = text[PREFIX.match(text).end() :]  # type: ignore[union-attr]
    return next((kinds for pattern, kinds in CAUSES if re.fullmatch(pattern, bare)), None)


def is_true(kinds: str, faults: Collection[str]) -> bool:
    """Return whether one of the faults that had begun is one of those."""
    return any(re.fullmatch(kinds, fault) for fault in faults)
