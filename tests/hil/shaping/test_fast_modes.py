"""A mode between an eighth and a third of the sample rate is shaped away; one above is refused by its name, with what can be done."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controllers.shapers.filter import ReferenceShaper
from hil.cli import main
from hil.errors import UnusableInputError
from hil.machine import Machine, load_machine, machine_from_text
from hil.shaping.choice import ShaperChoice, choose_shaper
from hil.shaping.plans import shaped
from hil.simulation import Inputs, Simulator
from hil.verbs.shape import shape

STEP_rad = 1e-4

ARM = """
[[body]]
name = "arm"
parent = "table"
mass_kg = 2.0
center_of_mass_m = [0.0, 0.0, 0.0]
inertia_kg_m2 = [0.25, 0.25, 0.4, 0.0, 0.0, 0.0]
[body.joint]
name = "flex"
type = "revolute"
axis = [0.0, 0.0, 1.0]
stiffness_Nm_rad = {stiffness:.1f}
damping_Nm_s_rad = 2.0

[drives.turn]"""


def flexible_text(stiffness: float) -> str:
    """Write the turntable, at 200 Hz, with an arm on a spring: 30000 Nm/rad give 44.7 Hz, 90000 Nm/rad 77.5 Hz."""
    return load_machine("turntable").text.replace("\n[drives.turn]", ARM.format(stiffness=stiffness), 1)


def flexible(stiffness: float) -> Machine:
    return machine_from_text(flexible_text(stiffness))


@pytest.fixture(scope="module")
def choice() -> ShaperChoice:
    return choose_shaper(flexible(30000.0), "turn")


def ringing(machine: Machine, reference: np.ndarray) -> float:
    """Largest movement of the arm against the table after 0.1 s of a step, by the emulated machine without resolution."""
    plant = replace(
        machine.plant,
        drives=tuple(replace(each, resolution=0.0) for each in machine.plant.drives),
        encoders=tuple(replace(each, resolution=0.0) for each in machine.plant.encoders),
    )
    still = np.zeros_like(reference)
    out = Simulator(replace(machine, plant=plant)).run(Inputs(reference, still, still, None, reference[0].copy()))
    speed = np.diff(out.link_position[:, 0]) * machine.sample_rate_Hz
    fast = np.diff(speed)[20:120]  # the loop's own poles at 4 Hz and below hardly change the speed from sample to sample
    spectrum = np.abs(np.fft.rfft((fast - fast.mean()) * np.hanning(len(fast))))
    return float(spectrum[round(35.0 * len(fast) / 200.0) : round(55.0 * len(fast) / 200.0)].max())


def test_a_mode_at_two_ninths_of_the_sample_rate_is_shaped_away(choice: ShaperChoice) -> None:
    machine = choice.machine
    raw = np.zeros((200, 1))
    raw[10:] = STEP_rad
    left = {}
    for name in ("none", "ZV", "hTDF robust"):
        running = ReferenceShaper(machine.axes, [choice.named(name).shaper], machine.limits, machine.sample_rate_Hz)
        left[name] = ringing(machine, shaped(running, raw, raw[0])[0])
    assert left["ZV"] < 0.02 * left["none"]
    assert left["hTDF robust"] < 0.02 * left["none"]


def test_its_pole_is_the_one_of_a_table_and_an_arm_on_a_spring(choice: ShaperChoice) -> None:
    """In closed form, the drive's loop far below: both inertias against each other."""
    table, arm = 7.0 + 6.0e-5 * 100.0**2, 0.4
    expected = np.sqrt(30000.0 * (1.0 / table + 1.0 / arm)) / (2.0 * np.pi)
    (pole,) = choice.chosen.cancelled[0]
    assert abs(pole) / (2.0 * np.pi) == pytest.approx(expected, rel=2e-3)
    assert choice.machine.sample_rate_Hz / 8.0 < expected < choice.machine.sample_rate_Hz / 3.0


def test_a_mode_above_a_third_of_the_sample_rate_is_named_with_what_can_be_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "stiff.toml").write_text(flexible_text(90000.0), encoding="utf-8")
    with pytest.raises(SystemExit) as left:
        main(["shape", str(tmp_path / "stiff.toml"), "--axis", "turn", "-o", str(tmp_path / "x.npz")])
    assert left.value.code == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "the mode at 77.45 Hz (damping 0.0056) is above 66.7 Hz" in error
    assert "raise timing.sample_rate_Hz to 233" in error
    assert not (tmp_path / "x.npz").exists()


def test_a_machine_that_does_not_ring_is_told_so() -> None:
    with pytest.raises(UnusableInputError, match="nothing rings"):
        shape(load_machine("turntable"), "turn")
