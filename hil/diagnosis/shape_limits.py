"""What a motion can show of an effect's shape: an order, a frequency or a displacement beyond which it is another law (`form.py`)."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.motion import Motion
from hil.diagnosis.start_waves import TURNING_WITH_THE_MOTOR
from virtual_bus.effects.places import undriven_joint_at

HYSTERESES = ("bouc_wen_hysteresis", "presliding_hysteresis")

LEAST_SLIDING = 0.5
"""Of a stroke, that a hysteresis slides at least: after each reversal it gives way like a spring for twice its displacement of sliding. One
that mostly does is a spring with losses of any kind: two relaxing springs and one whose stiffness varies in time were fitted as one that
slides for -0.05, 0.25 and 0.44 of a stroke, twelve hidden hystereses for 0.82 and more; there the stroke of a spring without a drive was
taken as twice the drive's largest effort over its stiffness, 0.3 to 11 times of what `_stroke` gives."""


def shape_limit(name: str, at: str, motion: Motion) -> float:
    """What recordings can show of an effect's shape; 0 where that has no limit.

    Of a wave the lowest order [cycles per turn, as the effect counts it] or frequency [Hz]: half a cycle. Of a hysteresis the largest
    displacement [rad or m] at which it slides.
    """
    if name in HYSTERESES:
        return _stroke(motion, at) * (1.0 - LEAST_SLIDING) / 2.0
    if name in TURNING_WITH_THE_MOTOR:
        residual = motion.residual(at)
        return 0.5 * 2.0 * np.pi / (max(float(np.ptp(residual.position)), 1e-6) * residual.ratio)
    if name == "base_motion":
        return 0.5 / max(float(np.ptp(motion.residual(at).time_s)), 1e-6)
    return 0.0


def _stroke(motion: Motion, at: str) -> float:
    """From end to end [rad or m] of the joint a place belongs to: the axis' travel, or what a spring without a drive gives way."""
    settings = motion.machine.plant
    hanging = undriven_joint_at(at, settings)
    if hanging is None:
        return float(np.ptp(motion.residual(at).position))
    return float(np.ptp(motion.deflection(settings.tree.joint_index(hanging))))
