"""Structural modes by the matched filter: what a light mass on a spring of every frequency would do, beside what the recordings show.

A mode of which little is hidden rings in a band that is narrower than the steps of a coarse search, with a phase that turns within it: half
a bandwidth off, the filter wants less mass than none. Here a mass swings along with the motion of the free run at every frequency, pulls at
its joint through the linear closed loop and counts in units of noise, as lines and orders do (`filtered_lines.py`, `filtered_orders.py`).
Of a mode of 0.1 g m2 at 12.37 Hz beside a gyro's lost sign, which gains 190, a start at 12.62 Hz with a thousand times that mass shows
nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.signal

from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.start_frequencies import LIGHTEST, HIGHEST_MODE_Hz, LOWEST_MODE_Hz
from hil.diagnosis.starting.through_the_loop import ThroughTheLoop
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.places import joint_at
from virtual_bus.effects.registry import effects

STEP = 0.5 * LIGHTEST
"""Between the logarithms of frequencies: a quarter of a half-power bandwidth."""

ENERGY_STEP = 0.1
"""The same where the energy of a mode's answer is computed: from one frequency to the next it changes little."""

HIGHEST_SHARE = 0.3
"""Of the sample rate, up to which modes are looked for."""

ASKED = 6
"""Frequencies of the largest energy by that, which are asked with other damping ratios."""

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
    joints = [joint.name for joint in machine.plant.tree.joints]
    joint = joints.index(joint_at(candidate.effect.at, machine.plant))
    accelerations = tuple(_acceleration(motion, joint) for motion in motions)
    mass = _Mass(loop, Projection.of(tuning), joint, accelerations, machine.sample_rate_Hz)
    lowest, highest = np.log(LOWEST_MODE_Hz), np.log(min(HIGHEST_MODE_Hz, HIGHEST_SHARE * machine.sample_rate_Hz))
    if highest <= lowest:
        return []
    tried, known = np.arange(lowest, highest, STEP), np.arange(lowest, highest + ENERGY_STEP, ENERGY_STEP)
    energies = [mass.answer(frequency, LIGHTEST) for frequency in np.exp(known)]
    energy = np.exp(np.interp(tried, known, [np.log(max(float(answer @ answer), 1e-300)) for answer in energies]))
    products = np.array([mass.product(behind, frequency, LIGHTEST) for frequency in np.exp(tried)])
    asked: list[float] = []
    for k in np.argsort(-(np.maximum(products, 0.0) ** 2) / energy):
        if products[k] > 0.0 and all(abs(tried[k] - other) > APART for other in asked):
            asked.append(float(tried[k]))
        if len(asked) == ASKED:
            break
    scored = [max(mass.filtered(frequency, damping, left) for damping in DAMPING_RATIOS) for frequency in np.exp(asked)]
    return [_values(candidate, *mode) for gains, *mode in sorted(scored, reverse=True)[:STARTS] if gains > 0.0]


@dataclass(frozen=True, eq=False)
class _Mass:
    """A unit mass on a spring at a joint that moves with `accelerations`, (N,) per group."""

    loop: ThroughTheLoop
    projection: Projection
    joint: int
    accelerations: tuple[np.ndarray, ...]
    rate_Hz: float

    def pulls(self, frequency_Hz: float, damping: float) -> list[np.ndarray]:
        """(N,) effort on the joint [Nm or N] per group."""
        return [_pull(own, self.rate_Hz, frequency_Hz, damping) for own in self.accelerations]

    def answer(self, frequency_Hz: float, damping: float) -> np.ndarray:
        """(M + F,) what it does to the recordings and re-tuning cannot imitate."""
        (answer,) = self.projection.left(self.loop.responses([[(self.joint, pull)] for pull in self.pulls(frequency_Hz, damping)]))
        return np.asarray(answer)

    def product(self, behind: Sequence[np.ndarray], frequency_Hz: float, damping: float) -> float:
        """Of its answer and the residual."""
        each = zip(self.pulls(frequency_Hz, damping), behind, strict=True)
        return sum(float(pull @ effort[:, self.joint]) for pull, effort in each)

    def filtered(self, frequency_Hz: float, damping: float, left: np.ndarray) -> tuple[float, float, float, float]:
        """The residual's energy along it, the mass that it wants, frequency and damping ratio; no energy where it wants none."""
        answer = self.answer(frequency_Hz, damping)
        energy, along = float(answer @ answer), float(answer @ left)
        if energy == 0.0 or along <= 0.0:
            return 0.0, 0.0, frequency_Hz, damping
        return along**2 / energy, along / energy, frequency_Hz, damping


def _acceleration(motion: Motion, joint: int) -> np.ndarray:
    """(N,) of a joint [rad/s^2 or m/s^2]: of a driven one in the simulation, which has no sensor's noise, and else of what pushes it from
    its spring's rest.
    """
    driven, step_s = list(motion.plant.joint_of_axis().values()), 1.0 / motion.machine.sample_rate_Hz
    if joint not in driven:
        moved = motion.deflection(joint)
    elif (encoder := f"position_{motion.machine.axes[driven.index(joint)]}") in motion.channels:
        moved = motion.group.simulated[:, motion.channels.index(encoder)]
    else:
        moved = motion.group.position[:, driven.index(joint)]
    bend = np.diff(moved, 2) / step_s**2
    return np.concatenate([[0.0], bend, bend[-1:]])  # from rest


def _pull(acceleration: np.ndarray, rate_Hz: float, frequency_Hz: float, damping: float) -> np.ndarray:
    """(N,) effort on a joint [Nm or N] of a unit mass on a spring that it moves, at rest at first."""
    w, c = 2.0 * np.pi * frequency_Hz, 1.0 / np.tan(np.pi * frequency_Hz / rate_Hz)  # bilinear, right at its own frequency
    c *= w
    swings = 2.0 * damping * w * c
    above = np.array([swings + w * w, 2.0 * w * w, w * w - swings])
    below = np.array([c * c + swings + w * w, 2.0 * (w * w - c * c), c * c - swings + w * w])
    return -scipy.signal.lfilter(above / below[0], below / below[0], acceleration)


def _values(candidate: Candidate, mass: float, frequency_Hz: float, damping: float) -> np.ndarray:
    named = {"J": mass, "f": frequency_Hz, "zeta": damping}
    return np.array([np.clip(named[p.name], p.low, p.high) for p in effects()[candidate.effect.effect].parameters])
