"""Rows go to Foxglove while they are recorded: each once, in order, as the recording then has them, and on the loopback only."""

from __future__ import annotations

import contextlib
import json
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from command_line import Isocenter
from websockets.sync.client import ClientConnection, connect

from hil.recording import JournalSink, RecorderProcess, read_recording

CHANNELS = [("time", "s"), ("reference_roll", "rad"), ("current_roll", "A")]
METADATA = {"machine": {"name": "carm", "hash": "ab", "axes": ["roll"], "text": ""}}
WAIT_S = 60.0


def row(k: int) -> np.ndarray:
    return np.array([k / 256.0, 0.1 * k, np.nan if k % 7 == 3 else -float(k)])


@pytest.fixture
def server(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command in a folder, and the address that it says."""
    command = [sys.executable, "-m", "hil", "foxglove", str(tmp_path), "--port", "0", "--json", "-"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    ready = process.stdout.readline()
    assert ready, process.stderr and process.stderr.read()
    yield process, json.loads(ready)["url"]
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=WAIT_S)


def said(client: ClientConnection, operation: str) -> dict[str, object]:
    """The next message of the server about something."""
    while True:
        text = client.recv(timeout=WAIT_S)
        if isinstance(text, str) and (message := json.loads(text))["op"] == operation:
            return dict(message)


def message(client: ClientConnection, wait_s: float = WAIT_S) -> tuple[int, dict[str, float]]:
    """Time and row of the next data message: opcode, subscription, time, payload."""
    while True:
        data = client.recv(timeout=wait_s)
        if isinstance(data, bytes) and data[0] == 1:
            _, time_ns = struct.unpack_from("<IQ", data, 1)
            return time_ns, json.loads(data[13:])


def test_a_viewer_gets_every_row_while_it_is_recorded(tmp_path: Path, server: tuple[subprocess.Popen[str], str]) -> None:
    _, url = server
    path = tmp_path / "run.csv"
    with connect(url, subprotocols=["foxglove.sdk.v1"]) as client, RecorderProcess(path, CHANNELS, METADATA) as recorder:  # type: ignore[list-item]
        recorder.put(row(0))
        advertised = said(client, "advertise")
        (channel,) = advertised["channels"]  # type: ignore[misc]
        assert (channel["topic"], channel["encoding"], channel["schemaEncoding"]) == ("/isocenter/recording", "json", "jsonschema")
        schema = json.loads(channel["schema"])
        assert {name: entry["unit"] for name, entry in schema["properties"].items()} == dict(CHANNELS)
        rows, seen = 1, []
        while not seen:  # no answer says when a subscription has begun, and one that comes at once may be too early
            client.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": rows, "channelId": channel["id"]}]}))
            recorder.put(row(rows))
            rows += 1
            with contextlib.suppress(TimeoutError):
                seen.append(message(client, 1.0))
        for k in range(rows, rows + 300):
            recorder.put(row(k))
        while seen[-1][1]["time"] < (rows + 299) / 256.0:
            seen.append(message(client))
        assert not path.exists()  # the recording has not ended yet
    recording = read_recording(path)
    assert len(seen) > 300
    for (time_ns, sent), k in zip(seen, range(recording.rows - len(seen), recording.rows), strict=True):
        jsonschema.validate(sent, schema)
        assert sent["time"] == recording.time[k]
        assert sent.get("current_roll", np.nan) == pytest.approx(recording["current_roll"][k], nan_ok=True)
        assert time_ns - seen[0][0] == pytest.approx(round((sent["time"] - seen[0][1]["time"]) * 1e9), abs=1)


def test_a_recording_that_was_cut_short_does_not_hide_the_next(tmp_path: Path, server: tuple[subprocess.Popen[str], str]) -> None:
    process, url = server
    assert process.stderr is not None
    JournalSink(tmp_path / "left.csv", CHANNELS, METADATA)  # never closed
    viewer = connect(url, subprotocols=["foxglove.sdk.v1"])  # type: ignore[list-item]
    with viewer as client, JournalSink(tmp_path / "next.csv", CHANNELS, METADATA) as sink:
        for k in range(600):
            sink.put(row(k))
        said(client, "advertise")
    while not (line := process.stderr.readline()).startswith("next.csv: "):
        assert line
    assert line == "next.csv: 600 rows sent\n"


def test_a_recording_that_has_ended_is_not_waited_for(isocenter: Isocenter, tmp_path: Path) -> None:
    (tmp_path / "run.mf4").write_text("")
    refused = isocenter("foxglove", tmp_path / "run.mf4")
    assert refused.status == 2
    assert "has ended; Foxglove opens `isocenter convert" in refused.line
    assert isocenter("foxglove", tmp_path / "no" / "run.mf4").status == 2


def test_it_listens_on_the_loopback_and_a_taken_port_is_told(
    isocenter: Isocenter, tmp_path: Path, server: tuple[subprocess.Popen[str], str]
) -> None:
    _, url = server
    host, port = url.removeprefix("ws://").split(":")
    assert host == "127.0.0.1"
    refused = isocenter("foxglove", tmp_path, "--port", port)
    assert refused.status == 2
    assert f"--port {port}: cannot be served on 127.0.0.1: " in refused.line
