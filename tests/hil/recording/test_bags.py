"""ROS 2 bags, written by rosbags, and MCAP files with JSON messages: joint states become channels on the machine's rows."""

from __future__ import annotations

import json
import sqlite3
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter
from refusals import answer_or_refusal
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from hil.errors import RecordingError
from hil.machine import Machine, load_machine
from hil.recording import Recording, RecordingWarning, convert, read_recording

PERIOD_ns = 3_906_250
START_ns = 1_700_000_000_000_000_000
STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
FILES = settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
SUFFIXES = {StoragePlugin.MCAP: ".mcap", StoragePlugin.SQLITE3: ".db3"}
both = pytest.mark.parametrize("plugin", list(StoragePlugin))


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def joint_state(
    stamp_ns: int, names: list[str], position: Sequence[float], velocity: Sequence[float] = (), effort: Sequence[float] = ()
) -> object:
    stamp = TYPES["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    values = [np.array(one, dtype=np.float64) for one in (position, velocity, effort)]
    return TYPES["sensor_msgs/msg/JointState"](TYPES["std_msgs/msg/Header"](stamp, ""), names, *values)


def bag(
    folder: Path,
    messages: list[tuple[str, int, Any]],
    plugin: StoragePlugin = StoragePlugin.MCAP,
    packed: CompressionMode = CompressionMode.NONE,
) -> Path:
    """Write (topic, time of logging [ns], message) and return the folder."""
    made = Writer(folder, version=9, storage_plugin=plugin)
    if packed is not CompressionMode.NONE:
        made.set_compression(packed, CompressionFormat.ZSTD)
    with made as writer:
        connections = {}
        for topic, logged_ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            writer.write(connections[topic], logged_ns, STORE.serialize_cdr(message, message.__msgtype__))
    return folder


def run(joints: list[str], rows: int = 20) -> list[tuple[str, int, Any]]:
    """Position k + j, speed -k, effort 0.5 k of joint j; logged 1 ms after they were stamped."""
    return [
        (
            "/joint_states",
            START_ns + k * PERIOD_ns + 1_000_000,
            joint_state(
                START_ns + k * PERIOD_ns, joints, [float(k + j) for j in range(len(joints))], [-k] * len(joints), [0.5 * k] * len(joints)
            ),
        )
        for k in range(rows)
    ]


def quietly(path: Path, machine: Machine, names: dict[str, str] | None = None) -> tuple[Recording, dict[str, Any]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        recording = read_recording(path, machine, names)
    return recording, recording.metadata["source"]


@both
@pytest.mark.parametrize("whole_folder", [True, False])
def test_joints_with_the_axes_names_become_their_channels(carm: Machine, tmp_path: Path, plugin: StoragePlugin, whole_folder: bool) -> None:
    folder = bag(tmp_path / "bag", run(["propeller", "roll", "lift"]), plugin)
    path = folder if whole_folder else next(file for file in folder.iterdir() if file.suffix != ".yaml")
    recording, source = quietly(path, carm)
    k = np.arange(20)
    np.testing.assert_allclose(recording.time, k * PERIOD_ns * 1e-9, atol=1e-12)
    np.testing.assert_array_equal(recording["position_propeller"], k)
    np.testing.assert_array_equal(recording["position_roll"], k + 1)
    np.testing.assert_array_equal(recording["speed_roll"], -k)
    np.testing.assert_array_equal(recording["current_roll"], 0.5 * k)
    assert {name: recording.channels[name].unit for name in ("position_roll", "speed_roll", "current_roll")} == {
        "position_roll": "rad",
        "speed_roll": "rad/s",
        "current_roll": "A",
    }
    assert source["not_taken"] == [f"/joint_states.{quantity}[lift]" for quantity in ("position", "velocity", "effort")]


def test_efforts_in_the_drives_unit_are_said_and_can_be_taken_as_torques(carm: Machine, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", run(["roll"]))
    with pytest.warns(RecordingWarning, match=r"effort\[roll\] is taken in A, the drive's unit, where ROS has Nm or N; --map"):
        read_recording(folder, carm)
    recording, _ = quietly(folder, carm, {"/joint_states.effort[roll]": "effort_roll [Nm]"})
    assert recording.channels["effort_roll"].unit == "Nm"


def test_a_bag_converts_and_needs_no_machine_any_more(carm: Machine, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        convert(bag(tmp_path / "bag", run(["roll"])), tmp_path / "run.mf4", carm)
    np.testing.assert_array_equal(read_recording(tmp_path / "run.mf4")["position_roll"], np.arange(20))


def test_joints_with_other_names_are_listed_and_can_be_named(carm: Machine, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", run(["joint_1"]))
    with pytest.raises(
        RecordingError, match=r"no signal of the axes propeller, roll; name some with --map, of /joint_states\.position\[joint_1\]"
    ):
        read_recording(folder, carm)
    recording, _ = quietly(folder, carm, {"/joint_states.position[joint_1]": "position_roll [deg]"})
    np.testing.assert_allclose(recording["position_roll"], np.arange(20) * np.pi / 180.0)


def test_a_joint_of_two_topics_is_refused_with_both_names(carm: Machine, tmp_path: Path) -> None:
    messages = run(["roll"]) + [("/other", logged, message) for _, logged, message in run(["roll"])]
    with pytest.raises(RecordingError, match=r"/joint_states\.position\[roll\] and /other\.position\[roll\] would both be position_roll"):
        read_recording(bag(tmp_path / "bag", messages), carm)


def test_joints_of_messages_in_turn_and_of_two_rates_share_the_machines_rows(carm: Machine, tmp_path: Path) -> None:
    fast = run(["roll"], 21)
    slow = [
        ("/slow", logged, joint_state(START_ns + 4 * k * PERIOD_ns, ["propeller"], [8.0 * k])) for k, (_, logged, _) in enumerate(fast[:6])
    ]
    recording, source = quietly(bag(tmp_path / "bag", sorted([*fast, *slow], key=lambda one: one[1])), carm)
    np.testing.assert_allclose(recording["position_propeller"], 2.0 * np.arange(21), atol=1e-9)
    assert any("position_propeller (64 Hz) put onto the rows of position_roll (256 Hz): interpolated" in note for note in source["notes"])


def test_without_stamps_the_times_of_logging_count_and_repeats_are_counted(carm: Machine, tmp_path: Path) -> None:
    messages = [("/joint_states", START_ns + k * PERIOD_ns, joint_state(0, ["roll"], [float(k)])) for k in (0, 1, 2, 2, 3)]
    recording, source = quietly(bag(tmp_path / "bag", messages), carm)
    np.testing.assert_allclose(recording.time, np.arange(4) * PERIOD_ns * 1e-9, atol=1e-12)
    assert source["not_taken"] == ["1 sample at the time of another"]


def test_topics_of_other_types_are_listed(carm: Machine, tmp_path: Path) -> None:
    text = TYPES["std_msgs/msg/String"]("hello")
    _, source = quietly(bag(tmp_path / "bag", [*run(["roll"]), ("/words", START_ns, text), ("/words", START_ns + 1, text)]), carm)
    assert source["not_taken"] == ["/words, std_msgs/msg/String in cdr (2 messages)"]


def test_a_message_with_more_names_than_values_is_refused(carm: Machine, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", [("/joint_states", START_ns, joint_state(START_ns, ["roll", "propeller"], [1.0]))])
    with pytest.raises(RecordingError, match=r"/joint_states: message 0 has 2 names and 1 values of position"):
        read_recording(folder, carm)


def test_mcap_with_json_messages_is_named_by_topic_and_field(carm: Machine, tmp_path: Path) -> None:
    with (tmp_path / "bench.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("bench", "jsonschema", b"{}")
        channel = writer.register_channel("/bench", "json", schema)
        for k in range(10):
            message = {"motor": {"current_roll": 0.1 * k, "mode": "run"}, "encoders": [k, 2 * k], "ok": True}
            writer.add_message(channel, START_ns + k * PERIOD_ns, json.dumps(message).encode(), START_ns)
        writer.finish()
    recording, source = quietly(tmp_path / "bench.mcap", carm)
    np.testing.assert_allclose(recording["current_roll"], 0.1 * np.arange(10))
    assert set(source["not_taken"]) == {
        "/bench.encoders[0]",
        "/bench.encoders[1]",
        "/bench.ok",
        "/bench.motor.mode, no number (10 messages)",
    }
    recording, _ = quietly(tmp_path / "bench.mcap", carm, {"/bench.encoders[1]": "position_roll [mrad]"})
    np.testing.assert_allclose(recording["position_roll"], 2e-3 * np.arange(10))


def test_bags_that_are_none_are_one_line(carm: Machine, tmp_path: Path) -> None:
    (tmp_path / "no.mcap").write_bytes(b"no mcap at all")
    (tmp_path / "no.db3").write_bytes(b"no base at all, only some text")
    folder = bag(tmp_path / "bag", run(["roll"]))
    whole = (folder / "bag.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "packed").mkdir()
    (tmp_path / "packed" / "metadata.yaml").touch()
    (tmp_path / "packed" / "packed_0.db3.zstd").touch()
    base = sqlite3.connect(tmp_path / "view.db3")
    base.execute("CREATE TABLE topics (id, name, type, serialization_format)")
    base.execute(
        "CREATE VIEW messages AS WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k FROM n) SELECT k topic_id, k timestamp, k data FROM n"
    )
    base.commit()
    base.close()
    for name, message in {
        "no.mcap": "no MCAP file, or damaged",
        "no.db3": "no bag of ROS 2, or damaged",
        "cut.mcap": "it was cut off; `mcap recover`",
        "packed": r"packed_0\.db3\.zstd: damaged: there is nothing in it",
        "view.db3": "lacks the tables topics and messages",
    }.items():
        with pytest.raises(RecordingError, match=message) as refusal:
            read_recording(tmp_path / name, carm)
        assert "\n" not in str(refusal.value)
    with pytest.raises(RecordingError, match="a bag says neither machine nor units; name the machine with --machine"):
        read_recording(folder)


@pytest.mark.parametrize("packed", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_a_compressed_bag_is_what_the_plain_one_is(carm: Machine, tmp_path: Path, packed: CompressionMode) -> None:
    plain, _ = quietly(bag(tmp_path / "plain", run(["roll", "propeller"]), StoragePlugin.SQLITE3), carm)
    recording, _ = quietly(bag(tmp_path / "packed", run(["roll", "propeller"]), StoragePlugin.SQLITE3, packed), carm)
    for name in plain.channels:
        np.testing.assert_array_equal(recording[name], plain[name])


def test_a_compressed_bag_that_is_damaged_is_told_by_its_own_name(carm: Machine, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", run(["roll"]), StoragePlugin.SQLITE3, CompressionMode.FILE)
    packed = folder / "bag.db3.zstd"
    content = bytearray(packed.read_bytes())
    content[-9:] = bytes(9)
    packed.write_bytes(content)
    with pytest.raises(RecordingError, match=r"bag\.db3") as refusal:
        read_recording(folder, carm)
    assert str(refusal.value).startswith(str(folder))


@pytest.fixture(scope="module")
def whole_bags(tmp_path_factory: pytest.TempPathFactory) -> dict[StoragePlugin, bytes]:
    folders = tmp_path_factory.mktemp("bags")
    return {
        plugin: (bag(folders / f"{plugin.name}", run(["roll"], 3), plugin) / f"{plugin.name}{suffix}").read_bytes()
        for plugin, suffix in SUFFIXES.items()
    }


@both
@FILES
@given(place=st.integers(0, 100_000), bytes_=st.binary(min_size=1, max_size=4), keep=st.integers(0, 100_000))
def test_a_damaged_bag_is_read_or_refused_in_one_line(
    carm: Machine, tmp_path: Path, whole_bags: dict[StoragePlugin, bytes], plugin: StoragePlugin, place: int, bytes_: bytes, keep: int
) -> None:
    path = tmp_path / f"damaged{SUFFIXES[plugin]}"
    content = bytearray(whole_bags[plugin])
    place %= len(content)
    content[place : place + len(bytes_)] = bytes_
    path.write_bytes(content[: keep + 1] if keep % 3 == 0 else content)
    _, refusal = answer_or_refusal(RecordingError, quietly, path, carm)
    assert refusal is None or "\n" not in refusal
