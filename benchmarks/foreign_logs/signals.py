"""Recordings whose signals have times of their own: MDF by asammdf, MCAP and ROS 2 bags by mcap, Foxglove's SDK and rosbags."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from foreign_logs.known import FORMULAS, STATUS, Foreign, Known, START_s, TIME_s, as_put_in, signal

UNITS = {name: "A" if "current" in name else "rad" for name in FORMULAS}
PAIR = ("position_roll", "current_roll")
SLOW_s = 2e-3 + np.arange(140) / 100.0
"""A raster of 100 Hz that begins later and ends before."""

_START_ns = round(START_s * 1e9)
_TIMES_ns = [_START_ns + round(time * 1e9) for time in TIME_s.tolist()]


def slow(name: str) -> Known:
    """Return a signal of the slow raster on the rows, interpolated; NaN outside."""
    values = np.interp(TIME_s, SLOW_s, signal(name, SLOW_s), left=np.nan, right=np.nan)
    return Known(values, 1e-10)


def held() -> Known:
    """Return a status of the slow raster on the rows, held; known until one and a half steps after its last sample."""
    last = np.searchsorted(SLOW_s, TIME_s + 1e-12, side="right") - 1
    known = (last >= 0) & (TIME_s - SLOW_s[last] <= 0.015)
    return Known(np.where(known, STATUS[np.maximum(last, 0)], np.nan))


def mdf(version: str, compression: int, fill: Callable[[Any], None], file: str = "log.mf4") -> Callable[[Path], Path]:
    """Return a maker with asammdf."""

    def make(folder: Path) -> Path:
        from asammdf import MDF

        with MDF(version=version) as made:
            fill(made)
            saved = made.save(folder / "made", compression=compression)
        return Path(saved).rename(folder / file)

    return make


def one_group(made: Any) -> None:
    from asammdf import Signal

    made.append([Signal(signal(name), TIME_s, unit=unit, name=name) for name, unit in UNITS.items()], common_timebase=True)


def group_each(made: Any) -> None:
    from asammdf import Signal

    for name, unit in UNITS.items():
        made.append([Signal(signal(name), TIME_s, unit=unit, name=name)])


def two_rasters(made: Any) -> None:
    from asammdf import Signal

    one = [Signal(signal(name, SLOW_s), SLOW_s, unit=UNITS[name], name=name) for name in ("position_roll", "position_propeller")]
    one.append(Signal(STATUS[: len(SLOW_s)].astype(np.uint16), SLOW_s, name="statusword_roll"))
    made.append(one, common_timebase=True)
    made.append([Signal(signal("current_roll"), TIME_s, unit="A", name="current_roll")], common_timebase=True)


def converted(made: Any) -> None:
    """Raw counts with linear conversions, other units, a text, a table of texts, an array."""
    from asammdf import Signal

    angle = np.round(np.degrees(signal("position_roll")) / 1e-4).astype(np.int32)
    ampere = np.round(1e3 * signal("current_roll")).astype(np.int16)
    modes = {"val_0": 0, "text_0": b"idle", "val_1": 1, "text_1": b"jog", "default": b"?"}
    signals = [
        Signal(angle, TIME_s, unit="deg", name="position_roll", conversion={"a": 1e-4, "b": 0.0}),
        Signal(ampere, TIME_s, unit="mA", name="current_roll"),
        Signal((np.arange(len(TIME_s)) % 2).astype(np.uint8), TIME_s, name="mode", conversion=modes),
        Signal(np.array([b"scan"] * len(TIME_s)), TIME_s, name="phase", encoding="utf-8"),
        Signal(np.rec.fromarrays([np.zeros((len(TIME_s), 3))], dtype=[("wrench", "(3,)<f8")]), TIME_s, name="wrench"),
    ]
    made.append(signals, common_timebase=True)


def foreign_names(made: Any) -> None:
    from asammdf import Signal

    signals = [
        Signal(np.degrees(signal("position_roll")), TIME_s, unit="°", name="Axes.Roll.ActPos"),
        Signal(signal("current_roll"), TIME_s, unit="A", name="Axes.Roll.ActCurrent\\XCP:1"),
        Signal(signal("position_propeller"), TIME_s, unit="", name="Axes.Prop.ActPos"),
    ]
    made.append(signals, common_timebase=True)


def invalid(made: Any) -> None:
    from asammdf import Signal

    bits = np.arange(len(TIME_s)) % 10 == 3
    made.append([Signal(signal("current_roll"), TIME_s, unit="A", name="current_roll", invalidation_bits=bits)], common_timebase=True)
    made.append([Signal(signal("position_roll"), TIME_s, unit="rad", name="position_roll")], common_timebase=True)


def exported_csv(folder: Path) -> Path:
    """By asammdf's export, with its row of units."""
    path = mdf("4.10", 0, one_group)(folder)
    from asammdf import MDF

    with MDF(path) as made:
        made.export("csv", folder / "export.csv", add_units=True, single_time_base=True)
    path.unlink()
    return next(folder.glob("*.csv"))


def mcap_json(compression: str, **options: object) -> Callable[[Path], Path]:
    """Return a maker with mcap's writer: messages in JSON, and others."""

    def make(folder: Path) -> Path:
        from mcap.writer import CompressionType, Writer

        with (folder / "log.mcap").open("wb") as file:
            writer = Writer(file, compression=CompressionType[compression], **options)
            writer.start(profile="", library="bench")
            schema = writer.register_schema("bench.Drive", "jsonschema", json.dumps({"type": "object"}).encode())
            drive = writer.register_channel("/bench/roll", "json", schema)
            image = writer.register_channel("/bench/image", "raw", 0)
            for k, time_ns in enumerate(_TIMES_ns):
                message = {"motor": {"q": signal("position_roll")[k], "i": signal("current_roll")[k]}, "list": [1, k], "phase": "scan"}
                writer.add_message(drive, time_ns, json.dumps(message).encode(), time_ns, k)
                writer.add_message(image, time_ns, b"\0", time_ns, k)
            writer.finish()
        return folder / "log.mcap"

    return make


def foxglove_log(folder: Path) -> Path:
    """By Foxglove's SDK, which logs dictionaries as JSON."""
    import foxglove

    with foxglove.open_mcap(folder / "log.mcap"):
        channel = foxglove.Channel("/roll", message_encoding="json")
        for k, time_ns in enumerate(_TIMES_ns):
            channel.log({"position_roll": signal("position_roll")[k], "current_roll": signal("current_roll")[k]}, log_time=time_ns)
    return folder / "log.mcap"


JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def _state(k: int, names: Sequence[str] = ("roll", "propeller")) -> dict[str, Any]:
    stamp = {"sec": _TIMES_ns[k] // 10**9, "nanosec": _TIMES_ns[k] % 10**9}
    return {
        "header": {"stamp": stamp, "frame_id": ""},
        "name": list(names),
        "position": [float(signal("position_roll")[k]), float(signal("position_propeller")[k])],
        "velocity": [],
        "effort": [float(signal("current_roll")[k]), 0.0],
    }


def mcap_ros2(folder: Path) -> Path:
    """By mcap-ros2-support."""
    from mcap_ros2.writer import Writer

    with Writer(str(folder / "log.mcap")) as writer:
        kind = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        text = writer.register_msgdef("std_msgs/msg/String", "string data")
        for k, time_ns in enumerate(_TIMES_ns):
            writer.write_message("/joint_states", kind, _state(k), time_ns + 400_000, time_ns + 300_000)
            writer.write_message("/phase", text, {"data": "scan"}, time_ns)
    return folder / "log.mcap"


def bag(
    plugin: str, version: int = 9, packed: str = "", names: Sequence[str] = ("roll", "propeller"), whole: bool = True
) -> Callable[[Path], Path]:
    """Return a maker with rosbags; `packed` is its mode of compression."""

    def make(folder: Path) -> Path:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_HUMBLE)
        types = store.types
        writer = Writer(folder / "bag", version=version, storage_plugin=StoragePlugin[plugin])
        if packed:
            writer.set_compression(CompressionMode[packed], CompressionFormat.ZSTD)
        with writer:
            states = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
            imu = writer.add_connection("/imu", "geometry_msgs/msg/Vector3", typestore=store)
            for k, time_ns in enumerate(_TIMES_ns):
                state = _state(k, names)
                stamp = types["builtin_interfaces/msg/Time"](**state["header"]["stamp"])
                arrays = [np.array(state[field]) for field in ("position", "velocity", "effort")]
                message = types["sensor_msgs/msg/JointState"](types["std_msgs/msg/Header"](stamp, ""), state["name"], *arrays)
                writer.write(states, time_ns + 400_000, store.serialize_cdr(message, message.__msgtype__))
                vector = types["geometry_msgs/msg/Vector3"](0.1, 0.2, 9.8)
                writer.write(imu, time_ns, store.serialize_cdr(vector, vector.__msgtype__))
        return folder / "bag" if whole else next(one for one in (folder / "bag").iterdir() if one.suffix != ".yaml")

    return make


def _mdf(name: str, make: Callable[[Path], Path], **more: object) -> Foreign:
    return Foreign(f"mdf-{name}", "MDF", "asammdf", make, **{"known": as_put_in(), "time_within_s": 1e-9} | more)


def _ros(name: str, tool: str, make: Callable[[Path], Path], **more: object) -> Foreign:
    left = ("/joint_states.effort[propeller]",) if "maps" in more else ()
    basics = {"known": as_put_in(), "left": left, "noted": () if "maps" in more else ("taken in A",), "time_within_s": 2e-9}
    return Foreign(name, "ROS 2 bag", tool, make, **basics | more)


_RASTERS = {name: slow(name) for name in ("position_roll", "position_propeller")} | {
    "statusword_roll": held(),
    "current_roll": Known(signal("current_roll")),
}
_JSON = {"known": as_put_in(names=PAIR), "left": ("/bench/image", "list"), "time_within_s": 2e-9}
_JSON |= {"maps": ("/bench/roll.motor.q=position_roll [rad]", "/bench/roll.motor.i=current_roll [A]")}
_IMU = ("/imu, geometry_msgs/msg/Vector3",)
_JOINTS = ("/joint_states.position[shoulder]=position_roll", "/joint_states.position[base]=position_propeller")
FILES = [
    *(_mdf(f"{version}-{word}", mdf(version, number, one_group))
      for version, number, word in (("4.00", 0, "plain"), ("4.10", 1, "deflate"), ("4.11", 2, "transposed"), ("4.20", 0, "plain"),
                                    ("4.30", 3, "zstd"),
                                    ("4.30", 6, "lz4"))),
    _mdf("group-each", mdf("4.10", 1, group_each)),
    _mdf("two-rasters", mdf("4.10", 2, two_rasters), known=_RASTERS, noted=("interpolated",)),
    _mdf("conversions", mdf("4.10", 1, converted),
         known={"position_roll": Known(signal("position_roll"), 1e-6), "current_roll": Known(signal("current_roll"), 5.1e-4)},
         left=("mode", "phase", "wrench")),
    _mdf("foreign-names", mdf("4.10", 0, foreign_names),
         maps=("Axes.Roll.ActPos=position_roll [deg]", "Axes.Roll.ActCurrent\\XCP:1=current_roll",
               "Axes.Prop.ActPos=position_propeller [rad]")),
    _mdf("invalid", mdf("4.10", 0, invalid), known={"position_roll": Known(signal("position_roll")),
         "current_roll": Known(np.where(np.arange(len(TIME_s)) % 10 == 3, np.nan, signal("current_roll")))}),
    _mdf("3.30", mdf("3.30", 0, one_group, "log.mdf")),
    _mdf("3.10-dat", mdf("3.10", 0, group_each, "log.dat")),
    _mdf("3.20-rasters", mdf("3.20", 0, two_rasters, "log.mdf"), known=_RASTERS, noted=("interpolated",)),
    Foreign("csv-export", "CSV", "asammdf", exported_csv, as_put_in(), maps=("timestamps=time",)),
    Foreign("mcap-json-zstd", "MCAP", "mcap", mcap_json("ZSTD"), **_JSON),
    Foreign("mcap-json-lz4", "MCAP", "mcap", mcap_json("LZ4", chunk_size=4096), **_JSON),
    Foreign("mcap-json-bare", "MCAP", "mcap", mcap_json("NONE", use_chunking=False), **_JSON),
    Foreign("mcap-foxglove", "MCAP", "Foxglove SDK", foxglove_log, as_put_in(names=PAIR), time_within_s=2e-9),
    _ros("ros2-mcap", "mcap-ros2-support", mcap_ros2, left=("/phase, std_msgs/msg/String",)),
    _ros("bag-sqlite", "rosbags", bag("SQLITE3"), left=_IMU),
    _ros("bag-sqlite-8", "rosbags", bag("SQLITE3", version=8), left=_IMU),
    _ros("bag-db3-alone", "rosbags", bag("SQLITE3", whole=False), left=_IMU),
    _ros("bag-mcap", "rosbags", bag("MCAP"), left=_IMU),
    _ros("bag-mcap-alone", "rosbags", bag("MCAP", whole=False), left=_IMU),
    _ros("bag-other-joints", "rosbags", bag("MCAP", names=("shoulder", "base")),
         known=as_put_in(names=("position_roll", "position_propeller")), maps=_JOINTS,
         left=(*_IMU, "/joint_states.effort[shoulder]", "/joint_states.effort[base]")),
    _ros("bag-messages-packed", "rosbags", bag("SQLITE3", packed="MESSAGE"), left=_IMU),
    _ros("bag-file-packed", "rosbags", bag("SQLITE3", packed="FILE"), left=_IMU),
]  # fmt: skip
