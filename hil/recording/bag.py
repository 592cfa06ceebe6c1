"""Bags: ROS 2's (`.mcap`, `.db3`, or the folder of both) with sensor_msgs/JointState, and MCAP files with messages in JSON.

A signal of a bag is named by topic, quantity and joint, `/joint_states.position[roll]`, or by topic and field, `/bench.motor.current`.
Its times are the stamps in the messages' headers, where there is none the times of logging. Joints with the names of the machine's axes
need no further names.
"""

from __future__ import annotations

import json
import re
import sqlite3
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.errors import RecordingError
from hil.files.regular import check_regular
from hil.recording.bag_topic import Signals, Topic, signals_of
from hil.recording.can_frames import counted
from hil.recording.joint_states import JOINT_STATE_TYPES, QUANTITIES, joint_states
from hil.recording.mcap_stream import mcap_package, mcap_records
from hil.recording.metadata import machine_table
from hil.recording.naming import Columns, Target, is_channel
from hil.recording.rasters import channels_on_one_raster
from hil.recording.recording import Recording
from hil.recording.said import listed, printable, source_table
from hil.recording.zstd import PACKED, ZSTD_MARK, unpacked_file, unpacked_message

if TYPE_CHECKING:
    from hil.machine.machine import Machine

_MOST_NS = 2**62
"""Of a time of day: in the year 2116."""

_MOST_FIELDS = 1000
"""Of one message in JSON."""


@dataclass
class Bag:
    """What a bag holds.

    Parameters
    ----------
    rows : dict
        Topic of JSON -> (time of logging [ns], the file's channel, message).
    cdr : dict
        Topic of joint states -> (time of logging [ns], the file's channel, message in CDR).
    other : Counter
        Topic and type of what is not read -> messages.
    schemas, attachments : dict
        Topic -> its schema; name -> attachment.
    """

    rows: dict[str, list[tuple[int, int, dict[str, Any]]]] = field(default_factory=lambda: defaultdict(list))
    cdr: dict[str, list[tuple[int, int, bytes]]] = field(default_factory=lambda: defaultdict(list))
    other: Counter[str] = field(default_factory=Counter)
    schemas: dict[str, bytes] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)


def read_bag(path: Path, machine: Machine | None = None, names: Mapping[str, Target] | None = None) -> Recording:
    """Read a `.db3`, or a bag's folder with its metadata.yaml.

    Raises
    ------
    RecordingError
        As in `recording_of_bag`; or the bag holds no file, or one that is damaged or unpacks to too much.
    UnusableInputError
        mcap or mcap-ros2-support is not installed.
    """
    files = [path] if path.is_file() else sorted((one for one in path.iterdir() if _kind(one) in (".mcap", ".db3")), key=_number)
    kinds = {_kind(one) for one in files}
    if len(kinds) != 1:
        raise RecordingError(f"{path}: holds no .mcap or .db3, or both; a bag has files of one kind")
    with tempfile.TemporaryDirectory(prefix="isocenter-bag-") as folder:
        plain = [unpacked_file(one, Path(folder)) if one.suffix == PACKED else one for one in files]
        try:
            bag = bag_of_mcap(plain) if kinds == {".mcap"} else _bag_of_sqlite(plain)
        except RecordingError as problem:
            raise RecordingError(str(problem).replace(folder, str(path))) from None
    return recording_of_bag(bag, path, machine, names)


def bag_of_mcap(paths: Sequence[Path]) -> Bag:
    """Return what MCAP files hold; RecordingError if one is damaged."""
    records = mcap_package("mcap.records")
    bag = Bag()
    for path in paths:
        channels: dict[int, Any] = {}
        schemas: dict[int, Any] = {}
        first: dict[str, dict[int, int]] = {}  # topic -> channel -> its number, the same in all files of a bag
        for record in mcap_records(path):
            if isinstance(record, records.Schema):
                schemas[record.id] = record
            elif isinstance(record, records.Channel):
                channels[record.id] = record
                if record.schema_id in schemas:
                    bag.schemas[record.topic] = schemas[record.schema_id].data
            elif isinstance(record, records.Attachment):
                bag.attachments[record.name] = record.data
            elif isinstance(record, records.Message):
                channel = channels.get(record.channel_id)
                if channel is None:
                    raise RecordingError(f"{path}: damaged: a message of channel {record.channel_id}, which was not announced")
                schema = schemas.get(channel.schema_id)
                kind = schema.name if schema is not None else "no type"
                number = first.setdefault(channel.topic, {}).setdefault(channel.id, len(first[channel.topic]))
                _sort(bag, path, channel.topic, channel.message_encoding, kind, (record.log_time, number), record.data)
    return bag


def _bag_of_sqlite(paths: Sequence[Path]) -> Bag:
    bag = Bag()
    for path in paths:
        check_regular(path, RecordingError)
        try:
            with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as base:
                for topic, kind, encoding, time_ns, data in _messages(base, path):
                    _sort(bag, path, topic, encoding, kind, (time_ns, 0), data)
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as problem:
            raise RecordingError(f"{path}: no bag of ROS 2, or damaged: {printable(str(problem))}") from None
    return bag


def _messages(base: sqlite3.Connection, path: Path) -> Iterator[tuple[str, str, str, int, bytes]]:
    kinds = dict(base.execute("SELECT name, type FROM sqlite_master WHERE name IN ('messages', 'topics')"))
    if kinds != {"messages": "table", "topics": "table"}:  # a view could be anything, without end
        raise RecordingError(f"{path}: no bag of ROS 2: it lacks the tables topics and messages")
    topics = {key: rest for key, *rest in base.execute("SELECT id, name, type, serialization_format FROM topics")}
    for key, time_ns, data in base.execute("SELECT topic_id, timestamp, data FROM messages"):
        name, kind, encoding = topics.get(key, (None, None, None))
        if not (isinstance(name, str) and isinstance(kind, str) and isinstance(time_ns, int) and isinstance(data, bytes)):
            raise RecordingError(f"{path}: damaged: a message of topic {key} without topic, time or data")
        yield name, kind, str(encoding), time_ns, data


def _sort(bag: Bag, path: Path, topic: str, encoding: str, kind: str, origin: tuple[int, int], data: bytes) -> None:
    """Put a message where it belongs; `origin` is its time of logging [ns] and its channel."""
    if not 0 <= origin[0] < _MOST_NS:
        raise RecordingError(f"{path}: damaged: topic {topic}: a message logged at {origin[0]} ns, which is no time")
    if encoding == "cdr" and kind in JOINT_STATE_TYPES:
        data = unpacked_message(data, path) if data.startswith(ZSTD_MARK) else data
        bag.cdr[topic].append((*origin, data))
    elif encoding == "json":
        try:
            message = json.loads(data)
        except (ValueError, RecursionError) as problem:
            raise RecordingError(f"{path}: topic {topic}: a message that is no JSON: {problem}") from None
        if isinstance(message, dict):
            bag.rows[topic].append((*origin, message))
        else:
            bag.other[f"{topic}, JSON without names"] += 1
    else:
        bag.other[f"{topic}, {kind} in {encoding}"] += 1


def recording_of_bag(bag: Bag, path: Path, machine: Machine | None, names: Mapping[str, Target] | None) -> Recording:
    """Return a bag's signals as channels on one raster.

    Parameters
    ----------
    bag : Bag
    path : Path
        For the messages.
    machine : Machine
        Its axes are the joints that need no names; it gives units, and the rate of the rows.
    names : mapping, optional
        Signal of the bag -> channel.

    Raises
    ------
    RecordingError
        There is no machine, nothing to take, two signals would be the same channel, or a message is damaged.
    """
    if machine is None:
        raise RecordingError(f"{path}: a bag says neither machine nor units; name the machine with --machine")
    topics = [joint_states(topic, messages, path) for topic, messages in bag.cdr.items()]
    topics += [_fields(topic, rows, bag.other) for topic, rows in bag.rows.items()]
    signals = signals_of(topics)
    columns, notes = signals.columns, list(signals.notes)
    wanted = dict(names) if names else _known_names(signals, machine, path, notes)
    if lost := [signals.disorder[name] for name in wanted if name in signals.disorder and name not in signals.several]:
        raise RecordingError(f"{path}: {lost[0]}; nothing in the file tells them apart: record one of them alone")
    channels, resampled = channels_on_one_raster(Columns(columns, signals.several, signals.disorder), wanted, machine, path)
    not_taken = [name for name in columns if name not in wanted]
    not_taken += [f"{what} ({counted(number, 'message')})" for what, number in bag.other.items()]
    not_taken += [why for name, why in signals.disorder.items() if not any(one in wanted for one in signals.several.get(name, ()))]
    not_taken += [f"{counted(signals.repeated, 'sample')} at the time of another"] if signals.repeated else []
    source = source_table(path, not_taken, [*notes, *resampled], {name: one.channel for name, one in wanted.items()})
    try:
        return Recording(channels, {"machine": machine_table(machine), "source": source})
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None


def _known_names(signals: Signals, machine: Machine, path: Path, notes: list[str]) -> dict[str, Target]:
    """Return the signals whose names are channels' or quantities of the machine's axes."""
    columns = signals.columns
    wanted: dict[str, Target] = {}
    efforts: set[str] = set()
    for name in [*columns, *signals.disorder]:
        match = re.fullmatch(r"(.+)\.(\w+)\[(.+)\]", name)
        channel = name.rpartition(".")[2]
        if match and match[2] in QUANTITIES and match[3] in machine.axes:
            effort = machine.units[machine.axis_index(match[3])].effort
            channel = f"{QUANTITIES[match[2]] or ('current' if effort == 'A' else 'effort')}_{match[3]}"
            if match[2] == "effort" and effort not in ("Nm", "N"):
                instead = f"--map '{name}=effort_{match[3]} [Nm]'"
                efforts.add(f"{name} is taken in {effort}, the drive's unit, where ROS has Nm or N; {instead} takes it so")
        elif match or not is_channel(channel, machine) or channel == "time":
            continue
        if name in signals.disorder:
            raise RecordingError(f"{path}: {signals.disorder[name]}; {_way_out(name, channel, signals)}")
        same = [other for other, one in wanted.items() if one.channel == channel]
        if same:
            raise RecordingError(f"{path}: {same[0]} and {name} would both be {channel}; say with --map which is")
        wanted[name] = Target(channel)
    if not wanted:
        axes = ", ".join(machine.axes)
        raise RecordingError(f"{path}: no signal of the axes {axes}; name some with --map, of {listed(list(columns)) or 'none'}")
    notes.extend(sorted(efforts))
    return wanted


def _way_out(name: str, channel: str, signals: Signals) -> str:
    """Return how a signal of several senders can be taken."""
    if name not in signals.several:
        return "nothing in the file tells them apart: record one of them alone, or take other signals with --map"
    ways = [f"'{part}={channel}' ({counted(signals.columns[part].values.size, 'sample')})" for part in signals.several[name]]
    return f"take one with --map {' or '.join(ways)}"


def _fields(topic: str, rows: Sequence[tuple[int, int, dict[str, Any]]], other: Counter[str]) -> Topic:
    """Return the numbers in messages of JSON, by topic and path of names; what is none goes to `other`."""
    found = Topic(topic)
    for number, (logged_ns, channel, message) in enumerate(rows):
        found.add(0, logged_ns, channel)
        waiting: list[tuple[str, Any]] = [(topic, message)]
        for _ in range(_MOST_FIELDS):
            if not waiting:
                break
            name, value = waiting.pop()
            if isinstance(value, dict):
                waiting.extend((f"{name}.{key}", inner) for key, inner in value.items())
            elif isinstance(value, list):
                waiting.extend((f"{name}[{place}]", inner) for place, inner in enumerate(value))
            elif isinstance(value, int | float):
                found.samples[name].append((number, float(value)))
            elif value is not None:
                other[f"{name}, no number"] += 1
        if waiting:
            other[f"{topic}, fields beyond {_MOST_FIELDS}"] += 1
    return found


def _kind(path: Path) -> str:
    """Return the suffix of a file of a bag, which may be compressed."""
    return Path(path.stem).suffix if path.suffix == PACKED else path.suffix


def _number(path: Path) -> tuple[int, str]:
    """Return the number of a bag's part, as in `bag_12.db3`, for their order."""
    found = re.search(r"_(\d+)\.", path.name)
    return int(found[1]) if found else -1, path.name
