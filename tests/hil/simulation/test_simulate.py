"""A simulation has the contract's timing, start and rounding, and needs nothing of the recording but its inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import one_mass
import pytest

from hil.errors import BadAnswerError, ExperimentError, RecordingError
from hil.machine import Machine, load_machine, machine_from_text
from hil.recording import Channel, Recording
from hil.simulation import Simulator, inputs_of, simulate
from virtual_bus.physics import Physics
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.settings import EffectSetting

EMPS = load_machine("emps")
CARM = load_machine("carm")
ROWS = 600


def recording_of(
    machine: Machine, rows: int = ROWS, seed: int = 3, amplitude: float = 0.3, sweep: float | None = None, **others: dict[str, Channel]
) -> Recording:
    """Inputs of a smooth, exciting experiment."""
    time_s = np.arange(rows) / machine.sample_rate_Hz
    random = np.random.default_rng(seed)
    channels = {"time": Channel("s", time_s)}
    for units in machine.units:
        scale = (0.01 if units.position == "m" else 0.03) if sweep is None else sweep
        channels[f"reference_{units.axis}"] = Channel(units.position, scale * (1.0 - np.cos(2.0 * np.pi * 2.0 * time_s)))
        channels[f"excitation_{units.axis}"] = Channel(units.effort, amplitude * random.standard_normal(rows))
    return Recording(channels | others.pop("channels", {}), others)


def edited(machine: Machine, *pairs: tuple[str, str]) -> Machine:
    text = machine.text
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    return machine_from_text(text)


def expected(machine: Machine, recording: Recording, start: float = 0.0) -> np.ndarray:
    body, drive, controller = machine.plant.tree.bodies[0], machine.plant.drives[0], machine.controllers[0]
    return one_mass.closed_loop(
        recording["reference_carriage"],
        recording["excitation_carriage"],
        mass=body.mass_kg,
        damping=body.joint.damping,
        gain=drive.constant * drive.ratio,
        period_s=1.0 / machine.sample_rate_Hz,
        position_sections=controller.position_sections,
        reference_sections=controller.reference_sections,
        limit=controller.limit,
        count=machine.plant.encoders[0].resolution,
        target_step=drive.resolution,
        start=start,
    )


@pytest.mark.parametrize(
    "changes",
    [
        [("resolution_um = 0.05", "resolution_um = 0.0")],
        [("resolution_um = 0.05", "resolution_um = 20.0"), ("limit_V = 10.0", "limit_V = 10.0\ntarget_resolution_mV = 50.0")],
        [("resolution_um = 0.05", "resolution_um = 0.0"), ("limit_V = 10.0", "limit_V = 0.7")],
        [("resolution_um = 0.05", "resolution_um = 0.0"), ("substeps = 1", "substeps = 4")],
    ],
    ids=["smooth", "quantised", "saturated", "four plant steps a sample"],
)
def test_closed_loop_equals_the_exact_recursion(changes: list[tuple[str, str]]) -> None:
    machine = edited(EMPS, *changes)
    recording = recording_of(machine)
    position, command = expected(machine, recording).T
    simulation = simulate(machine, recording)
    np.testing.assert_allclose(simulation["command_carriage"], command, atol=2e-7)
    np.testing.assert_allclose(simulation["position_carriage"], position, atol=1e-12)
    if "limit_V = 0.7" in machine.text:
        assert np.abs(command).max() == 0.7


def test_a_command_moves_the_position_two_rows_later() -> None:
    machine = edited(EMPS, ("resolution_um = 0.05", "resolution_um = 0.0"))
    recording = recording_of(machine, rows=6, amplitude=0.0, sweep=0.0)
    pulse = np.zeros(6)
    pulse[1] = 1.0
    pulsed = Recording({**recording.channels, "excitation_carriage": Channel("V", pulse)}, {})
    position = simulate(machine, pulsed)["position_carriage"]
    assert np.all(position[:3] == 0.0)  # command 1 acts from row 2 to row 3
    assert position[3] > 0.0


def test_only_reference_and_excitation_are_read() -> None:
    recording = recording_of(EMPS)
    noise = {"position_carriage": Channel("m", np.full(ROWS, 7.0)), "command_carriage": Channel("V", np.full(ROWS, np.nan))}
    disturbed = recording_of(EMPS, channels=noise)
    for name in ("position_carriage", "command_carriage"):
        np.testing.assert_array_equal(simulate(EMPS, recording)[name], simulate(EMPS, disturbed)[name])


def test_repeated_simulations_are_equal_bit_for_bit() -> None:
    recording = recording_of(CARM, amplitude=0.1)
    first, second = simulate(CARM, recording), simulate(CARM, recording)
    assert list(first.channels) == list(second.channels)
    for name in first.channels:
        np.testing.assert_array_equal(first[name], second[name])


@pytest.mark.parametrize("pose_deg", [(0.0, 0.0), (-100.0, 60.0), (75.0, -90.0)])
def test_a_machine_that_is_left_alone_stands_still_at_its_start_pose(pose_deg: tuple[float, float]) -> None:
    pose = np.radians(pose_deg)
    rows = 512
    still = recording_of(CARM, rows, amplitude=0.0, sweep=0.0)
    held = {f"reference_{axis}": Channel("rad", np.full(rows, pose[i])) for i, axis in enumerate(CARM.axes)}
    simulation = simulate(CARM, Recording({**still.channels, **held}, {"experiment": {"start_pose": list(pose)}}))
    for i, axis in enumerate(CARM.axes):
        resolution = CARM.plant.encoders[i].resolution
        assert np.abs(simulation[f"position_{axis}"] - pose[i]).max() <= 2.0 * resolution
        # the target's own step of 5 mA makes the loop wander by a few of them
        assert np.ptp(simulation[f"current_{axis}"]) < 0.08
    np.testing.assert_allclose(np.linalg.norm([simulation[f"imu_{axis}"] for axis in "xyz"], axis=0), 9.81, atol=0.02)


def test_without_effects_nothing_rubs_and_with_friction_the_command_shows_it() -> None:
    rows = 3000
    recording = recording_of(EMPS, rows, amplitude=0.0)
    smooth = simulate(EMPS, recording)["command_carriage"]
    rubbing = simulate(EMPS, recording, (EffectSetting("coulomb_friction", "carriage", {"Fc": 20.0}),))["command_carriage"]
    speed = np.gradient(recording["reference_carriage"], 1e-3)
    moving = np.abs(speed) > 0.05
    extra = (rubbing - smooth)[moving] * np.sign(speed[moving])
    assert np.median(extra) == pytest.approx(20.0 / 35.15065, rel=0.02)  # volts that 20 N cost


def test_parameters_change_without_another_machine_file() -> None:
    simulator = Simulator(EMPS)
    given = inputs_of(EMPS, recording_of(EMPS, amplitude=0.0))
    heavy = simulator.run(given, simulator.plant.with_values({"carriage.mass_kg": 190.2178}))
    other = Simulator(edited(EMPS, ("mass_kg = 95.1089", "mass_kg = 190.2178"))).run(given)
    np.testing.assert_array_equal(heavy.command, other.command)
    assert not np.array_equal(heavy.command, simulator.run(given).command)


def test_controller_states_of_the_metadata_are_taken_over() -> None:
    recording = recording_of(CARM, amplitude=0.0, sweep=0.0)
    states = {axis: {"position": [[0.5, 0.0], [0.0, 0.0], [0.0, 0.0]]} for axis in CARM.axes}
    bumped = Recording(recording.channels, {"initial": {"controller_states": states}})
    lead, notch = CARM.controllers[1].position_sections[1:]
    assert simulate(CARM, bumped)["command_roll"][0] == pytest.approx(0.5 * lead[0] * notch[0])


def test_it_starts_where_the_run_stood() -> None:
    """A loop that stood off its pose comes back as the exact recursion from there does."""
    machine = edited(EMPS, ("resolution_um = 0.05", "resolution_um = 0.0"))
    recording = recording_of(machine)
    stood = recording.with_metadata(initial={"standing": {"deviation": [2e-4], "speed": [0.0]}}, experiment={"start_pose": [0.0]})
    position, command = expected(machine, recording, start=2e-4).T
    simulation = simulate(machine, stood)
    np.testing.assert_allclose(simulation["command_carriage"], command, atol=2e-7)
    np.testing.assert_allclose(simulation["position_carriage"], position, atol=1e-12)
    assert simulation["position_carriage"][0] == 2e-4
    unread = recording.with_metadata(initial={"standing": {"deviation": [float("nan")]}}, experiment={"start_pose": [0.0]})
    assert simulate(machine, unread)["position_carriage"][0] == 0.0
    with pytest.raises(RecordingError, match=r"initial\.standing\.deviation has 2 entries"):
        simulate(machine, recording.with_metadata(initial={"standing": {"deviation": [0.0, 0.0]}}))


def test_an_open_loop_machine_is_driven_by_its_command() -> None:
    text = EMPS.text
    open_loop = machine_from_text(text[: text.index("# vir =")] + text[text.index("[limits.carriage]") :])
    command = np.where(np.arange(ROWS) < 300, 1.0, 0.0)
    recording = Recording({"time": Channel("s", np.arange(ROWS) * 1e-3), "command_carriage": Channel("V", command)}, {})
    position = simulate(open_loop, recording)["position_carriage"]
    # a step of force on a damped mass, from row 1 on
    time_s, mass, damping, force = (np.arange(300) - 1) * 1e-3, 95.1089, 203.5034, 35.15065
    exact = force / damping * (time_s - mass / damping * (1.0 - np.exp(-damping / mass * time_s)))
    np.testing.assert_allclose(position[1:300], exact[1:], atol=0.5e-7)


@pytest.mark.parametrize(
    ("encoders", "start"),
    [
        ({"position": [0.02, 0.03], "link_position": [0.05, 0.06]}, 0.02),
        ({"position": [np.nan, 0.03], "link_position": [0.05, 0.06]}, 0.03),
        ({"position": [np.nan, np.nan], "link_position": [0.05, 0.06]}, 0.05),
        ({"link_position": [0.05, 0.06]}, 0.05),
        ({"position": [0.02, np.nan]}, 0.02),
        ({}, 0.0),
    ],
)
def test_an_open_loop_starts_at_the_first_reading_of_each_axis(encoders: dict[str, list[float]], start: float) -> None:
    open_loop = replace(CARM, controllers=())
    time = Channel("s", np.arange(2) / open_loop.sample_rate_Hz)
    channels = {"time": time} | {f"command_{axis}": Channel("A", np.zeros(2)) for axis in open_loop.axes}
    channels |= {f"{name}_roll": Channel("rad", np.array(values)) for name, values in encoders.items()}
    np.testing.assert_array_equal(inputs_of(open_loop, Recording(channels, {})).start_pose, [0.0, start])


def test_an_unstable_loop_is_reported_with_its_time() -> None:
    strong, unlimited, smooth = ("[160720.821,", "[-1.0e150,"), ("limit_V = 10.0", "limit_V = 1e308"), ("_um = 0.05", "_um = 0.0")
    wild = edited(EMPS, strong, unlimited, smooth)
    with pytest.raises(BadAnswerError, match=r"emps: the simulation diverged at .* s; check the controller"):
        simulate(wild, recording_of(EMPS))


def test_a_start_that_nothing_holds_is_refused() -> None:
    text = CARM.text.replace("[1141.398991, -1138.601009, 0.0, 1.0, -1.0, 0.0]", "[100.0, 0.0, 0.0, 1.0, 0.0, 0.0]")
    with pytest.raises(ExperimentError, match="propeller: nothing in the controller holds"):
        simulate(machine_from_text(text), recording_of(CARM))


def test_a_hole_in_the_inputs_names_channel_and_row() -> None:
    recording = recording_of(EMPS)
    holed = recording["reference_carriage"].copy()
    holed[41] = np.nan
    with pytest.raises(RecordingError, match=r"reference_carriage is missing in row 41 \(0\.041 s\)"):
        simulate(EMPS, Recording({**recording.channels, "reference_carriage": Channel("m", holed)}, {}))


def test_another_sample_rate_is_refused() -> None:
    with pytest.raises(RecordingError, match="1000 rows a second; carm runs at 256 Hz"):
        simulate(CARM, recording_of(EMPS))


def test_a_recording_without_reference_is_refused() -> None:
    with pytest.raises(RecordingError, match="reference_carriage"):
        simulate(EMPS, Recording({"time": Channel("s", np.arange(9) * 1e-3)}, {}))


def test_what_damping_added_to_the_command_drives_the_simulation_lost_ticks_included() -> None:
    plain = recording_of(CARM)
    added = {axis: 0.2 * np.sin(0.05 * np.arange(ROWS) + k) for k, axis in enumerate(CARM.axes)}
    channels = {f"damping_{axis}": Channel("A", values) for axis, values in added.items()} | {"damping_share": Channel("", np.ones(ROWS))}
    damped = Recording({**plain.channels, **channels}, plain.metadata)
    both = {f"excitation_{axis}": Channel("A", plain[f"excitation_{axis}"] + added[axis]) for axis in CARM.axes}
    expected = simulate(CARM, Recording({**plain.channels, **both}, plain.metadata))
    simulated = simulate(CARM, damped)
    for name in (f"{kind}_{axis}" for kind in ("command", "position") for axis in CARM.axes):
        assert np.array_equal(simulated[name], expected[name])
        assert not np.array_equal(simulated[name], simulate(CARM, plain)[name])
    kept = np.delete(np.arange(ROWS), [200, 201])
    gapped = Recording({name: Channel(channel.unit, channel.values[kept]) for name, channel in damped.channels.items()}, {"bench": {}})
    assert simulate(CARM, gapped)["position_roll"] == pytest.approx(expected["position_roll"][kept], abs=1e-4)


def test_imus_that_are_all_filtered_read_the_same_from_the_state_as_from_the_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, found = inputs_of(CARM, recording_of(CARM, 40)), []
    for filters_all in (True, False):
        with monkeypatch.context() as patch:
            patch.setattr(CompiledPlant, "filters_all", lambda plant, model, answer=filters_all: answer)
            physics = Physics(CARM.plant, noise=False)
            physics.place(np.zeros(2))
            physics.apply(np.array([0.5, -0.5]))
            for _ in range(20):
                physics.advance()
            found.append((physics.latch().imu.copy(), Simulator(CARM).run(inputs).imu))
    assert np.ptp(found[0][1], axis=0).min() > 0.0
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-9, atol=1e-9)
