"""Rows on their way to the readers: all of them, or as many as a slow one takes, and how punctual they are."""

from __future__ import annotations

import asyncio
import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from hil.bench.told_state import LETTING_GO, ON_THE_WAY, RECORDING, WATCHING
from hil.console.facts import facts_of
from hil.console.rows import LOOKS_AROUND, QUEUE_BYTES, Reader, RowHub
from hil.console.timeliness import Timeliness
from hil.console.told_rows import ToldRows
from hil.machine import load_machine
from hil.recording.journal import Journal

CHANNELS = [("time", "s"), ("sync_lateness", "s"), ("work_time", "s")]
HEADER = struct.Struct("<IIIId")


def taken(reader: Reader, messages: int) -> list[str | bytes]:
    async def take() -> list[str | bytes]:
        return [await asyncio.wait_for(reader.next(), 1.0) for _ in range(messages)]

    return asyncio.run(take())


def table_of(rows: int, first: int = 0) -> np.ndarray:
    time_s = np.arange(first, first + rows) / 256.0
    return np.column_stack((time_s, np.full(rows, 1e-5), np.full(rows, 1e-3)))


def test_a_reader_gets_every_row_as_it_was_recorded(tmp_path: Path) -> None:
    hub = RowHub(tmp_path, 0.0)
    reader = hub.join()
    with Journal.create(tmp_path / "run.mf4.part", CHANNELS, {}) as journal:
        hub.look()
        journal.append(table_of(3))
        journal.append(table_of(2, 3))
        hub.look()
    note, *frames = taken(reader, 3)
    assert json.loads(note) == {"type": "recording", "number": 1, "name": "run.mf4", "channels": [list(each) for each in CHANNELS]}
    heads = [HEADER.unpack(frame[: HEADER.size]) for frame in frames if isinstance(frame, bytes)]
    assert heads == [(1, 3, 3, 0, 0.0), (1, 2, 3, 0, 3.0)]
    values = np.concatenate([np.frombuffer(frame, "<f8", offset=HEADER.size) for frame in frames if isinstance(frame, bytes)])
    assert values.reshape(-1, 3) == pytest.approx(table_of(5), abs=0.0)
    hub.close()


def told(time_s: float, doing: str, position: float) -> dict[str, object]:
    axis = {"position": position, "speed": None, "effort": 1.5}
    return {"doing": doing, "time_s": time_s, "axes": {name: axis for name in ("propeller", "roll")}}


def test_the_way_to_the_start_is_shown_until_rows_are_recorded(tmp_path: Path) -> None:
    hub = RowHub(tmp_path, 0.0)
    way = ToldRows(hub, facts_of("carm", load_machine("carm"), "lockstep:").axes)
    reader = hub.join()
    with Journal.create(tmp_path / "run.mf4.part", CHANNELS, {}) as journal:
        hub.look()  # the journal is there before the machine is at its start
        way.take(told(7.0, ON_THE_WAY, 0.1))
        way.take(told(7.1, ON_THE_WAY, 0.2))
        way.take(told(7.2, RECORDING, 0.3))
        journal.append(table_of(3))
        hub.look()
    messages = taken(reader, 6)
    notes = [json.loads(each) for each in messages if isinstance(each, str)]
    assert [note["name"] for note in notes] == ["run.mf4", "before the recording", "run.mf4"]
    assert ["position_roll", "rad"] in notes[1]["channels"]
    _, second, recorded = (each for each in messages if isinstance(each, bytes))
    seen = np.frombuffer(second, "<f8", offset=HEADER.size)
    assert seen[:4] == pytest.approx([0.1, 0.2, np.nan, 1.5], nan_ok=True)
    assert HEADER.unpack(recorded[: HEADER.size]) == (3, 3, 3, 0, 0.0)
    hub.close()


def test_the_way_is_shown_also_where_it_is_told_before_the_journal_is_there(tmp_path: Path) -> None:
    hub = RowHub(tmp_path, 0.0)
    way = ToldRows(hub, facts_of("carm", load_machine("carm"), "lockstep:").axes)
    reader = hub.join()
    way.take(told(7.0, WATCHING, 0.1))
    with Journal.create(tmp_path / "run.mf4.part", CHANNELS, {}) as journal:
        hub.look()
        way.take(told(7.1, ON_THE_WAY, 0.2))
        way.take(told(7.2, ON_THE_WAY, 0.3))
        journal.append(table_of(3))
        hub.look()
        way.take(told(7.3, LETTING_GO, 0.4))
    messages = taken(reader, 8)
    notes = [json.loads(each)["name"] for each in messages if isinstance(each, str)]
    assert notes == ["before the recording", "run.mf4", "before the recording", "run.mf4"]
    places = [np.frombuffer(each, "<f8", offset=HEADER.size)[1] for each in messages if isinstance(each, bytes)]
    assert places == [0.1, 0.2, 0.3, 1e-5]
    hub.close()


def test_the_last_recorded_row_is_told_once_and_none_of_the_live_view_s(tmp_path: Path) -> None:
    hub = RowHub(tmp_path, 0.0)
    with Journal.create(tmp_path / "run.mf4.part", CHANNELS, {}) as journal:
        journal.append(table_of(4))
        hub.look()
    assert hub.take_recorded()["time"] == 3.0 / 256.0
    hub.look()
    hub.show("live view", CHANNELS)
    hub.take_shown(1, table_of(1).tobytes())
    assert hub.take_recorded() == {}
    hub.close()


def test_who_comes_later_gets_the_past_too(tmp_path: Path) -> None:
    hub = RowHub(tmp_path, 0.0)
    with Journal.create(tmp_path / "run.mf4.part", CHANNELS, {}) as journal:
        journal.append(table_of(4))
        hub.look()
        note, frame = taken(hub.join(), 2)
    assert json.loads(note)["name"] == "run.mf4"
    assert HEADER.unpack(frame[: HEADER.size])[1] == 4  # type: ignore[arg-type]
    hub.close()


def test_the_next_recording_follows_and_one_of_another_day_does_not(tmp_path: Path) -> None:
    Journal.create(tmp_path / "old.mf4.part", CHANNELS, {}).close()
    hub = RowHub(tmp_path, (tmp_path / "old.mf4.part").stat().st_mtime + 1.0)
    reader = hub.join()
    hub.look()
    assert hub.recording is None
    hub = RowHub(tmp_path, 0.0)
    (tmp_path / "old.mf4.part").unlink()
    reader = hub.join()
    for name in ("first", "second"):
        with Journal.create(tmp_path / f"{name}.mf4.part", CHANNELS, {}) as journal:
            hub.look()
            journal.append(table_of(2))
        (tmp_path / f"{name}.mf4.part").unlink()
        hub.look()
        assert hub.recording is not None
        assert (hub.recording["name"], hub.recording["rows"], hub.recording["live"]) == (f"{name}.mf4", 2, False)
    notes = [json.loads(each)["name"] for each in taken(reader, 4) if isinstance(each, str)]
    assert notes == ["first.mf4", "second.mf4"]


def test_a_run_that_was_killed_does_not_hide_the_next(tmp_path: Path) -> None:
    hub = RowHub(tmp_path, 0.0)
    for name in ("killed", "next"):
        with Journal.create(tmp_path / f"{name}.mf4.part", CHANNELS, {}) as journal:
            journal.append(table_of(2))
        os.utime(tmp_path / f"{name}.mf4.part", (2e9, 2e9 + (name == "next")))
        for _ in range(LOOKS_AROUND):
            hub.look()
        assert hub.recording is not None
        assert hub.recording["name"] == f"{name}.mf4"
    (tmp_path / "next.mf4.part").unlink()
    for _ in range(LOOKS_AROUND):
        hub.look()
    assert (hub.recording["name"], hub.recording["live"]) == ("next.mf4", False)


def test_a_reader_that_does_not_read_loses_the_oldest_rows_and_is_told_how_many(tmp_path: Path) -> None:
    hub = RowHub(tmp_path, 0.0)
    slow = hub.join()
    rows = 2000
    blocks = 2 * QUEUE_BYTES // (rows * 24)
    with Journal.create(tmp_path / "run.mf4.part", CHANNELS, {}) as journal:
        hub.look()
        for block in range(blocks):
            journal.append(table_of(rows, block * rows))
            hub.look()
    waiting = sum(len(each) for each in taken(slow, 1 + blocks - slow.lost // rows))
    assert waiting <= QUEUE_BYTES
    assert slow.lost > 0
    quick = hub.join()
    _, first = taken(quick, 2)
    assert HEADER.unpack(first[: HEADER.size])[3] == 0  # type: ignore[arg-type]
    hub.close()


def test_the_loss_stands_in_the_next_frame(tmp_path: Path) -> None:
    hub = RowHub(tmp_path, 0.0)
    slow = hub.join()
    rows = 50_000
    with Journal.create(tmp_path / "run.mf4.part", CHANNELS, {}) as journal:
        hub.look()
        for block in range(10):
            journal.append(table_of(rows, block * rows))
            hub.look()
    _, frame = taken(slow, 2)
    number, count, width, lost, first = HEADER.unpack(frame[: HEADER.size])  # type: ignore[arg-type]
    assert (number, width, count) == (1, 3, rows)
    assert lost == first == slow.lost
    assert lost > 0
    hub.close()


def test_percentiles_are_those_of_the_rows_to_a_bin() -> None:
    random = np.random.default_rng(3)
    late = random.lognormal(np.log(40e-6), 1.0, 20_000)
    table = np.column_stack((np.arange(len(late)) / 256.0, late))
    counted = Timeliness(["time", "sync_lateness"])
    for part in np.array_split(table, 7):
        counted.take(len(part), part.astype("<f8").tobytes())
    found = counted.summary()
    measured = found["measured"]["sync_lateness"]
    for share in (50.0, 99.0, 99.9):
        true = np.percentile(late, share) * 1e6
        assert true * 0.99 <= measured[f"p{share:g}_us"] <= true * 1.27  # ten bins a decade
    assert measured["max_us"] == pytest.approx(late.max() * 1e6)
    assert sum(measured["counts"]) == found["rows"] == len(late)
    assert found["missed"] == 0


def test_ticks_that_are_not_there_are_missed() -> None:
    time_s = np.delete(np.arange(100) / 256.0, [7, 40, 41, 42])
    counted = Timeliness(["time"])
    for part in np.array_split(time_s, 5):
        counted.take(len(part), part.astype("<f8").tobytes())
    assert counted.summary()["missed"] == 4


def test_rows_without_times_of_the_host_have_no_histogram() -> None:
    table = np.column_stack((np.arange(10) / 256.0, np.full(10, np.nan)))
    counted = Timeliness(["time", "work_time"])
    counted.take(10, table.tobytes())
    assert counted.summary()["measured"] == {}


def test_two_states_of_one_instant_are_no_ticks_and_none_of_the_recording_s_rows(tmp_path: Path) -> None:
    hub = RowHub(tmp_path, 0.0)
    way = ToldRows(hub, facts_of("carm", load_machine("carm"), "lockstep:").axes)
    with Journal.create(tmp_path / "run.mf4.part", CHANNELS, {}) as journal:
        hub.look()
        for time_s in (7.0, 7.0, 7.1):
            way.take(told(time_s, ON_THE_WAY, 0.1))
        hub.look()
        assert hub.recording is not None
        assert (hub.recording["rows"], hub.recording["began"], hub.timeliness.missed) == (0, "", 0)
        journal.append(table_of(3))
        hub.look()
        assert (hub.recording["rows"], hub.timeliness.rows) == (3, 3)
    hub.close()
