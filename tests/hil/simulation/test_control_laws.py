"""The states that a controller had at row 0, from what it commanded: a simulation from there is what was recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.machine import Machine, load_machine
from hil.recording import Channel, Recording
from hil.simulation import simulate
from hil.simulation.control_laws import states_at_start
from virtual_bus.settings import EffectSetting

ROWS = 500
CARM, EMPS = load_machine("carm"), load_machine("emps")


def with_two_laws(machine: Machine) -> Machine:
    """The same loop with a law of its own on the reference."""
    (law,) = machine.controllers
    softer = law.position_sections.copy()
    softer[0, :3] *= 0.9
    return replace(machine, controllers=(replace(law, reference_sections=softer),))


MACHINES = {"carm": CARM, "emps": EMPS, "laws on reference and position": with_two_laws(EMPS)}


def begun(machine: Machine, seed: int, effects: tuple[EffectSetting, ...] = ()) -> Recording:
    """A recording that began with other states than those that hold the machine, its metadata without them."""
    print("seed", seed)
    random = np.random.default_rng(seed)
    time_s = np.arange(ROWS) / machine.sample_rate_Hz
    channels = {"time": Channel("s", time_s)}
    for units in machine.units:
        channels[f"reference_{units.axis}"] = Channel(units.position, 0.01 * (1.0 - np.cos(2.0 * np.pi * 1.5 * time_s)))
        channels[f"excitation_{units.axis}"] = Channel(units.effort, 0.05 * random.standard_normal(ROWS))
    states = {}
    for law in machine.controllers:
        sections = {"position": law.position_sections, "reference": law.reference_sections}
        sizes = {name: 0.02 * law.limit * random.uniform(-1.0, 1.0, (len(each), 2)) for name, each in sections.items() if each is not None}
        states[law.axis] = {name: values.tolist() for name, values in sizes.items()}
    simulated = simulate(machine, Recording(channels, {"initial": {"controller_states": states}}), effects)
    return Recording({**channels, **simulated.channels}, {})


@pytest.mark.parametrize("name", MACHINES)
def test_a_simulation_of_its_reference_alone_is_the_recording(name: str) -> None:
    machine = MACHINES[name]
    recording = begun(machine, 5)
    again = simulate(machine, recording)
    for axis in machine.axes:
        scale = np.ptp(recording[f"position_{axis}"])
        np.testing.assert_allclose(again[f"position_{axis}"], recording[f"position_{axis}"], atol=1e-3 * scale)
        off = recording[f"command_{axis}"] - again[f"command_{axis}"]
        assert np.sqrt(np.mean(off**2)) < 1e-3 * np.std(recording[f"command_{axis}"])


def test_friction_at_rest_holds_what_no_controller_has_to() -> None:
    """Friction holds the load of a machine whose controller begins with nothing; integrators that held it would push the machine away."""
    effects = (EffectSetting("coulomb_friction", "carriage", {"Fc": 40.0}), EffectSetting("constant_load", "carriage", {"tau0": 30.0}))
    recording = begun(EMPS, 7, effects)
    without = Recording({name: one for name, one in recording.channels.items() if not name.startswith("command")}, {})
    moved = recording["position_carriage"]
    true, held = (np.std(simulate(EMPS, each, effects)["position_carriage"] - moved) for each in (recording, without))
    assert true < 1e-2 * held


def test_a_drive_of_another_gain_has_the_states_of_the_law() -> None:
    recording = begun(EMPS, 9)
    plain = states_at_start(EMPS, recording)
    weaker = recording["command_carriage"] - recording["excitation_carriage"]
    channels = {**recording.channels, "command_carriage": Channel("V", 0.7 * weaker + recording["excitation_carriage"])}
    scaled = states_at_start(EMPS, Recording(channels, {}), with_gain=True)
    assert plain is not None
    assert scaled is not None
    law = EMPS.controllers[0].position_sections
    for found in (plain, scaled):
        assert found["carriage"]["position"].shape == (len(law), 2)
    np.testing.assert_allclose(scaled["carriage"]["position"], plain["carriage"]["position"], rtol=1e-3)
    assert states_at_start(EMPS, Recording(channels, {})) is None  # the file's controller gives another command


@pytest.mark.parametrize("given", ["nothing", "the excitation alone", "the opposite", "beyond the limit"])
def test_a_command_that_no_law_gives_has_no_states(given: str) -> None:
    recording = begun(EMPS, 13)
    own = recording["command_carriage"] - recording["excitation_carriage"]
    commands = {"nothing": 0.0 * own, "the excitation alone": recording["excitation_carriage"]}
    beyond = np.where(np.arange(ROWS) < 3, 3.0 * EMPS.controllers[0].limit, recording["command_carriage"])
    commands |= {"the opposite": recording["excitation_carriage"] - own, "beyond the limit": beyond}
    changed = Recording({**recording.channels, "command_carriage": Channel("V", commands[given])}, {})
    assert states_at_start(EMPS, changed) is None
    assert states_at_start(EMPS, changed, with_gain=True) is None


def test_of_a_command_of_another_law_nothing_is_said() -> None:
    recording = begun(EMPS, 11)
    noisy = recording["command_carriage"] + 0.01 * np.random.default_rng(1).standard_normal(ROWS)
    assert states_at_start(EMPS, Recording({**recording.channels, "command_carriage": Channel("V", noisy)}, {})) is None
    without = {name: one for name, one in recording.channels.items() if name != "position_carriage"}
    assert states_at_start(EMPS, Recording(without, {})) is None
