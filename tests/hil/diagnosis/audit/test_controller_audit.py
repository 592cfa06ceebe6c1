"""Controllers that are not the machine file's are found and measured, sound ones are not accused."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from places import BENCHMARKS, DATA, needs_data

from hil.diagnosis.audit.audit import audit
from hil.diagnosis.audit.controller import audit_controllers
from hil.machine import Machine, load_machine
from hil.recording import Channel, Recording, read_recording, recording_metadata
from hil.simulation.control_laws import command_resolution, controllers_of

sys.path.insert(0, str(BENCHMARKS))
from controller_faults import KINDS, closed_loop, drawn, is_found

SEED = 11


@pytest.fixture(params=["carm", "turntable", "emps"])
def machine(request: pytest.FixtureRequest) -> Machine:
    return load_machine(request.param)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_found_and_measured(machine: Machine, kind: str) -> None:
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    fault = drawn(rng, kind, machine)
    audit = audit_controllers(machine, [closed_loop(machine, rng, fault) for _ in range(2)])[0]
    assert is_found(audit, fault, machine), audit.said


def test_a_sound_controller_is_as_filed(machine: Machine) -> None:
    audit = audit_controllers(machine, [closed_loop(machine, np.random.default_rng(SEED), {})])[0]
    assert audit.status == "as_filed"
    assert audit.gain.value == pytest.approx(1.0, abs=1e-6)
    assert audit.delay_s.value == 0.0


def test_a_gain_that_was_changed_between_recordings_is_told_of_its_own(machine: Machine) -> None:
    """No one law gives the commands of both."""
    rng = np.random.default_rng(SEED)
    both = {"before": closed_loop(machine, rng, {}), "after": closed_loop(machine, rng, {"gain": 0.8})}
    axis = audit(machine, both).axes[0]
    assert axis.status == "differs"
    assert axis.gain.value == pytest.approx(0.8, abs=1e-4)
    assert axis.said.startswith(f"after: {machine.axes[0]}: the recorded command is 0.800 times")
    assert "before" not in axis.said


def test_a_command_of_another_origin_is_unknown(machine: Machine) -> None:
    rng = np.random.default_rng(SEED)
    recording = closed_loop(machine, rng, {})
    name = f"command_{machine.axes[0]}"
    channels = dict(recording.channels)
    channels[name] = Channel(channels[name].unit, recording[name] + 0.1 * recording[name].std() * rng.normal(size=recording.rows))
    audit = audit_controllers(machine, [Recording(channels, recording.metadata)])[0]
    assert audit.status == "unknown"
    assert "no law" in audit.said


def test_without_a_command_there_is_nothing_to_audit(machine: Machine) -> None:
    recording = closed_loop(machine, np.random.default_rng(SEED), {})
    channels = {name: channel for name, channel in recording.channels.items() if not name.startswith("command_")}
    assert audit_controllers(machine, [Recording(channels, recording.metadata)]) == []


def test_a_recording_brings_its_own_controller() -> None:
    carm = load_machine("carm")
    softer = carm.text.replace("1141.398991, -1138.601009", "856.04924325, -853.95075675")
    own = Recording({"time": Channel("s", np.arange(3.0))}, {**recording_metadata(carm), "machine": {"text": softer}})
    found = controllers_of(carm, own)
    assert found.controllers[0].position_sections[0, 0] == pytest.approx(856.04924325)
    assert found.plant is carm.plant


@pytest.mark.parametrize(("values", "step"), [([0.0, 0.5, 1.5, -2.0], 0.5), ([0.1, 0.30000001, 0.7], None)])
def test_the_lattice_of_commands(values: list[float], step: float | None) -> None:
    found = command_resolution(np.array(values))
    if step is None:
        assert found < 1e-8
    else:
        assert found == pytest.approx(step)


@needs_data("field", "small inputs that fail")
def test_a_drive_that_runs_at_four_fifths_of_the_file_s_gain() -> None:
    turntable = load_machine(DATA / "field" / "work" / "turntable.toml")
    folder = DATA / "field" / "18-servo-gain-off"
    (audit,) = audit_controllers(turntable, [read_recording(path, turntable) for path in sorted(folder.glob("r*.csv"))])
    assert audit.status == "differs"
    assert audit.gain.value == pytest.approx(0.8, abs=1e-9)
    assert "0.800 times what the file's controller computes" in audit.said
