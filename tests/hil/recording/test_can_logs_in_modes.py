"""CAN logs of drives that a master commands velocities or positions: targets and offsets, packed here by hand, as channels."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import numpy as np
import pytest
from bench_machines import CARM, carm_text_in, edited

from hil.machine import Machine, machine_from_text
from hil.recording import RecordingWarning, read_recording
from hil.simulation import in_effort

PERIOD_S = 1.0 / 256.0
ROWS = 6
COUNT = 2.0 * np.pi / (500 * 4096)  # rad at the joint
A_PER_MILLE = 5.0 / 1000.0


def log(folder: Path, rows: list[tuple[int, bytes]], beside: list[bytes] | None = None) -> Path:
    """A candump of SYNCs, positions of roll and its first RPDO, and its second where there is one."""
    path = folder / "bus.log"
    with can.Logger(path) as logger:
        for k, (counts, data) in enumerate(rows):
            position = struct.pack("<Hih", 0x1237, (counts + 2**31) % 2**32 - 2**31, 0)
            further = [] if beside is None else [(0x302, beside[k])]
            for place, (can_id, payload) in enumerate([(0x080, b""), (0x182, position), (0x202, data), *further]):
                time = 1.7e9 + k * PERIOD_S + 1e-4 * place
                logger(can.Message(timestamp=time, arbitration_id=can_id, data=payload, is_extended_id=False, channel=0))
    return path


def carm(mode: str, mapped: str, more: str = "", second: str = "") -> Machine:
    """The C-arm with drives in a mode, these objects in their first RPDO and one in a second, of COB-ID 301h and 302h."""
    text = carm_text_in("velocity" if mode.endswith("velocity") else "position") if mode != "torque" else CARM.text
    text = text.replace('mode = "velocity"', f'mode = "{mode}"').replace('mode = "position"', f'mode = "{mode}"')
    text = edited(r'^map = \["controlword", .*\]$', f'map = ["controlword", {mapped}]', text)
    for node, name in ((1, "propeller_drive"), (2, "roll_drive")):
        table = f"[[bus.nodes.{name}.rpdo]]\nnumber = 2\ncob_id = {0x300 + node}\ntransmission_type = 1\nmap = [{second}]\n"
        text = edited(rf"^(\[\[bus\.nodes\.{name}\.rpdo\]\]\n(?:.+\n)+)", rf"\g<1>{table}", text) if second else text
    return machine_from_text(edited(r"^(constant_unit = .*)$", rf"\g<1>{more}", text))


K = np.arange(ROWS)


def test_a_velocity_its_offset_and_the_torque_beside(tmp_path: Path) -> None:
    machine = carm("velocity", '"target_velocity", "torque_offset"')
    recording = read_recording(log(tmp_path, [(0, struct.pack("<Hih", 0x0F, 1000 * k, 10 * k)) for k in K]), machine)
    assert recording.channels["command_roll"].unit == "rad/s"
    np.testing.assert_allclose(recording["command_roll"], 1000 * K * COUNT)
    assert recording.channels["excitation_roll"].unit == "A"
    np.testing.assert_allclose(recording["excitation_roll"], 10 * K * A_PER_MILLE)
    assert recording.metadata["commands"]["roll"] == {"mode": "velocity", "unit": "rad/s", "excitation_unit": "A"}
    assert "command_roll" not in in_effort(recording), "a velocity is no effort"


def test_a_velocity_offset_is_part_of_the_command_and_the_excitation_in_its_unit(tmp_path: Path) -> None:
    machine = carm("profile_velocity", '"target_velocity"', second='"velocity_offset"')
    rows = [(0, struct.pack("<Hi", 0x0F, 1000)) for _ in K]
    recording = read_recording(log(tmp_path, rows, [struct.pack("<i", -300 * k) for k in K]), machine)
    assert recording.channels["excitation_roll"].unit == "rad/s"
    np.testing.assert_allclose(recording["excitation_roll"], -300 * K * COUNT)
    np.testing.assert_allclose(recording["command_roll"], (1000 - 300 * K) * COUNT)
    assert recording.metadata["commands"]["roll"]["excitation_unit"] == "rad/s"


def test_offsets_of_position_and_velocity_beside_a_position(tmp_path: Path) -> None:
    machine = carm("position", '"target_position", "torque_offset"', second='"position_offset", "velocity_offset"')
    rows = [(0, struct.pack("<Hih", 0x0F, 50, 3 * k)) for k in K]
    recording = read_recording(log(tmp_path, rows, [struct.pack("<ii", 7 * k, 900 * k) for k in K]), machine)
    np.testing.assert_allclose(recording["command_roll"], (50 + 7 * K) * COUNT)
    np.testing.assert_allclose(recording["excitation_roll"], 3 * K * A_PER_MILLE)
    assert recording.channels["velocity_offset_roll"].unit == "rad/s"
    np.testing.assert_allclose(recording["velocity_offset_roll"], 900 * K * COUNT)


def test_a_velocity_in_rpm_of_the_motor(tmp_path: Path) -> None:
    machine = carm("profile_velocity", '"target_velocity"', r'\nvelocity_unit = "0.1 rpm"')
    recording = read_recording(log(tmp_path, [(0, struct.pack("<Hi", 0x0F, 150 * k)) for k in K]), machine)
    np.testing.assert_allclose(recording["command_roll"], 15 * K / 60 * 2.0 * np.pi / 500)


def test_a_position_goes_on_over_the_end_of_the_counter_as_the_axis_does(tmp_path: Path) -> None:
    machine = carm("position", '"target_position", "torque_offset"')
    counts = 2**31 - 250 + 100 * K
    ahead = [(int(n) + 70 + 2**31) % 2**32 - 2**31 for n in counts]
    rows = [(int(n), struct.pack("<Hih", 0x0F, target, 0)) for n, target in zip(counts, ahead, strict=True)]
    recording = read_recording(log(tmp_path, rows), machine)
    assert recording.channels["command_roll"].unit == "rad"
    np.testing.assert_allclose(recording["command_roll"] - recording["position_roll"], 70 * COUNT, rtol=1e-6)


def test_a_torque_offset_alone_is_the_command_in_torque_mode(tmp_path: Path) -> None:
    rows = [(0, struct.pack("<Hh", 0x0F, 30 * k)) for k in K]
    recording = read_recording(log(tmp_path, rows), carm("torque", '"torque_offset"'))
    np.testing.assert_allclose(recording["command_roll"], 30 * K * A_PER_MILLE)
    assert "excitation_roll" not in recording


@pytest.mark.filterwarnings("default")
def test_a_target_of_another_mode_is_no_command_and_is_said(tmp_path: Path) -> None:
    machine = carm("profile_position", '"target_position"', second='"target_velocity"')
    rows = [(0, struct.pack("<Hi", 0x0F, 70)) for _ in K]
    with pytest.warns(RecordingWarning, match="60FF"):
        recording = read_recording(log(tmp_path, rows, [struct.pack("<i", 5)] * ROWS), machine)
    np.testing.assert_allclose(recording["command_roll"], 70 * COUNT)
