"""Answers that are lost while drives close loops of their own: the drives go on, and so do the bench's targets and what it expects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bench_machines import LOOPS, LosingBus, carm_text_in

from drivers.interface import Sample
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Scan
from hil.machine import machine_from_text
from hil.recording import Recording, read_recording
from hil.simulation import in_effort

SPEED_rad_s = 0.2
LOST_AT = 300  # in the middle of the scan
PERIOD_S, COUNT_rad = 1.0 / 256.0, 2.0 * np.pi / (4096 * 500)
POSITION_GAIN, VELOCITY_GAIN, SHARE = (LOOPS["roll"][name] for name in ("position_gain", "velocity_gain", "speed_filter"))
COUNT_A = VELOCITY_GAIN * SHARE * COUNT_rad / PERIOD_S  # what one count makes of the effort, in the next tick
STEP_A = 0.005
HELD_A = VELOCITY_GAIN * POSITION_GAIN * SPEED_rad_s * 3 * PERIOD_S  # what a target makes that stands for three ticks
EVERYBODY, ROLL = (0x181, 0x182, 0x18B, 0x18C), (0x182,)


LOSSES = [("velocity", EVERYBODY, 0.0), ("position", EVERYBODY, HELD_A), ("velocity", ROLL, 0.0), ("position", ROLL, 0.0)]
"""Mode, whose frames are lost, and what remains: a position that stands while nobody answers, although the reference goes on."""


@pytest.fixture(params=LOSSES, ids=str)
def lossy(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, Recording, np.ndarray, float]:
    """The mode, a recorded scan without noise in which three ticks' answers are lost, roll's effort less the expected one, its bound."""
    mode, lost, held_A = request.param
    machine = machine_from_text(carm_text_in(mode))
    (plan,) = Scan("roll", 0.0, 0.3, SPEED_rad_s, dwell_s=0.5).plans(machine)
    monkeypatch.setattr("hil.bench.wiring.LockstepBus", LosingBus)
    monkeypatch.setattr(LosingBus, "lost_ids", ())
    off: list[float] = []
    with open_bench(machine, BenchOptions("lockstep:", noise=False)) as bench:
        judge, link = bench.loop.judge, bench.wiring.link
        assert judge is not None
        judged, exchange = judge.step, link.exchange

        def seen(sample: Sample, ticks: int, row_s: float, *, led: bool = True) -> str:
            off.append(float(sample.effort[1] - sample.commanded[1]))
            return judged(sample, ticks, row_s, led=led)

        def counted(command: np.ndarray) -> Sample:
            LosingBus.lost_ids = lost if len(off) >= LOST_AT and counted.lost < 3 else ()
            counted.lost += bool(LosingBus.lost_ids)
            return exchange(command)

        counted.lost = 0

        def watched(row: int) -> None:
            judge.step, link.exchange = seen, counted  # type: ignore[method-assign]

        bench.run(plan, tmp_path / "run.mf4", watched)
    recording = read_recording(tmp_path / "run.mf4")
    assert recording.channel("position_roll").missing.sum() == 3
    return mode, recording, np.array(off), COUNT_A + STEP_A + held_A


def test_targets_go_on_and_the_effort_is_expected_within_little(lossy: tuple[str, Recording, np.ndarray, float]) -> None:
    mode, recording, off, most = lossy
    missing = np.flatnonzero(recording.channel("position_roll").missing)
    around = slice(missing[0] - 20, missing[-1] + 20)
    reference = recording["reference_roll"]
    speed = np.diff(reference)[around] / PERIOD_S
    assert speed == pytest.approx(SPEED_rad_s, rel=1e-6)
    ahead = recording["command_roll"][around] - (0.0 if mode == "velocity" else reference[around])
    usual = SPEED_rad_s if mode == "velocity" else SPEED_rad_s / POSITION_GAIN
    assert ahead == pytest.approx(usual, rel=0.05)
    assert np.nanmax(np.abs(off)) < most


def test_the_effort_that_follows_from_the_recording_is_the_measured_one(
    lossy: tuple[str, Recording, np.ndarray, float],
) -> None:
    _, recording, _, most = lossy
    off = recording["current_roll"][1:] - in_effort(recording)["command_roll"][:-1]
    assert np.nanmax(np.abs(off)) < most
