"""Effects that a machine file states, as noise of its observer: how strong they are is known, what they do at an instant is not.

A modal model has no dry friction, play, misaligned sensor or warm structure in it. Each enters where the filter has a state for it, so that
the published variances count it: an effort at a drive or gear as a disturbance, how an inertial sensor sits and scales as its gains, what
two encoders of an axis differ by as an offset of the motor side, what a link side reads wrong as an offset of its own, and a turn that no
sensor sees as an offset of the detector's twist. An encoder's error changes within about a radian, which the machine turns in 1 / TURNING
seconds; a warm structure's as it warms.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from controllers.models.modal import ModalModel
from controllers.observers.modal_equations import GAINS
from controllers.observers.settings import ObserverNoise
from hil.machine import Machine
from hil.machine.drawn import typical
from hil.observing.geometry import placed_bodies
from hil.observing.noise import effort_gain
from virtual_bus.effects.places import spring_at
from virtual_bus.settings import EffectSetting

TURNING_rad_s = 0.5
"""About 30 deg/s: a scan."""

PASSING = np.sqrt(2.0 * TURNING_rad_s)
"""Walk per sqrt(s) of a process of first order that changes within a radian, over its deviation."""

LEVELS = {
    "coulomb_friction": ("Fc",),
    "stribeck_friction": ("Fs_minus_Fc",),
    "presliding_hysteresis": ("Fc", "Fs_minus_Fc"),
    "asymmetric_friction": ("Fc_plus",),
    "constant_load": ("tau0",),
    "cogging": ("A1", "A2"),
    "base_motion": ("A",),
}
"""Strengths that are efforts [Nm]."""

PER_SPEED = {"viscous_friction": "Fv", "temperature_dependent_friction": "Fv0"}
PER_POSITION = {"cable_spring": "kc"}
"""Strengths that are efforts at TURNING, and a radian off."""

GAPS = {"backlash": ("b",), "transmission_error": ("e1", "e2")}
"""Strengths that are deflections of a gear [rad]. An error of the teeth pushes as its wheel turns; play, which the load holds at one flank,
sets the motor side apart and pushes only for the instant in which it is crossed."""

RUBS_s = 1.0
"""Friction is constant but where an axis turns, starts or stops, as a telegraph signal that switches every two seconds: its spectrum is
that of a process of first order with half of that for its correlation time."""

COUNTED = frozenset({*LEVELS, *PER_SPEED, *PER_POSITION, *GAPS})
AS_OFFSETS = frozenset({"encoder_eccentricity", "thermal_bending", "imu_misalignment", "imu_scale_bias"})

RUN_s = 10.0
"""Length of a scan, at whose end a structure is warmer."""

AXES = ("x", "y", "z")


def with_unmodelled(noise: ObserverNoise, model: ModalModel, machine: Machine) -> ObserverNoise:
    """Return the noise with the effects that the machine's file states; unchanged where it states none.

    Where the file says in which range a size lies on one machine or another, its root mean square counts.

    Parameters
    ----------
    noise : ObserverNoise
        Of sensors, command and disturbances.
    model : ModalModel
        With disturbances at places, drives first.
    machine : Machine
    """
    if not machine.own_effects:
        return noise
    machine = typical(machine)
    axes, n = machine.axes, len(machine.axes)
    unit = effort_gain(machine)
    stiffness = {joint.name: joint.stiffness for joint in machine.plant.tree.joints}
    drive, gear, apart, read = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    turned, warming = np.zeros(3), np.zeros(3)
    _, to_detector = placed_bodies(machine.plant.tree.bodies)[machine.geometry.detector_body]  # type: ignore[union-attr]
    sensors = {imu.name: k for k, imu in enumerate(_in_order(model, machine))}
    bias, gain = np.zeros((len(sensors), 6)), np.zeros((len(sensors), GAINS))
    seen_at = {joint: k for k, axis in enumerate(axes) for joint in _link_joints(machine, axis)}
    for effect in machine.own_effects:
        if effect.at in axes:
            k = axes.index(effect.at)
            drive[k] = np.hypot(drive[k], _effort(effect))
            gap = _size(effect, GAPS.get(effect.name, ()))
            pushed = gap if effect.name == "transmission_error" else 0.0
            gear[k] = np.hypot(gear[k], pushed * stiffness.get(spring_at(effect.at, machine.plant) or "", 0.0))
            apart[k] = np.hypot(apart[k], gap)
        elif effect.name == "encoder_eccentricity":
            k = next(k for k, axis in enumerate(axes) if effect.at.endswith(f"position_{axis}"))
            side = read if effect.at.startswith("link_") else apart
            side[k] = np.hypot(side[k], _size(effect, ("a", "b")) / np.sqrt(2.0))  # of cosines
        elif effect.name == "thermal_bending":
            warm = -np.expm1(-(effect.parameters["warm_for"] + RUN_s) / effect.parameters["tau"])
            body = next(body for body in machine.plant.tree.bodies if body.name == effect.at)
            if body.joint.name in seen_at:  # type: ignore[union-attr]
                k = seen_at[body.joint.name]  # type: ignore[union-attr]
                apart[k] = np.hypot(apart[k], effect.parameters["bend"] * warm)
                continue
            axis = to_detector.T @ placed_bodies(machine.plant.tree.bodies)[body.name][1] @ body.joint.axis  # type: ignore[union-attr]
            turned = np.hypot(turned, effect.parameters["bend"] * warm * axis)
            warming = np.hypot(warming, effect.parameters["bend"] * warm * axis * np.sqrt(2.0 / effect.parameters["tau"]))
        elif effect.at in sensors and effect.name == "imu_misalignment":
            gain[sensors[effect.at], :3] = _size(effect, [f"r{x}" for x in AXES]) / np.sqrt(3.0)
        elif effect.at in sensors and effect.name == "imu_scale_bias":
            k = sensors[effect.at]
            gain[k, 3:6], gain[k, 6] = _size(effect, [f"s{x}" for x in AXES]) / np.sqrt(3.0), abs(effect.parameters["sg"])
            bias[k, :3], bias[k, 3:] = _size(effect, [f"b{x}" for x in AXES]) / np.sqrt(3.0), abs(effect.parameters["bg"])
    disturbance, time_s = noise.disturbance.copy(), noise.disturbance_time_s.copy()
    disturbance[:n] = np.hypot(disturbance[:n], drive / unit)
    beside = (noise.disturbance[:n] / disturbance[:n]) ** 2  # of the variance; power above both corners is the sum of both powers
    time_s[:n] = 1.0 / (beside / noise.disturbance_time_s[:n] + (1.0 - beside) / RUBS_s)
    gears = [j for j, place in enumerate(model.places) if place == "gear"]
    for number, j in enumerate(gears):
        disturbance[j] = np.hypot(disturbance[j], gear[number] if len(gears) == n else gear.max())
    offset = np.concatenate((np.hypot(noise.initial_offset[:n], apart), np.zeros(3), turned, read))
    walk = np.concatenate((np.hypot(noise.offset_walk[:n], offset[:n] * PASSING), np.zeros(3), warming, read * PASSING))
    return dataclasses.replace(
        noise,
        disturbance=disturbance,
        disturbance_time_s=time_s,
        initial_bias=np.hypot(noise.initial_bias, bias.ravel()),
        initial_gain=gain.ravel(),
        initial_offset=offset,
        offset_walk=walk,
    )


def without_counted(machine: Machine) -> Machine:
    """Return the machine without the effects that `with_unmodelled` counts: with what a modal model can have in it."""
    kept = tuple(effect for effect in machine.own_effects if effect.name not in COUNTED | AS_OFFSETS)
    effects = (*kept, *machine.added_effects)
    return dataclasses.replace(machine, plant=dataclasses.replace(machine.plant, effects=effects), own_effects=kept)


def _in_order(model: ModalModel, machine: Machine) -> list:  # type: ignore[type-arg]
    """Return the machine's IMUs in the order of the model's sensors."""
    by_channel = {f"{imu.name}_x": imu for imu in machine.plant.imus}
    return [by_channel[sensor.channels[0]] for sensor in model.sensors]


def _effort(effect: EffectSetting) -> float:
    """Return the effort [Nm] of an effect at a drive."""
    level = _size(effect, LEVELS.get(effect.name, ()))
    level += TURNING_rad_s * effect.parameters[PER_SPEED[effect.name]] if effect.name in PER_SPEED else 0.0
    return level + (effect.parameters[PER_POSITION[effect.name]] if effect.name in PER_POSITION else 0.0)


def _link_joints(machine: Machine, axis: str) -> tuple[str, ...]:
    """Return the joints that an axis's link side sees."""
    return next((encoder.joints for encoder in machine.plant.encoders if encoder.channel == f"link_position_{axis}"), ())


def _size(effect: EffectSetting, names: Sequence[str]) -> float:
    return float(np.sqrt(sum(effect.parameters[name] ** 2 for name in names)))
