"""Variants of the shipped C-arm, and runs of it over `lockstep:`."""

from __future__ import annotations

import re
import tomllib
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
from places import EDS_FILES

from hil.bench.bench import Bench
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Plan
from hil.machine import Machine, load_machine, machine_from_text
from hil.machine.convert import converted_text
from hil.recording import Recording, read_recording
from virtual_bus.lockstep import LockstepBus

CARM = load_machine("carm")
STOPWATCH = ("work_time", "answer_time")  # read off the wall clock, the only two that are


def edited(old: str, new: str, text: str = CARM.text, count: int = 0) -> str:
    """A machine file's text with a pattern replaced; it must be there."""
    result, found = re.subn(old, new, text, count=count, flags=re.MULTILINE)
    assert found, f"the machine file has no {old}"
    return result


RPM_PER_S = "[60AA]\nParameterName=Unit of acceleration\nObjectType=0x7\nDataType=0x0007\nAccessType=rw\nDefaultValue=0x00C00300\n\n"


def with_data_sheet(text: str, folder: Path, old: str, new: str) -> str:
    """Return the file with its drives' data sheet edited, beside a copy of it."""
    (folder / "edited_drive.eds").write_text(edited(old, new, (EDS_FILES / "isocenter_drive.eds").read_text(encoding="utf-8")))
    return text.replace('"isocenter_drive.eds"', f'"{folder / "edited_drive.eds"}"')


def patient_text(overrun_ticks: str = "5000") -> str:
    """The C-arm's file with time-outs that a machine busy with other things keeps, for tests of behaviour over two processes."""
    text = CARM.text
    for key, value in {
        "heartbeat_s": "1.0",
        "master_heartbeat_s": "0.5",
        "boot_timeout_s": "20.0",
        "stale_after_s": "20.0",
        "answer_timeout_s": '2.0\nanswers = "awaited"',
        "overrun_ticks": overrun_ticks,
        "stale_ticks": "64",
    }.items():
        text = edited(f"^{key} = [0-9.]+", f"{key} = {value}", text)
    return edited("timeout_s = 0.5", "timeout_s = 1.0", text)  # of the I/O's output watchdog: the most that is allowed


def carm_at_1_kHz() -> Machine:
    """The C-arm sampled at 1 kHz."""
    return machine_from_text(converted_text(CARM, 1000.0)[0])


def run_in_lockstep(
    folder: Path,
    plans: list[Plan],
    machine: Machine = CARM,
    *,
    name: str = "run",
    start_pose: np.ndarray | None = None,
    progress: Callable[[Bench, int], None] | None = None,
    **options: object,
) -> list[Recording]:
    """Run plans one after the other and read what was recorded; frames in `<name>.log`, the truth in `<name>.csv`."""
    bench_options = BenchOptions("lockstep:", frame_log=folder / f"{name}.log", truth=folder / f"{name}.csv", **options)
    paths = [folder / f"{name}_{number}.mf4" for number in range(len(plans))]
    with open_bench(machine, bench_options, plans[0].start_pose if start_pose is None else start_pose) as bench:
        for plan, path in zip(plans, paths, strict=True):
            bench.run(plan, path, None if progress is None else lambda row: progress(bench, row))
    return [read_recording(path) for path in paths]


def read_truth(path: Path) -> dict[str, np.ndarray]:
    """Columns of a truth file by the name in their header cell, unit left out."""
    with path.open(encoding="utf-8") as file:
        names = [cell.split(" [")[0] for cell in file.readline().strip().split(",")]
        table = np.loadtxt(file, delimiter=",", ndmin=2)
    return dict(zip(names, table.T, strict=True))


class LosingBus(LockstepBus):
    """Loses frames on the way to the bench: those of `lost_ids`, as long as it is told to."""

    lost_ids: tuple[int, ...] = ()

    def recv(self, timeout: float | None = None) -> can.Message | None:
        while (message := super().recv(timeout)) is not None:
            if message.arbitration_id not in self.lost_ids:
                return message
        return None

    def waiting_frames(self) -> deque[tuple[int, bytes]]:
        frames = super().waiting_frames()
        for frame in [each for each in frames if each[0] in self.lost_ids]:
            frames.remove(frame)
        return frames


LOOPS: dict[str, dict[str, Any]] = {axis: drive["loops"] for axis, drive in tomllib.loads(load_machine("carm-csp").text)["drives"].items()}
"""The gains of drives that close loops of their own, by axis."""


def carm_text_in(mode: str) -> str:
    """Return the C-arm's file with drives that are commanded in "velocity" or "position".

    In "profile_velocity" and "profile_position" nothing else is mapped: such a drive takes no effort.
    """
    cyclic = mode.removeprefix("profile_")
    text = load_machine({"velocity": "carm-csv", "position": "carm-csp"}[cyclic]).text
    return text if mode == cyclic else text.replace(f'mode = "{cyclic}"', f'mode = "{mode}"').replace(', "torque_offset"]', "]")


def homing_at_switch_text(text: str = CARM.text) -> str:
    """Return a file in which roll's drive homes by the limit switch at the negative end of its range, at 5 degrees per second."""
    lower = round(np.radians(-95.0) / CARM.bus.scalings[1].position_resolution)
    text = edited(r"(\[bus.homing.roll\]\nmethod = )37\nspeed_deg_s = 2.0", r"\g<1>17\ntravel_limit_deg = 20.0\nspeed_deg_s = 5.0", text)
    offset = f"[[bus.nodes.roll_drive.write]]\nindex = 0x607C\nvalue = {lower}\n"
    return edited(r"^\[\[bus.nodes.roll_drive.tpdo\]\]$", f"{offset}\\g<0>", text)
