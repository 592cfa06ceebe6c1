"""A late drive that an independent integration has is diagnosed with its delay, and no clock is blamed for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from late_axis import CHANNELS, COULOMB_Nm, recorded, wave

from hil.diagnosis.diagnose import diagnose
from hil.machine import load_machine
from hil.recording import read_recording

DELAY_s = 0.012
"""2.4 rows: at a SYNC the drive still acts on the target of three rows before."""


def test_what_flows_at_a_sync_is_the_older_target_until_the_delay_is_over() -> None:
    rows = recorded(wave(np.radians(8.0), 3.0, 1), DELAY_s, 1)
    targets, current = np.round(rows[:, 5] / 0.005) * 0.005, rows[:, 4]
    apart = {late: float(np.std(current[late:] - targets[:-late])) for late in range(1, 8)}
    assert min(apart, key=apart.__getitem__) == 1 + 3


@pytest.mark.nightly
def test_the_delay_is_found_to_two_percent_and_the_friction_with_it(tmp_path: Path) -> None:
    print("seeds 1, 2, 3, 11")
    recordings, machine = {}, load_machine("turntable")
    even, other = wave(np.radians(8.0), 3.0, 4), wave(np.radians(12.0), 5.0, 2)
    for seed, reference in ((1, even), (2, even), (3, even), (11, other)):
        path = tmp_path / f"r{seed}.csv"
        np.savetxt(path, recorded(reference, DELAY_s, seed), delimiter=",", header=CHANNELS, comments="", fmt="%.12g")
        recordings[path.stem] = read_recording(path, machine)
    held_out = {"r11": recordings.pop("r11")}
    found = diagnose(machine, recordings, held_out, jobs=1).diagnosis
    assert {(each.effect.effect, each.effect.at) for each in found.findings} == {("delay", "turn"), ("coulomb_friction", "turn")}
    values = {each.effect.effect: each.parameters for each in found.findings}
    delay = values["delay"]["Td"]
    assert delay.value == pytest.approx(DELAY_s, rel=0.02)
    assert delay.ci95[0] < DELAY_s < delay.ci95[1]
    friction = values["coulomb_friction"]["Fc"]
    assert friction.ci95[0] < COULOMB_Nm < friction.ci95[1]
