"""A machine file at another sample rate: what hangs on the rate changes, all else stays as it was written, and the machine runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM, carm_text_in, edited
from command_line import Isocenter

from controllers.sections import response
from hil.errors import MachineFileError, UnusableInputError
from hil.machine import Machine, load_machine, machine_from_text
from hil.machine.convert import converted_text
from hil.recording import read_recording


def converted(machine: Machine, rate_Hz: float) -> Machine:
    return machine_from_text(converted_text(machine, rate_Hz)[0], machine.path)


def test_only_numbers_that_hang_on_the_rate_change_and_comments_stay() -> None:
    text, changes = converted_text(CARM, 512.0)
    old, new = CARM.text.splitlines(), text.splitlines()
    assert len(old) == len(new)
    changed = [(before, after) for before, after in zip(old, new, strict=True) if before != after]
    assert [line.split(" = ")[0].strip() for line, _ in changed if " = " in line] == [
        "sample_rate_Hz", "substeps", "overrun_ticks", "stale_ticks", "answer_timeout_s", "rate_Hz", "frozen_packets",
    ]  # fmt: skip
    assert len(changed) == 13  # and three sections of each axis
    assert [before.partition("#")[2] for before, _ in changed] == [after.partition("#")[2] for _, after in changed]
    assert {change.key for change in changes} == {
        "timing.sample_rate_Hz", "timing.substeps", "timing.overrun_ticks", "timing.stale_ticks", "bus.answer_timeout_s",
        "bus.imu.rate_Hz", "judging.imu.frozen_packets", "controller.propeller.position_sections", "controller.roll.position_sections",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("rate_Hz", "substeps", "overrun", "stale"), [(512.0, 2, 16, 6), (128.0, 8, 4, 1), (300.0, 4, 9, 3), (2000.0, 1, 62, 23)]
)
def test_times_stay(rate_Hz: float, substeps: int, overrun: int, stale: int) -> None:
    machine = converted(CARM, rate_Hz)
    assert machine.sample_rate_Hz == rate_Hz
    assert machine.plant.substeps == substeps
    assert 1.0 / (rate_Hz * substeps) <= 1.0 / (256.0 * 4)  # the plant's step is no longer than it was
    assert (machine.overrun_ticks, machine.stale_ticks) == (overrun, stale)
    assert machine.bus is not None
    assert machine.bus.imu is not None
    assert machine.bus.imu.rate_Hz == pytest.approx(rate_Hz)
    assert machine.bus.answer_timeout_s == pytest.approx(0.0025 * 256.0 / rate_Hz)  # its share of the period


@pytest.mark.parametrize(("rate_Hz", "every", "packets"), [(512.0, 8, 16), (128.0, 2, 4), (64.0, 1, 2), (2000.0, 31, 62)])
def test_what_is_counted_in_syncs_and_packets_keeps_its_time(rate_Hz: float, every: int, packets: int) -> None:
    tpdo = '[[bus.nodes.roll_drive.tpdo]]\nnumber = 2\ncob_id = 0x282\ntransmission_type = 4\nmap = ["velocity_actual_value"]\n'
    acyclic = tpdo.replace("number = 2", "number = 3").replace("0x282", "0x382").replace("type = 4", "type = 255")
    text = edited(r"^(\[\[bus\.nodes\.roll_drive\.rpdo\]\])", rf"{tpdo}{acyclic}\g<1>")
    text = edited(r"^frozen_packets = .*$", "frozen_packets = 8", text)
    new = converted(machine_from_text(text), rate_Hz)
    assert new.bus is not None
    drive = next(node for node in new.bus.nodes if node.name == "roll_drive")
    assert [pdo.transmission_type for pdo in drive.tpdos] == [1, every, 255]
    assert min(new.judging.imu.frozen_packets) >= packets
    assert f"frozen_packets = {packets}" in new.text


def test_an_imu_that_runs_by_itself_keeps_its_packets_and_an_age_of_none_is_stretched() -> None:
    alone = edited(r"^triggered_by_sync = true", "triggered_by_sync = false")
    slow = edited(r"^rate_Hz = 256.0", "rate_Hz = 100.0", alone)
    _, changes = converted_text(machine_from_text(slow), 512.0)
    assert "judging.imu.frozen_packets" not in {change.key for change in changes}
    aged = edited(r"^age_s = 0.015", "age_ms = 10.0")
    assert "age_ms = 10.0" in converted_text(machine_from_text(aged), 200.0)[0]
    assert "age_ms = 15.0" in converted_text(machine_from_text(aged), 100.0)[0]


def test_ticks_that_the_file_leaves_to_their_defaults_are_written_and_units_are_kept() -> None:
    text = edited(r"^(overrun|stale)_ticks = .*\n", "")
    text = edited(r"^sample_rate_Hz = 256.0", "sample_rate_kHz = 0.256", text)
    text = edited(r"^answer_timeout_s = 0.0025", "answer_timeout_ms = 2.5", text)
    text = edited(r"^triggered_by_sync = true", "triggered_by_sync = false", text)
    new, _ = converted_text(machine_from_text(text), 512.0)
    assert "sample_rate_kHz = 0.512\n" in new
    assert "answer_timeout_ms = 1.25 " in new
    machine = machine_from_text(new)
    assert (machine.overrun_ticks, machine.stale_ticks) == (16, 6)
    assert machine.bus is not None
    assert machine.bus.imu is not None
    assert machine.bus.imu.rate_Hz == 256.0  # on a clock of its own


def test_there_and_back_is_the_same_machine() -> None:
    back = converted(converted(CARM, 512.0), 256.0)
    assert back.plant.substeps == CARM.plant.substeps
    assert (back.overrun_ticks, back.stale_ticks) == (CARM.overrun_ticks, CARM.stale_ticks)
    for new, old in zip(back.controllers, CARM.controllers, strict=True):
        np.testing.assert_allclose(new.position_sections, old.position_sections, rtol=1e-9)


def test_loops_of_the_drives_are_carried_too() -> None:
    machine = machine_from_text(carm_text_in("position"))
    frequencies = np.array([0.5, 4.0, 9.0, 22.0])
    for new, old, share in zip(
        converted(machine, 512.0).drive_loops, machine.drive_loops, (0.2792, 1.0), strict=True
    ):  # 2 t / (1 + t), t = tan(atan(1 / 3) / 2)
        assert new is not None
        assert old is not None
        assert new.torque_sections is not None
        assert old.torque_sections is not None
        assert (new.position_gain, new.velocity_gain, new.velocity_integral_gain) == (
            old.position_gain,
            old.velocity_gain,
            old.velocity_integral_gain,
        )
        assert new.speed_filter == pytest.approx(share, abs=1e-4)
        ratio = response(new.torque_sections, frequencies, 512.0) / response(old.torque_sections, frequencies, 256.0)
        np.testing.assert_allclose(ratio, 1.0, atol=0.02)


def test_what_cannot_be_carried_over_is_refused_in_one_line() -> None:
    says = r"carm.toml: controller.propeller.position_sections: section 2: pole at 28.88 Hz; at 50 Hz it must lie below 25 Hz"
    with pytest.raises(MachineFileError, match=says):
        converted_text(CARM, 50.0)
    with pytest.raises(
        MachineFileError, match=r"drives.propeller.loops.speed_filter: corner at 26.22 Hz; at 100 Hz it must lie below 25 Hz"
    ):
        converted_text(machine_from_text(carm_text_in("velocity")), 100.0)
    for rate_Hz in (0.0, -256.0, np.nan, np.inf):
        with pytest.raises(UnusableInputError, match="positive number of Hz"):
            converted_text(CARM, rate_Hz)


def test_the_command_writes_the_file_and_shows_both_checks(isocenter: Isocenter, tmp_path: Path) -> None:
    out, answer = tmp_path / "fast.toml", tmp_path / "answer.json"
    done = isocenter("machine", "convert", "turntable", "--rate", 400, "-o", out, "--json", answer)
    assert done.status == 0, done.err
    assert load_machine(out).sample_rate_Hz == 400.0
    (row,) = [line for line in done.out.splitlines() if "turn phase margin" in line]
    shown = json.loads(answer.read_text())
    for findings in (shown["before"], shown["findings"]):
        margin = next(finding["values"]["phase_deg"] for finding in findings if finding["name"] == "phase_margin")
        assert f"{margin:.1f} deg" in row
    assert isocenter("machine", "check", out).status == 0


def test_a_file_that_fails_the_check_is_written_all_the_same(isocenter: Isocenter, tmp_path: Path) -> None:
    out = tmp_path / "slow.toml"
    done = isocenter("machine", "convert", "carm", "--rate", 128, "-o", out)
    assert done.status == 1
    assert "FAIL propeller: phase margin" in done.out
    assert load_machine(out).sample_rate_Hz == 128.0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("turntable", "--rate", "30000"), "timing.sample_rate_Hz = 30000.0: must be at most 20000"),
        (("emps", "--rate", "500"), "controller.carriage.position_sections: section 1: zero at 478 Hz"),
        (("carm", "--rate", "0"), "--rate 0: must be a positive number of Hz"),
    ],
)
def test_nothing_is_written_of_what_is_refused(isocenter: Isocenter, tmp_path: Path, arguments: tuple[str, ...], says: str) -> None:
    refused = isocenter("machine", "convert", *arguments, "-o", tmp_path / "new.toml")
    assert refused.status == 2
    assert says in refused.line
    assert list(tmp_path.iterdir()) == []


def test_a_machine_file_is_not_written_over(isocenter: Isocenter, tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text(load_machine("turntable").text)
    refused = isocenter("machine", "convert", own, "--rate", "400", "-o", own)
    assert refused.status == 2
    assert "write to another file" in refused.line


@pytest.mark.slow
@pytest.mark.parametrize("rate_Hz", [128.0, pytest.param(512.0, marks=pytest.mark.nightly)])
def test_the_c_arm_moves_at_other_rates_as_at_its_own(isocenter: Isocenter, tmp_path: Path, rate_Hz: float) -> None:
    own = tmp_path / "carm.toml"
    own.write_text(converted_text(CARM, rate_Hz)[0])
    for machine in ("carm", own):
        common = ("--machine", machine, "--bus", "lockstep:", "--accept-margins", "--no-noise")
        if machine == own:
            assert isocenter("run", "static", "--seconds", "1", *common, "-o", tmp_path / "static.mf4").status == 0
        scan = isocenter(
            "run", "scan", "--axis", "roll", "--from", "-20", "--to", "20", *common, "-o", tmp_path / f"{Path(machine).stem}.mf4"
        )
        assert scan.status == 0, scan.out + scan.err
        (tmp_path / "carm.mf4").rename(tmp_path / f"{'own' if machine == own else 'shipped'}.mf4")
    recording, shipped = (read_recording(tmp_path / f"{name}.mf4") for name in ("own", "shipped"))
    assert recording.sample_rate_Hz == pytest.approx(rate_Hz)
    assert not recording.channel("position_roll").missing.any()
    for channel, within_deg in (("reference_roll", 1e-3), ("position_roll", 0.05)):
        expected = np.interp(recording.time, shipped.time, shipped[channel])
        together = recording.time <= shipped.time[-1]
        apart = np.degrees(np.abs(recording[channel] - expected))[together]
        assert apart.max() < within_deg, channel
