"""What `machine check` says about the shipped machines and about broken ones, against independent computations."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import energy_oracle
import numpy as np
import pytest

from hil.machine import Machine, check_machine, load_machine, machine_from_text
from hil.machine.bus_load import bus_load, frame_bits
from hil.machine.check import examine
from hil.machine.closed_loop import LinearLoop, loop_margins
from virtual_bus.physics import Physics

ROLLS_DEG = (-90, -45, 0, 45, 90)


@pytest.fixture(scope="module")
def carm() -> Machine:
    return load_machine("carm")


def edited(machine: Machine, old: str, new: str) -> Machine:
    assert old in machine.text
    return machine_from_text(machine.text.replace(old, new, 1), machine.path)


def mode_near(machine: Machine, pose_deg: tuple[int, int], frequency_Hz: float) -> tuple[float, float]:
    modes = energy_oracle.modes(machine.plant, np.radians(pose_deg))
    return min(modes, key=lambda mode: abs(mode[0] - frequency_Hz))


def test_every_check_of_the_c_arm_passes(carm: Machine) -> None:
    findings = check_machine(carm, poses=25)
    assert [finding.text for finding in findings if not finding.ok] == []
    assert {"mode", "holding", "stability", "phase_margin", "gain_margin", "bus_load"} <= {finding.name for finding in findings}


@pytest.mark.slow
def test_modes_and_holding_efforts_agree_with_energies(carm: Machine) -> None:
    for result in examine(carm, poses=9):
        _, holding = energy_oracle.standstill(carm.plant, result.pose)
        np.testing.assert_allclose(result.holding, holding, atol=1e-6)
        expected = [mode for mode in energy_oracle.modes(carm.plant, result.pose) if mode[1] < 0.2]
        assert len(result.modes) == len(expected)
        np.testing.assert_allclose(result.modes, expected, rtol=1e-5)


@pytest.mark.slow
def test_a_lightly_damped_mode_near_8_hz_moves_by_more_than_1_hz_over_roll(carm: Machine) -> None:
    frequency, damping = mode_near(carm, (0, 0), 8.0)
    assert frequency == pytest.approx(8.0, abs=0.3)
    assert 0.01 <= damping <= 0.02
    over_roll = [min(mode for mode, zeta in energy_oracle.modes(carm.plant, np.radians([0, roll])) if mode > 3.0) for roll in ROLLS_DEG]
    assert max(over_roll) - min(over_roll) > 1.0


def test_the_shift_follows_from_geometry_because_moving_a_mass_moves_it(carm: Machine) -> None:
    old = "position_m = [0.0, 0.0, -0.81]"
    moved = edited(carm, old, "position_m = [0.0, 0.0, -0.61]")
    before, after = mode_near(carm, (0, 0), 8.0)[0], mode_near(moved, (0, 0), 8.0)[0]
    assert after - before > 0.2


@pytest.mark.slow
@pytest.mark.parametrize("propeller_deg", [0, *(pytest.param(deg, marks=pytest.mark.nightly) for deg in (-120, -60, 60, 120))])
def test_the_detector_mode_near_14_hz_does_not_move_over_roll(carm: Machine, propeller_deg: int) -> None:
    frequencies = [mode_near(carm, (propeller_deg, roll), 14.0)[0] for roll in ROLLS_DEG]
    assert frequencies[2] == pytest.approx(14.0, abs=0.2)
    assert max(frequencies) - min(frequencies) < 0.2


@pytest.mark.slow
def test_both_modes_and_antiresonances_show_in_the_responses(carm: Machine) -> None:
    model = Physics(carm.plant, noise=False).linearise(np.zeros(2))
    frequencies = np.linspace(3.0, 18.0, 3001)
    response = np.abs(model(2j * np.pi * frequencies))
    rows = {name: row for row, name in enumerate(model.output_labels)}

    def peaks(row: int, column: int, sign: float = 1.0) -> list[float]:
        size = sign * response[row, column]
        return [frequencies[k] for k in range(1, len(size) - 1) if size[k] > size[k - 1] and size[k] > size[k + 1]]

    for channel in ("imu_x", "imu_y", "imu_z"):
        assert any(abs(peak - 14.0) < 0.2 for peak in peaks(rows[channel], 1))
    assert any(abs(peak - 8.0) < 0.2 for peak in peaks(rows["imu_y"], 0))
    for column, axis in enumerate(carm.axes):
        position = rows[f"position_{axis}"]
        resonance = peaks(position, column)
        antiresonance = peaks(position, column, -1.0)
        assert antiresonance
        assert antiresonance[0] < resonance[0]
        assert peaks(rows["imu_y"], column, -1.0) != antiresonance  # non-collocated: other zeros


def test_margins_agree_with_python_control() -> None:
    plant = control.tf([40.0, 400.0], [1.0, 3.0, 25.0, 0.0])
    frequencies = np.geomspace(0.01, 60.0, 4000)
    margins = loop_margins(frequencies, plant(2j * np.pi * frequencies) * np.exp(-0.01j * 2.0 * np.pi * frequencies))
    # the delay as a Padé approximant of an order at which it is exact in this band
    numerator, denominator = control.pade(0.01, 8)
    gain, phase, _, gain_at, phase_at, _ = control.stability_margins(plant * control.tf(numerator, denominator), returnall=False)
    assert margins.phase_deg == pytest.approx(abs(phase), abs=0.1)
    assert margins.phase_at_Hz == pytest.approx(phase_at / (2.0 * np.pi), rel=1e-3)
    assert margins.gain_dB == pytest.approx(abs(20.0 * math.log10(gain)), abs=0.05)
    assert margins.gain_at_Hz == pytest.approx(gain_at / (2.0 * np.pi), rel=1e-3)


def test_the_gain_margin_is_where_the_closed_loop_goes_unstable(carm: Machine) -> None:
    plant = Physics(carm.plant, noise=False).sampled(np.zeros(2), [f"position_{axis}" for axis in carm.axes])
    margin = LinearLoop(plant, carm.controllers).margins()[1]

    def radius(gain: float) -> float:
        sections = carm.controllers[1].position_sections.copy()
        sections[0, :3] *= gain
        return LinearLoop(plant, (carm.controllers[0], replace(carm.controllers[1], position_sections=sections))).pole_radius()

    rise = 10.0 ** (margin.gain_dB / 20.0)
    assert radius(1.0) < 1.0
    assert radius(0.98 * rise) < 1.0 < radius(1.02 * rise)


@pytest.mark.slow
def test_a_controller_that_is_too_strong_is_found(carm: Machine) -> None:
    strong = edited(carm, "[1141.398991, -1138.601009,", "[22827.97982, -22772.02018,")
    failed = {finding.name: finding.text for finding in check_machine(strong, poses=9) if not finding.ok}
    assert "stability" in failed
    assert "lower the gain" in failed["stability"]


@pytest.mark.slow
def test_a_machine_too_heavy_for_its_drive_is_found(carm: Machine) -> None:
    heavy = edited(carm, "mass_kg = 80.0", "mass_kg = 400.0")
    failed = [finding for finding in check_machine(heavy, poses=9) if finding.name == "holding" and not finding.ok]
    assert failed
    assert "limit" in failed[0].text


def test_a_missing_device_file_is_found(carm: Machine) -> None:
    absent = edited(carm, 'eds = "isocenter_encoder.eds"', 'eds = "absent.eds"')
    assert any(finding.name == "eds" and "absent.eds" in finding.text for finding in check_machine(absent, poses=9) if not finding.ok)


def test_bits_of_a_frame_are_the_published_worst_case() -> None:
    # Davis et al. 2007: 55 bits without data, 135 with eight bytes
    assert frame_bits(0) == 55
    assert frame_bits(8) == 135


def test_bus_load_counts_every_frame_of_a_cycle(carm: Machine) -> None:
    # SYNC, two TPDOs of 8, two of 4, two RPDOs of 4 bytes at 256 Hz; five heartbeats of one byte at 10 Hz
    expected = (256.0 * (55 + 2 * 135 + 4 * frame_bits(4)) + 5 * 10.0 * frame_bits(1)) / 1e6
    assert bus_load(carm.bus) == pytest.approx(expected)


def test_a_reference_filter_that_runs_away_is_found() -> None:
    emps = load_machine("emps")
    old = "[38995.821, 0.0, 0.0, 1.0, 0.0, 0.0]"
    wild = edited(emps, old, "[38995.821, 0.0, 0.0, 1.0, -1.02, 0.0]")
    for machine, ok in ((emps, True), (wild, False)):
        finding = next(finding for finding in check_machine(machine, poses=3) if finding.name == "reference_filter")
        assert finding.ok is ok


def test_the_benchmark_axis_needs_no_holding_effort_and_is_stable() -> None:
    findings = check_machine(load_machine("emps"), poses=3)
    holding = next(finding for finding in findings if finding.name == "holding")
    assert holding.values["effort"] == 0.0
    assert next(finding for finding in findings if finding.name == "stability").ok
