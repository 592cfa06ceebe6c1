"""Recordings and frequency responses of an emulated machine without its bus: for a first observer, before a machine has been measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from controllers.excitation_lines import Band
from hil.experiments import Jog, Multisine, Plan
from hil.experiments.modest import possible_multisine
from hil.identification import FrequencyResponse, identify
from hil.machine import Machine
from hil.observing.over_poses import observed_channels
from hil.recording import Channel, Recording, recording_metadata
from hil.recording.channels import imu_channels
from hil.simulation import Inputs, Simulator
from virtual_bus.sensors.measure import noise_rms

EXCITED_Hz = (1.0, 40.0)
EXCITATION_SHARE = 0.1  # of what a drive may give, rms: far above noise, far below the limit
PERIOD_s = 20.0
PERIODS = 2


def emulated_recording(machine: Machine, plan: Plan, seed: int, simulator: Simulator | None = None) -> Recording:
    """Record a plan on the emulated machine: the simulation with the sensors' noise on it."""
    simulator = Simulator(machine) if simulator is None else simulator
    rows = len(plan.reference)
    nothing = np.zeros((rows, len(machine.axes)))
    feedforward = nothing if plan.feedforward is None else plan.feedforward
    outputs = simulator.run(Inputs(plan.reference, plan.excitation, feedforward, None, plan.start_pose))
    channels = {"time": Channel("s", np.arange(rows) / machine.sample_rate_Hz)}
    generator = np.random.default_rng(seed)
    rms = noise_rms(machine.plant)
    for k, units in enumerate(machine.units):
        axis = units.axis
        channels[f"reference_{axis}"] = Channel(units.position, plan.reference[:, k])
        channels[f"excitation_{axis}"] = Channel(units.effort, plan.excitation[:, k])
        channels[f"command_{axis}"] = Channel(units.effort, outputs.command[:, k])
        measured = outputs.effort[:, k] + rms[f"current_{axis}"] * generator.standard_normal(rows)
        channels[f"{'current' if units.effort == 'A' else 'effort'}_{axis}"] = Channel(units.effort, measured)
        channels[f"position_{axis}"] = Channel(units.position, outputs.position[:, k])
        channels[f"link_position_{axis}"] = Channel(units.position, outputs.link_position[:, k])
    for index, imu in enumerate(machine.plant.imus):
        for j, name in enumerate(imu_channels(imu.name)):
            kind, axis = ("accelerometer", "xyz"[j]) if j < 3 else ("gyro", "xyz"[j - 3])
            noise = rms[f"{imu.name}.{kind}_{axis}"] * generator.standard_normal(rows)
            channels[name] = Channel("m/s^2" if j < 3 else "rad/s", outputs.imu[:, 6 * index + j] + noise)
    return Recording(channels, recording_metadata(machine, plan.metadata, {"seed": seed}))


def emulated_responses(
    machine: Machine,
    poses: Sequence[Mapping[str, float]],
    seed: int = 0,
    done: Callable[[], None] = lambda: None,
) -> list[FrequencyResponse]:
    """Return frequency responses at poses, from multisines on the emulated machine under jog; `done` is called after each."""
    simulator = Simulator(machine)
    amplitude = {each.axis: EXCITATION_SHARE * each.limit for each in machine.controllers}
    responses = []
    for index, pose in enumerate(poses):
        experiment = Multisine(
            pose=pose, lines=Band(*EXCITED_Hz), amplitude_A=amplitude, period_s=PERIOD_s, periods=PERIODS, jog=Jog(), seed=seed + index
        )
        plans = possible_multisine(machine, experiment)
        recordings = [emulated_recording(machine, plan, 1000 * (seed + 1) + 10 * index + j, simulator) for j, plan in enumerate(plans)]
        responses.append(identify(recordings, "robust_bla", outputs=observed_channels(machine)))
        done()
    return responses
