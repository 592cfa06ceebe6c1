"""The process beside the page's server: the curves that it reads, and its priority."""

from __future__ import annotations

import asyncio
import base64
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hil.console.curves import MOST_ROWS, curves
from hil.console.helper import Helper
from hil.recording import Channel, Recording, write_recording

PATIENCE_S = 120.0


def written(path: Path, position: np.ndarray) -> str:
    channels = {"time": Channel("s", np.arange(position.size) / 1000.0), "position_turn": Channel("rad", position)}
    write_recording(Recording(channels, {}), path)
    return str(path)


def test_a_curve_that_cannot_be_derived_leaves_the_others(tmp_path: Path) -> None:
    files = [written(tmp_path / "one.csv", np.array([0.25])), written(tmp_path / "many.csv", np.sin(np.arange(100)))]
    found = curves("turntable", files, ["position_turn", "d(position_turn)", "spectrum(position_turn)"], "")
    why = {(each["of"], each["channel"]): each.get("error", "") for each in found["curves"]}
    assert len(why) == 6
    assert "has 1 rows; a derivative needs two" in why.pop((0, "d(position_turn)"))
    assert "has 1 rows; a spectrum needs four" in why.pop((0, "spectrum(position_turn)"))
    assert set(why.values()) == {""}


@pytest.mark.parametrize("last", [1.0, -1.0])
@pytest.mark.parametrize("over", [1, 2, 3])
def test_of_a_long_recording_the_last_row_is_drawn_too(tmp_path: Path, over: int, last: float) -> None:
    position = np.zeros(MOST_ROWS + over)
    position[-1] = last
    (curve,) = curves("turntable", [written(tmp_path / "long.mf4", position)], ["position_turn"], "")["curves"]
    x, y = (np.frombuffer(base64.b64decode(curve[axis]), "<f8") for axis in "xy")
    assert y.size <= MOST_ROWS
    assert (x[np.argmax(np.abs(y))], y[np.argmax(np.abs(y))]) == ((position.size - 1) / 1000.0, last)


@pytest.mark.skipif(not hasattr(os, "getpriority"), reason="no niceness")
def test_the_helper_comes_after_the_server_that_takes_the_stop() -> None:
    command = [sys.executable, "-m", "hil.console.helper", "turntable"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as helper:
        assert helper.stdin is not None
        assert helper.stdout is not None
        helper.stdin.write('{"files": [], "channels": [], "align": ""}\n')
        helper.stdin.flush()
        assert json.loads(helper.stdout.readline())["curves"] == []
        assert os.getpriority(os.PRIO_PROCESS, helper.pid) > os.getpriority(os.PRIO_PROCESS, 0)
        helper.stdin.close()


RECORDINGS: dict[str, object] = {"files": [], "channels": [], "align": ""}
NO_PLAN: dict[str, object] = {"plan": "format = 1"}
ENDLESS_PLAN: dict[str, object] = {
    "plan": 'format = 1\nkind = "multisine"\nperiod_s = 1000\nperiods = 200\namplitude_A = 0.5\nband = { low_Hz = 0.1, high_Hz = 40 }\n'
}


def processes() -> set[str]:
    """The children of this process (Linux)."""
    return set(Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split())


def answers_around(given_up: dict[str, object]) -> tuple[set[str], set[str], list[dict[str, object]]]:
    """The processes before and after a question whose asker is cancelled, and the answers before and after it."""

    async def asked() -> tuple[set[str], set[str], list[dict[str, object]]]:
        there, helper = processes(), Helper("turntable")
        try:
            first = json.loads(await helper.ask(RECORDINGS, PATIENCE_S))
            before = processes() - there
            asker = asyncio.create_task(helper.ask(given_up, PATIENCE_S))
            await asyncio.sleep(0)  # it has asked
            await asyncio.sleep(0)
            asker.cancel()
            await asyncio.gather(asker, return_exceptions=True)
            assert asker.cancelled()
            second = json.loads(await helper.ask(RECORDINGS, PATIENCE_S))
            return before, processes() - there, [first, second]
        finally:
            await helper.close()
            assert processes() == there

    return asyncio.run(asked())


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="children are read from /proc")
def test_a_question_that_is_cancelled_does_not_end_the_helper_and_its_answer_is_nobodys() -> None:
    before, after, (first, second) = answers_around(NO_PLAN)
    assert len(before) == 1
    assert after == before
    assert first == second == {"channels": [], "shifts_s": [], "curves": []}


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="children are read from /proc")
def test_a_cancelled_question_that_keeps_the_next_waiting_is_given_up_with_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.console.helper.LEFT_S", 0.1)
    before, after, (first, second) = answers_around(ENDLESS_PLAN)
    assert len(after) == 1
    assert after != before
    assert first == second
