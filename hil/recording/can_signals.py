"""Recordings from CAN frames: with a machine its PDOs as signals, a row per SYNC; without one the bare frames, a row each.

SYNC k latches; the drives' and encoders' TPDOs that follow it are row k, and so are the RPDOs the loop sent before SYNC k+1: command k.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.canopen.pdo import PdoCodec
from drivers.errors import ProtocolError
from drivers.settings import AxisScaling, BusSettings, LoopMode
from hil.errors import RecordingError
from hil.recording import can_commands
from hil.recording.blf import read_blf
from hil.recording.can_frames import CanFrame, CanLog, counted
from hil.recording.can_order import in_order
from hil.recording.can_tables import read_frames_csv, read_frames_sqlite
from hil.recording.can_text import read_asc, read_trc
from hil.recording.candump import read_candump
from hil.recording.metadata import machine_table
from hil.recording.recording import CAN_FRAMES, Channel, Recording
from hil.recording.said import source_table
from hil.recording.warning import RecordingWarning

if TYPE_CHECKING:
    from hil.machine.machine import AxisUnits, Machine

STATUSWORD, POSITION_ACTUAL, TORQUE_ACTUAL, CURRENT_ACTUAL, ENCODER_POSITION = 0x6041, 0x6064, 0x6077, 0x6078, 0x6004

QUANTITY_OF = {
    STATUSWORD: "statusword",
    POSITION_ACTUAL: "position",
    TORQUE_ACTUAL: "effort",
    CURRENT_ACTUAL: "effort",
    ENCODER_POSITION: "link_position",
}
"""The recorded quantity of each object that a device sends."""

QUANTITIES = ("excitation", "command", "velocity_offset", "effort", "position", "link_position", "statusword")
"""Their order in the recording."""

BELIEVABLE_PERIOD = 0.2
"""Largest deviation of the median time between SYNCs from the machine's period, as a share of it; beyond, the log's times are wrong."""

_MOST_IDENTIFIERS = 8
"""Identifiers in one message."""

PHASE_GAIN = 0.1
"""Gain with which the estimate of a SYNC's due time follows each SYNC: it averages jitter and follows a drift of the adapter's clock."""


def read_can(path: Path, machine: Machine | None, part: str = "") -> Recording:
    """Read a candump `.log`, a `.blf`, `.asc` or `.trc`, or python-can's `.csv` or `.db`.

    Parameters
    ----------
    path : Path
    machine : Machine, optional
        Machine whose PDO maps and scalings turn frames into signals. None gives the frames: `can_id`, `can_length`, `can_extended`,
        `can_remote`, `byte_0`, ... and `can_fd` where there is a frame of CAN FD.
    part : str
        Which bus is taken of several, `can0`; or of two answers to a SYNC `@1`, the first, or `@2`, the last.

    Raises
    ------
    RecordingError
        The log does not exist, or holds no data of the machine.
    """
    return recording_of_log(_READERS[path.suffix.lower()](path), path, machine, part)


def recording_of_log(log: CanLog, path: Path, machine: Machine | None, part: str = "") -> Recording:
    """Return the frames of a log as a recording; parameters and errors as in `read_can`."""
    if not log.frames:
        raise RecordingError(f"{path}: holds no frames")
    try:
        return _frame_table(log, path) if machine is None else _signals(log, machine, path, part)
    except RecordingError as problem:
        raise RecordingError(str(problem) if str(problem).startswith(str(path)) else f"{path}: {problem}") from None


_READERS = {
    ".log": read_candump,
    ".txt": read_candump,
    ".blf": read_blf,
    ".asc": read_asc,
    ".trc": read_trc,
    ".csv": read_frames_csv,
    ".db": read_frames_sqlite,
}


def _frame_table(log: CanLog, path: Path) -> Recording:
    if any(np.isnan(frame.time_s) for frame in log.frames):
        raise RecordingError("has no time stamps: let `candump -t a` print them, or name a machine, whose SYNCs are counted")
    frames, order = in_order(log.frames)
    widest = max(len(frame.data) for frame in frames)
    bytes_ = np.full((len(frames), widest), np.nan)
    for row, frame in enumerate(frames):
        bytes_[row, : len(frame.data)] = list(frame.data)
    start_s = frames[0].time_s
    columns: dict[str, Any] = {
        "can_id": [frame.can_id for frame in frames],
        "can_length": [len(frame.data) for frame in frames],
        "can_extended": [frame.extended for frame in frames],
        "can_remote": [frame.remote for frame in frames],
    }
    if any(frame.fd for frame in frames):
        columns["can_fd"] = [frame.fd for frame in frames]
    columns |= {f"byte_{place}": bytes_[:, place] for place in range(widest)}
    channels = {"time": Channel("s", np.array([frame.time_s - start_s for frame in frames]))}
    channels |= {name: Channel("", np.asarray(values, dtype=np.float64)) for name, values in columns.items()}
    source = source_table(path, log.not_taken, [*log.notes, *order])
    return Recording(channels, {"kind": CAN_FRAMES, "buses": sorted({frame.channel for frame in frames}), "source": source})


def _signals(log: CanLog, machine: Machine, path: Path, part: str) -> Recording:
    if machine.bus is None:
        raise RecordingError(f"machine {machine.name} has no bus, so its file does not say what the frames mean")
    bus, part = (part, "") if part[:1] != "@" else ("", part)
    frames, others = _of_one_bus(log.frames, machine.bus, bus)
    frames, order = in_order(frames, machine.bus, part)
    syncs, raw, unknown = _rows(frames, machine.bus)
    ticks, lateness = _ticks(np.array(syncs), machine.bus.sync_period_s, path)
    channels = {"time": Channel("s", ticks * machine.bus.sync_period_s)}
    offsets: dict[str, float] = {}
    columns: dict[tuple[str, str], Channel] = {}
    for units, scaling in zip(machine.units, machine.bus.scalings, strict=True):
        scaled = {
            quantity: _scaled(raw[key], quantity, scaling) for quantity in QUANTITY_OF.values() if (key := (scaling.axis, quantity)) in raw
        }
        if "position" in scaled:
            offsets[scaling.axis] = _home_offset(scaled)
            scaled["position"] = scaled["position"] + offsets[scaling.axis]
        for quantity, values in scaled.items():
            columns[quantity, scaling.axis] = Channel(_unit(quantity, units), values)
        asked = {name: raw[scaling.axis, name] for name in can_commands.asked_in(scaling.mode).values() if (scaling.axis, name) in raw}
        drive = next(node for node in machine.bus.nodes if (node.role, node.axis) == ("drive", scaling.axis))
        counts = _unwrapped(raw[scaling.axis, "position"]) if (scaling.axis, "position") in raw else None
        sent = can_commands.commands(asked, scaling, drive, counts, offsets.get(scaling.axis, 0.0), units.effort)
        columns |= {(quantity, scaling.axis): channel for quantity, channel in sent.items()}
    for quantity in QUANTITIES:
        for units in machine.units:
            if (quantity, units.axis) in columns:
                channels[_channel_name(quantity, units)] = columns[quantity, units.axis]
    channels["sync_lateness"] = Channel("s", lateness)
    source = source_table(path, [*log.not_taken, *others, *unknown], [*log.notes, *order])
    metadata = {"machine": machine_table(machine), "can_log": {"position_offsets": offsets}, "source": source}
    if any(scaling.mode != "torque" for scaling in machine.bus.scalings):
        metadata["commands"] = {
            axis: table | {"excitation_unit": channels[f"excitation_{axis}"].unit} if f"excitation_{axis}" in channels else table
            for axis, table in machine.commanded.items()
        }
    return Recording(channels, metadata)


def _of_one_bus(frames: Sequence[CanFrame], bus: BusSettings, asked: str) -> tuple[list[CanFrame], list[str]]:
    """Return the frames of the one bus in the log that has SYNCs, or of that which is asked for, and what other frames there were."""
    sync = bus.sync_cob_id & 0x7FF
    buses = sorted({frame.channel for frame in frames if frame.can_id == sync and _is_plain(frame)})
    if not buses:
        raise RecordingError(f"no SYNC (COB-ID {sync:03X}) in the log, so it has no rows")
    if asked and asked not in buses:
        raise RecordingError(f"{asked}=part: no SYNC on {asked}, but on {' and '.join(buses)}")
    if len(buses) > 1 and not asked:
        raise RecordingError(f"SYNCs on {' and '.join(buses)}: take one with --map {' or '.join(f'{one}=part' for one in buses)}")
    taken, of_buses = asked or buses[0], {frame.channel for frame in frames}
    kept: list[CanFrame] = []
    others: Counter[str] = Counter()
    for frame in frames:
        if frame.fd:
            others["CAN FD frame"] += 1
        elif frame.remote:
            others["remote frame"] += 1
        elif frame.extended:
            others["frame with 29-bit identifiers"] += 1
        elif frame.channel != taken:
            others[frame.channel] += 1
        else:
            kept.append(frame)
    return kept, [f"{counted(number, 'frame')} of {what}" if what in of_buses else counted(number, what) for what, number in others.items()]


def _is_plain(frame: CanFrame) -> bool:
    return not (frame.extended or frame.remote or frame.fd)


def _rows(frames: Sequence[CanFrame], bus: BusSettings) -> tuple[list[float], dict[tuple[str, str], np.ndarray], list[str]]:
    """Return times of the SYNCs, raw integers (N,) per (axis, quantity), NaN where none came, and what else there was."""
    sync = bus.sync_cob_id & 0x7FF
    codecs: dict[int, tuple[PdoCodec, list[tuple[int, tuple[str, str]]]]] = {}
    modes: dict[str, LoopMode] = {scaling.axis: scaling.mode for scaling in bus.scalings}
    nameless: set[int] = set()
    for node in bus.nodes:
        quantity_of = QUANTITY_OF | (can_commands.asked_in(modes[node.axis]) if node.role == "drive" else {})
        for pdo in (*node.tpdos, *node.rpdos):
            wanted = [(place, (node.axis, quantity_of[index])) for place, (index, _, _) in enumerate(pdo.entries) if index in quantity_of]
            codecs[pdo.cob_id & 0x7FF] = PdoCodec.of(pdo.entries), wanted
            nameless |= {index for index, _, _ in pdo.entries} - quantity_of.keys()
    count = sum(frame.can_id == sync for frame in frames)
    raw = {key: np.full(count, np.nan) for _, wanted in codecs.values() for _, key in wanted}
    syncs: list[float] = []
    early = 0
    unknown: Counter[int] = Counter()
    for frame in frames:
        if frame.can_id == sync:
            syncs.append(frame.time_s)
        elif frame.can_id not in codecs:
            unknown[frame.can_id] += 1
        elif not syncs:
            early += 1
        else:
            codec, wanted = codecs[frame.can_id]
            try:
                values = codec.unpack(frame.data)
            except ProtocolError as problem:
                where = f"frame {frame.can_id:03X} after SYNC {len(syncs) - 1}"
                raise RecordingError(f"{where}: {problem}, by the machine file's map of that COB-ID") from None
            for place, key in wanted:
                raw[key][len(syncs) - 1] = values[place]
    if all(np.isnan(values).all() for values in raw.values()):
        raise RecordingError(f"none of the machine's PDOs in the log ({', '.join(f'{cob_id:03X}' for cob_id in sorted(codecs))})")
    others = [f"the PDOs' {', '.join(f'{index:04X}' for index in sorted(nameless))}, which no channel has"] if nameless else []
    others += [f"{counted(early, 'PDO')} before the first SYNC"] if early else []
    if unknown:
        identifiers = ", ".join(f"{can_id:03X}" for can_id in sorted(unknown)[:_MOST_IDENTIFIERS])
        identifiers += ", ..." if len(unknown) > _MOST_IDENTIFIERS else ""
        others.append(f"{counted(unknown.total(), 'frame')} that the machine's PDO maps do not name ({identifiers})")
    return syncs, raw, others


def _ticks(syncs_s: np.ndarray, period_s: float, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return tick number and lateness [s] of every SYNC; a skipped tick leaves a step in time, as on the bus."""
    if syncs_s.size < 2:
        return np.zeros(syncs_s.size), np.zeros(syncs_s.size)
    steps = np.diff(syncs_s)
    if np.isnan(steps).any():
        warnings.warn(f"{path}: has no time stamps; SYNCs are counted", RecordingWarning, stacklevel=2)
        return np.arange(syncs_s.size, dtype=np.float64), np.full(syncs_s.size, np.nan)
    if np.any(steps < 0.0) or abs(np.median(steps) - period_s) > BELIEVABLE_PERIOD * period_s:
        found_ms, wanted_ms = float(np.median(steps)) * 1e3, period_s * 1e3
        warnings.warn(
            f"{path}: {found_ms:.4g} ms between SYNCs by its time stamps, {wanted_ms:.4g} ms by the machine file; SYNCs are counted",
            RecordingWarning,
            stacklevel=2,
        )
        return np.arange(syncs_s.size, dtype=np.float64), np.full(syncs_s.size, np.nan)
    ticks, lateness = np.zeros(syncs_s.size), np.zeros(syncs_s.size)
    due = syncs_s[0]
    for row in range(1, syncs_s.size):
        passed = max(1.0, np.rint((syncs_s[row] - due) / period_s))
        ticks[row] = ticks[row - 1] + passed
        due += passed * period_s
        lateness[row] = syncs_s[row] - due
        due += PHASE_GAIN * lateness[row]
    return ticks, lateness


def _scaled(raw: np.ndarray, quantity: str, scaling: AxisScaling) -> np.ndarray:
    match quantity:
        case "position":
            return scaling.sign * scaling.position_resolution * _unwrapped(raw)
        case "link_position":
            return scaling.sign * scaling.link_resolution * (_unwrapped(raw) - scaling.link_zero_counts)
        case "effort":
            return scaling.sign * scaling.rated * raw / 1000.0
        case _:
            return raw


def _unwrapped(counts: np.ndarray) -> np.ndarray:
    """Unwrap the counts of a 32-bit register."""
    present = ~np.isnan(counts)
    unwrapped = counts.copy()
    unwrapped[present] = np.unwrap(counts[present], period=2.0**32)
    return unwrapped


def _home_offset(scaled: dict[str, np.ndarray]) -> float:
    """Return homing's offset of the motor-side position, which the log lacks: it is taken from the link encoder where there is one."""
    if "link_position" not in scaled:
        return 0.0
    both = np.flatnonzero(~np.isnan(scaled["position"]) & ~np.isnan(scaled["link_position"]))
    return float(scaled["link_position"][both[0]] - scaled["position"][both[0]]) if both.size else 0.0


def _channel_name(quantity: str, units: AxisUnits) -> str:
    return f"{'current' if quantity == 'effort' and units.effort == 'A' else quantity}_{units.axis}"


def _unit(quantity: str, units: AxisUnits) -> str:
    return {"effort": units.effort, "statusword": ""}.get(quantity, units.position)
