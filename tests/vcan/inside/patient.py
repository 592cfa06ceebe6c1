"""The machine of these tests, and what they run on it at rest."""

from __future__ import annotations

import re
from pathlib import Path

from hil.machine import load_machine

AT_REST = ("static", "--seconds", "1", "--seed", "3")


def patient(tmp_path: Path, *, can_only: bool = False) -> str:
    """Write carm with time-outs that a user-mode kernel on a loaded machine keeps: there a second of the bus may take several.

    With `can_only` without Modbus I/O and serial IMU: what is left is on the CAN bus, where every frame is ordered.
    """
    text = load_machine("carm").text
    relaxed = {
        "heartbeat_s": 4.0,
        "master_heartbeat_s": 1.5,
        "boot_timeout_s": 20.0,
        "stale_after_s": 10.0,
        "answer_timeout_s": '0.5\nanswers = "awaited"',
        "overrun_ticks": '512\noverrun = "wait"',
    }
    for key, value in relaxed.items():
        text, found = re.subn(rf"(?m)^{key} = [0-9.]+", f"{key} = {value}", text)
        assert found, key
    assert "timeout_s = 0.5 }" in text
    text = text.replace("timeout_s = 0.5 }", "timeout_s = 1.0 }")  # of the I/O's output watchdog: the most that is allowed
    if can_only:
        text = re.sub(r"(?ms)^\[(bus\.(io|imu)|budgets|judging)\b.*?(?=^\[|\Z)", "", text)
    path = tmp_path / "patient.toml"
    path.write_text(text)
    return str(path)


def since_the_bench_came(frames: list[str]) -> list[str]:
    """Without the boot-ups of a machine switched on before its bench connects: candump is there already, the lockstep log is not."""
    return frames[next(i for i, frame in enumerate(frames) if frame.startswith("000#")) :]
