"""Logs whose stamps and order disagree, by the writers of other tools."""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import can
import numpy as np
import pyarrow
import pyarrow.parquet
from asammdf import MDF, Signal
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from field_inputs.kinds import RIGHT, WRONG, Input, Outcome, refused
from hil.errors import RecordingError
from hil.machine import load_machine
from hil.recording import read_recording

ROWS, RATE_Hz = 200, 256.0
START_ns = 1_760_000_000_000_000_000
COUNT = 1e-4
"""Radians from one sample of the known signal to the next: a value says which sample it is."""

STORE = get_typestore(Stores.ROS2_HUMBLE)
CARM = load_machine("carm")
ROLL = 1
Samples = list[tuple[float, int]]  # stamp [s], number of the sample


def csv_file(folder: Path, samples: Samples) -> Path:
    path = folder / "log.csv"
    path.write_text("time [s],position_roll [rad]\n" + "".join(f"{stamp!r},{COUNT * k!r}\n" for stamp, k in samples))
    return path


def parquet(folder: Path, samples: Samples) -> Path:
    path = folder / "log.parquet"
    table = {"time": [stamp for stamp, _ in samples], "position_roll": [COUNT * k for _, k in samples]}
    pyarrow.parquet.write_table(pyarrow.table(table), path)
    return path


def mdf(folder: Path, samples: Samples) -> Path:
    path = folder / "log.mf4"
    with MDF(version="4.10") as file:
        values, stamps = np.array([COUNT * k for _, k in samples]), np.array([stamp for stamp, _ in samples])
        file.append([Signal(values, stamps, unit="rad", name="position_roll")])
        file.save(path, overwrite=True)
    return path


def json_mcap(folder: Path, samples: Samples) -> Path:
    path = folder / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/arm", "json", 0)
        for stamp, k in samples:
            writer.add_message(channel, START_ns + round(stamp * 1e9), json.dumps({"position_roll": COUNT * k}).encode(), START_ns)
        writer.finish()
    return path


def joint_state(stamp_s: float, position: float, frame: str = "") -> object:
    stamp_ns = START_ns + round(stamp_s * 1e9)
    header = STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9), frame)
    return STORE.types["sensor_msgs/msg/JointState"](header, ["roll"], np.array([position]), np.array([]), np.array([]))


def bag(folder: Path, samples: Samples, plugin: StoragePlugin = StoragePlugin.MCAP, second: Samples = (), frame: str = "") -> Path:
    messages = [(stamp, joint_state(stamp, 0.2 + COUNT * k)) for stamp, k in samples]
    messages += [(stamp, joint_state(stamp, 0.0, frame)) for stamp, _ in second]
    if second:
        messages.sort(key=lambda one: one[0])
    with BagWriter(folder / "bag", version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=STORE)
        for stamp, message in messages:
            writer.write(connection, START_ns + round(stamp * 1e9), STORE.serialize_cdr(message, "sensor_msgs/msg/JointState"))
    return folder / "bag"


def can_log(folder: Path, samples: Samples, suffix: str) -> Path:
    path = folder / f"log{suffix}"
    with can.Logger(path) as logger:
        for stamp, k in samples:
            logger(can.Message(timestamp=1000.0 + stamp, arbitration_id=0x80, is_extended_id=False, channel=0))
            answer = struct.pack("<Hih", 0x1237, k, 0)
            logger(can.Message(timestamp=1000.0 + stamp + 3e-4, arbitration_id=0x182, data=answer, is_extended_id=False, channel=0))
    return path


FORMS: dict[str, tuple[str, Callable[[Path, Samples], Path]]] = {
    "csv": ("text", csv_file),
    "parquet": ("pyarrow", parquet),
    "mf4": ("asammdf", mdf),
    "mcap": ("mcap", json_mcap),
    "bag": ("rosbags", bag),
    "db3": ("rosbags", partial(bag, plugin=StoragePlugin.SQLITE3)),
    **{suffix: ("python-can", partial(can_log, suffix=f".{suffix}")) for suffix in ("log", "asc", "blf", "trc")},
}


def steady() -> Samples:
    return [(k / RATE_Hz, k) for k in range(ROWS)]


def set_back(samples: Samples, at: int = 90, by_s: float = 0.3) -> Samples:
    return [(stamp - by_s * (k >= at), k) for stamp, k in samples]


def set_back_and_on(samples: Samples) -> Samples:
    return [(stamp - 0.3 * (60 <= k < 140), k) for stamp, k in samples]


def out_of_order(samples: Samples) -> Samples:
    places = np.arange(ROWS) + np.random.default_rng(5).integers(0, 5, ROWS)
    places[0] = -1  # writers take the first stamp for the start of the log
    return [samples[k] for k in np.argsort(places, kind="stable")]


def parts_swapped(samples: Samples) -> Samples:
    return samples[120:] + samples[:120]


def copied(samples: Samples) -> Samples:
    return samples[:90] + samples[80:]


def gap(samples: Samples) -> Samples:
    return samples[:90] + samples[97:]


def set_back_by_whole_periods(samples: Samples) -> Samples:
    return set_back(samples, by_s=64 / RATE_Hz)


def set_back_by_a_step(samples: Samples) -> Samples:
    return set_back(samples, by_s=1 / RATE_Hz)


def set_on_and_back(samples: Samples) -> Samples:
    return [(stamp + 0.7 * (60 <= k < 140), k) for stamp, k in samples]


def all_copied(samples: Samples) -> Samples:
    return samples + samples


SOME = (set_back, set_back_and_on, out_of_order, parts_swapped, copied, gap)
MORE = (set_back_by_whole_periods, set_back_by_a_step, set_on_and_back, all_copied)
DISORDERS = {one.__name__: one for one in (*SOME, *MORE)}


def read(path: Path, names: dict[str, str] | None = None) -> tuple[np.ndarray, np.ndarray, str]:
    """Return times, numbers of the samples, and what was said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(path, CARM, names)
    position = recording["position_roll"]
    known = np.isfinite(position)
    unit = CARM.bus.scalings[ROLL].position_resolution if "statusword_roll" in recording else COUNT
    which = (position[known] - (0.2 if path.name == "bag" else 0.0)) / unit
    return recording.time[known], np.rint(which), " ".join(str(one.message) for one in caught)


def judged(folder: Path, form: str, disorder: str) -> Outcome:
    samples = DISORDERS[disorder](steady())
    try:
        time_s, which, said = read(FORMS[form][1](folder, samples))
    except RecordingError as refusal:
        return refused(str(refusal), "first")
    expected = np.array(sorted({k for _, k in samples}))
    if not np.array_equal(which, expected):
        return Outcome(WRONG, f"{len(which)} samples of {len(expected)}, or in another order")
    if np.abs((time_s - time_s[0]) * RATE_Hz - expected).max() > 0.05:
        return Outcome(WRONG, "times are off")
    words = ("clock", "order of their stamps", "twice", "missing", "at the time of another", "of earlier ones")
    return Outcome(RIGHT, said) if any(word in said for word in words) else Outcome(WRONG, f"not said: {said}")


def two_senders(folder: Path, every: int, phase_s: float, frame: str) -> Outcome:
    second = [(k / RATE_Hz + phase_s, 0) for k in range(0, ROWS, every)]
    path = bag(folder, steady(), second=second, frame=frame)
    try:
        read(path)
    except RecordingError as refusal:
        said = str(refusal)
        outcome = refused(said, "senders", "--map")
        for word in said.split():
            if word.startswith("'/joint_states"):
                which = read(path, {word.strip("'").partition("=")[0]: "position_roll"})[1]
                if not (np.array_equal(which, np.arange(ROWS)) or len(which) == len(second)):
                    return Outcome(WRONG, f"{word} is no sender")
        return outcome
    return Outcome(WRONG, "two senders were joined")


def two_in_a_table(folder: Path, form: str, phase: float, offset: float) -> Outcome:
    """Two senders of a position that say nearly the same; the option that the refusal names takes one."""
    swing = 200 * np.sin(np.arange(ROWS) / 11.0)
    samples = [(k / RATE_Hz, float(value)) for k, value in enumerate(swing)]
    samples += [((k + phase) / RATE_Hz, float(value) + offset) for k, value in enumerate(swing)]
    path = FORMS[form][1](folder, sorted(samples, key=lambda one: one[0]))
    try:
        read(path)
    except RecordingError as refusal:
        outcome = refused(str(refusal), "senders", "@1=part", "@2=part")
        if outcome.what != WRONG:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                taken = read_recording(path, CARM, {"@2": "part"})["position_roll"]
            return outcome if np.allclose(taken, COUNT * (swing + offset)) else Outcome(WRONG, "@2 is no sender")
        return outcome
    return Outcome(WRONG, "two senders were joined")


def two_buses(folder: Path, suffix: str) -> Outcome:
    path = folder / f"log{suffix}"
    with can.Logger(path) as logger:
        for k in range(ROWS):
            for bus in (0, 1):
                stamp = 1000.0 + k / RATE_Hz + 1e-5 * bus
                logger(can.Message(timestamp=stamp, arbitration_id=0x80, is_extended_id=False, channel=bus))
                answer = struct.pack("<Hih", 0x1237, k + 500 * bus, 0)
                logger(can.Message(timestamp=stamp + 3e-4, arbitration_id=0x182, data=answer, is_extended_id=False, channel=bus))
    try:
        read(path)
    except RecordingError as refusal:
        buses = [word.removesuffix("=part") for word in str(refusal).split() if word.endswith("=part")]
        if len(buses) == 2 and np.array_equal(read(path, {buses[1]: "part"})[1], np.arange(ROWS) + 500):
            return refused(str(refusal), "SYNCs on", "--map")
        return Outcome(WRONG, str(refusal))
    return Outcome(WRONG, "two buses were joined")


def whose_lines(folder: Path, head: str) -> Outcome:
    path = folder / "log.csv"
    lines = [f"{k / RATE_Hz!r},{name},{COUNT * (k + shift)!r}\n" for k in range(ROWS) for name, shift in (("a", 0), ("b", 1))]
    path.write_text(f"t [s],{head},q [rad]\n" + "".join(lines))
    names = {"t": "time", "q": "position_roll"}
    try:
        read(path, names)
    except RecordingError as refusal:
        if np.array_equal(read(path, names | {f"{head}@b": "part"})[1], np.arange(ROWS) + 1):
            return refused(str(refusal), f"{head}@a=part", f"{head}@b=part")
    return Outcome(WRONG, "lines of two were joined")


PAIRS = [(form, disorder) for form in FORMS for disorder in ("set_back", "out_of_order")]
PAIRS += [(form, disorder) for form in ("csv", "bag", "mf4") for disorder in ("set_back_and_on", "parts_swapped", "copied", "gap")]
TIMED = [form for form in FORMS if form not in ("log", "asc", "blf", "trc")]
PAIRS += [(form, one.__name__) for form in TIMED for one in MORE]
PAIRS += [(form, one.__name__) for form in ("log", "asc", "blf") for one in (set_back_by_whole_periods, all_copied)]
INPUTS = [
    Input(f"{form} {disorder}", "time and senders", FORMS[form][0], partial(judged, form=form, disorder=disorder))
    for form, disorder in PAIRS
]
INPUTS += [
    Input(f"two senders, {name}", "time and senders", "rosbags", partial(two_senders, every=every, phase_s=phase_s, frame=frame))
    for name, every, phase_s, frame in (
        ("every fourth at the same stamps", 4, 0.0, ""),
        ("every fifth between", 5, 1.1e-3, ""),
        ("as many between", 1, 1.9e-3, ""),
        ("of another frame", 4, 0.0, "panel"),
    )
]
INPUTS += [
    Input(f"{form}, two senders {offset:g} apart, {phase:g} of a step between", "time and senders", FORMS[form][0], judge)
    for form in ("csv", "mf4", "parquet")
    for phase, offset in ((0.0, 3.0), (0.2, -2.0), (0.3, 900.0))
    for judge in (partial(two_in_a_table, form=form, phase=phase, offset=offset),)
]
INPUTS += [
    Input(f"{suffix}, two buses", "time and senders", "python-can", partial(two_buses, suffix=suffix)) for suffix in (".asc", ".blf")
]
INPUTS += [Input(f"csv, lines by {head}", "time and senders", "text", partial(whose_lines, head=head)) for head in ("joint", "node_id")]
