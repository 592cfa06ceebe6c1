"""Structural modes by the matched filter: what a light mass on a spring of every frequency would do to the recordings, beside what they show.

A mode of which little is hidden rings in a band that is narrower than the steps of a coarse search, with a phase that turns within it: half
a bandwidth off, the filter wants less mass than none. Here every frequency shakes its joint with the motion that the recordings have, goes
through the linear closed loop and counts in units of noise, as lines and orders do (`filtered_lines.py`, `filtered_orders.py`). Of a mode of
0.1 g m2 at 12.37 Hz beside a gyro's lost sign, which gains 190, starts at 12.62 Hz and a thousand times that mass showed nothing (2975,
spent).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.ndimage
import scipy.signal

from hil.diagnosis.candidates import Candidate
from hil.diagnosis.motion import Motion
from hil.diagnosis.projection import Projection
from hil.diagnosis.retune import Tuning
from hil.diagnosis.start_frequencies import HIGHEST_MODE_Hz, LIGHTEST, LINES_AROUND, LOWEST_MODE_Hz
from hil.diagnosis.through_the_loop import ThroughTheLoop
from virtual_bus.effects.places import joint_at
from virtual_bus.effects.registry import effects

STEP = 0.5 * LIGHTEST
"""Between the logarithms of frequencies: a quarter of a half-power bandwidth."""

HIGHEST_SHARE = 0.3
"""Of the sample rate, up to which modes are looked for."""

ASKED = 6
"""Frequencies that stand out most, which are asked with re-tuning taken out."""

APART = 4.0 * LIGHTEST
"""Between the logarithms of these."""

DAMPING_RATIOS = (0.003, LIGHTEST, 0.03)
"""That they are asked with."""

STARTS = 2
"""Of the largest energy, that fits may start from."""


def mode_starts(
    loop: ThroughTheLoop, tuning: Tuning, candidate: Candidate, motions: Sequence[Motion], behind: Sequence[np.ndarray], left: np.ndarray
) -> list[np.ndarray]:
    """(parameters,) of modes at the frequencies of the largest energy, the largest first.

    Parameters
    ----------
    loop : ThroughTheLoop
    tuning : Tuning
        Without effects.
    candidate : Candidate
        A structural mode.
    motions : sequence of Motion
        Of every training group, beside what was found.
    behind : sequence of (N, joints + axes) arrays
        The residual taken back through the loop (`ThroughTheLoop.efforts_behind`).
    left : (M + F,) array
        The residual with re-tuning taken out.
    """
    machine = motions[0].machine
    rate_Hz, joints = machine.sample_rate_Hz, [joint.name for joint in machine.plant.tree.joints]
    joint = joints.index(joint_at(candidate.effect.at, machine.plant))
    accelerations = [_acceleration(motion, joint) for motion in motions]
    highest_Hz = min(HIGHEST_MODE_Hz, HIGHEST_SHARE * rate_Hz)
    frequencies = np.exp(np.arange(np.log(LOWEST_MODE_Hz), np.log(highest_Hz), STEP))
    if not len(frequencies):
        return []
    power = np.zeros(len(frequencies))
    for k, frequency in enumerate(frequencies):
        swings = [_pull(own, rate_Hz, frequency, LIGHTEST) + own for own in accelerations]  # less what a mass without a spring does
        product = sum(float(swing @ own[:, joint]) for swing, own in zip(swings, behind, strict=True))
        energy = sum(float(swing @ swing) for swing in swings)
        power[k] = max(product, 0.0) ** 2 / energy if energy > 0.0 else 0.0
    around = scipy.ndimage.median_filter(power, 2 * LINES_AROUND, mode="nearest")
    asked: list[float] = []
    for k in np.argsort(-power / np.maximum(around, 1e-3 * power.max() + 1e-300)):
        if power[k] > 0.0 and all(abs(np.log(frequencies[k] / other)) > APART for other in asked):
            asked.append(float(frequencies[k]))
        if len(asked) == ASKED:
            break
    scored = []
    for frequency in asked:
        scored.append(
            max(_filtered(loop, tuning, joint, accelerations, rate_Hz, frequency, damping, left) for damping in DAMPING_RATIOS)
        )
    return [_values(candidate, *mode) for energy, *mode in sorted(scored, reverse=True)[:STARTS] if energy > 0.0]


def _acceleration(motion: Motion, joint: int) -> np.ndarray:
    """(N,) of a joint [rad/s^2 or m/s^2]: of the recordings where it is driven, else of what is pushed from its spring's rest."""
    driven = list(motion.plant.joint_of_axis().values())
    if joint in driven:
        return motion.acceleration[:, driven.index(joint)]
    deflection, step_s = motion.deflection(joint), 1.0 / motion.machine.sample_rate_Hz
    return np.gradient(np.gradient(deflection, step_s), step_s)


def _pull(acceleration: np.ndarray, rate_Hz: float, frequency_Hz: float, damping: float) -> np.ndarray:
    """(N,) effort on a joint [Nm or N] of a unit mass on a spring that it moves, at rest at first."""
    w, c = 2.0 * np.pi * frequency_Hz, 1.0 / np.tan(np.pi * frequency_Hz / rate_Hz)  # bilinear, right at its own frequency
    c *= w
    swings = 2.0 * damping * w * c
    above = np.array([swings + w * w, 2.0 * w * w, w * w - swings])
    below = np.array([c * c + swings + w * w, 2.0 * (w * w - c * c), c * c - swings + w * w])
    return -scipy.signal.lfilter(above / below[0], below / below[0], acceleration)


def _filtered(
    loop: ThroughTheLoop,
    tuning: Tuning,
    joint: int,
    accelerations: Sequence[np.ndarray],
    rate_Hz: float,
    frequency_Hz: float,
    damping: float,
    left: np.ndarray,
) -> tuple[float, float, float, float]:
    """The residual's energy along a mode, the mass that it wants, its frequency and its damping ratio; no energy where it wants none."""
    (response,) = Projection.of(tuning).left(loop.responses([[(joint, _pull(own, rate_Hz, frequency_Hz, damping))] for own in accelerations]))
    energy, along = float(response @ response), float(response @ left)
    if energy == 0.0 or along <= 0.0:
        return 0.0, 0.0, frequency_Hz, damping
    return along**2 / energy, along / energy, frequency_Hz, damping


def _values(candidate: Candidate, mass: float, frequency_Hz: float, damping: float) -> np.ndarray:
    named = {"J": mass, "f": frequency_Hz, "zeta": damping}
    return np.array([np.clip(named[p.name], p.low, p.high) for p in effects()[candidate.effect.effect].parameters])
