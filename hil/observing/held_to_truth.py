"""What an observer states of its errors, held to the truth of emulated machines drawn from the file, and scaled to be true.

NIS judges what sensors show within a sample. What is published is wrong by what they do not show at once: a sensor's slow error, a bend
that looks like a bias. So a noise model may be too wide for the one and too narrow for the other, and tuning by innovations cannot mend
that. Machines are drawn within the ranges of the file's effects, each is scanned quietly, fast and there and back, every other one about
poses of its own, and of every published quantity the error that was is compared with the one that was stated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from controllers.observers.consistency import means
from controllers.observers.modal_observer import ModalObserver
from controllers.observers.publish import QUANTITIES, of_quantities
from controllers.observers.settings import ObserverNoise
from hil.errors import ExperimentError
from hil.experiments import Plan, Scan
from hil.experiments.modest import middle_pose, possible_scan
from hil.machine import Machine
from hil.machine.drawn import drawn
from hil.observing.replay import observe
from hil.observing.true_scan import TrueScan, published_truth, true_scan
from hil.observing.usual import usual_means

MACHINES = 8
"""Of a Latin hypercube. A slow error counts once a scan: of 8 scans of a kind a root mean square is known to a quarter."""

SEED = 79_000
"""Of the draws: others than those of a table."""

KINDS = {"quiet": (0.5, 1), "fast": (0.9, 1), "reversed": (0.5, 2)}
"""Share of the axis's speed, and sweeps."""

REACH, AWAY = 0.85, 0.7
"""Shares of half the range: how far a scan goes, and how far from the middle the other axes may stand."""

LARGEST_rad = np.radians(80.0)
SKIPPED_s = 1.0
"""Of each scan, in which the filter finds its biases."""


@dataclass(frozen=True)
class Held:
    """Stated deviations against true errors.

    Attributes
    ----------
    ratios : (kinds, quantities) stated over true, root mean squares of all machines, before they are scaled
    kinds : names of the scans
    nis : mean NIS per measurement
    usual : (windows, measurements) `ObserverNoise.usual`; empty: not known
    scans : how many were made
    """

    ratios: np.ndarray
    kinds: tuple[str, ...]
    nis: float
    usual: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    scans: int = 0

    @property
    def factors(self) -> np.ndarray:
        """Return by what deviations (quantities,) are to be multiplied, so that of no kind of scan too little is stated."""
        factors: np.ndarray = np.max(1.0 / self.ratios, axis=0)
        return factors

    def notes(self) -> list[str]:
        """Return in words what was done, and where what is stated is not within 0.7 to 1.5 of the truth."""
        scaled = self.ratios * self.factors
        by = ", ".join(f"{name} {factor:.2f}" for name, factor in zip(QUANTITIES, self.factors, strict=True))
        notes = [
            f"held to the truth of {MACHINES} machines drawn from the file, NIS {self.nis:.2f}; stated deviations are multiplied by: {by}"
        ]
        for (k, kind), (q, name) in product(enumerate(self.kinds), enumerate(QUANTITIES)):
            if scaled[k, q] > 1.5:
                notes.append(
                    f"{name} on {kind} scans is stated {scaled[k, q]:.1f} times as large as it is: it is larger on another kind of scan"
                )
        return notes


def plan_of(machine: Machine, axis: int, kind: str, random: np.random.Generator | None) -> Plan:
    """Return the plan of a scan of an axis while the others stand somewhere, or in the middle where that is asked or all that can be."""
    speed, sweeps = KINDS[kind]
    middle, limit = middle_pose(machine, 0.0), machine.limits[axis]
    half = min(LARGEST_rad, 0.5 * REACH * (limit.upper - limit.lower)) if np.isfinite(limit.upper - limit.lower) else LARGEST_rad
    at = 0.5 * (limit.lower + limit.upper) if np.isfinite(limit.lower + limit.upper) else 0.0
    others = {}
    for number, each in enumerate(machine.limits):
        if number != axis:
            room = 0.5 * AWAY * (each.upper - each.lower) if np.isfinite(each.upper - each.lower) else LARGEST_rad
            others[each.axis] = middle[each.axis] + (float(random.uniform(-1.0, 1.0)) * room if random else 0.0)
    scan = Scan(limit.axis, at - half, at + half, speed * limit.speed, others, sweeps=sweeps)
    try:
        return possible_scan(machine, scan)[0]
    except ExperimentError:
        return possible_scan(machine, replace(scan, pose={name: middle[name] for name in others}))[0]


def errors_and_variances(
    machine: Machine, scan: TrueScan, observer: ModalObserver, after: Callable[[ModalObserver], None] | None = None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return errors (N, values) of all that an observer publishes over a scan, their stated variances, and the NIS per measurement.

    `after` is given the observer after each row.
    """
    estimate, first = observe(scan.recording, observer, after=after), round(SKIPPED_s * machine.sample_rate_Hz)
    count = len(of_quantities(len(machine.axes)))
    error = estimate.values[:, :count] - published_truth(machine, scan)
    error[:, -3:] = (error[:, -3:] + np.pi) % (2.0 * np.pi) - np.pi
    nis = float(estimate["estimate_nis"][first:].sum() / estimate["estimate_measured"][first:].sum())
    return error[first:], estimate.values[first:, count : 2 * count], nis


def whitened_into(seen: list[np.ndarray]) -> Callable[[ModalObserver], None]:
    """Return what adds the whitened innovations (measurements,) of a row to a list."""
    return lambda observer: seen.append(observer.memory.whitened.copy())


def held_to_truth(
    machine: Machine, observer: ModalObserver, seed: int = 0, told: Callable[[int, int], None] = lambda done, total: None
) -> Held:
    """Compare what an observer states with what is, on machines drawn from the file.

    Parameters
    ----------
    machine : Machine
    observer : ModalObserver
        Fresh; whose deviations are not scaled.
    seed : int
    told : callable
        Told how many scans of how many are done.
    """
    groups = of_quantities(len(machine.axes))
    kinds = list(product(KINDS, range(len(machine.axes))))
    sums, nis, surprises = np.zeros((len(kinds), 2, len(QUANTITIES))), [], []
    jobs = list(product(range(MACHINES), range(len(kinds))))
    told(0, len(jobs))
    for done, (number, kind) in enumerate(jobs, start=1):
        one, (how, axis) = drawn(machine, number, MACHINES, SEED + seed), kinds[kind]
        plan = plan_of(one, axis, how, np.random.default_rng([SEED, seed, number, kind]) if number % 2 else None)
        seen: list[np.ndarray] = []
        scan = true_scan(one, plan, SEED + seed + number)
        error, variance, consistency = errors_and_variances(one, scan, observer, whitened_into(seen))
        nis.append(consistency)
        surprises.append(means(np.array(seen), machine.sample_rate_Hz))
        for q in range(len(QUANTITIES)):
            sums[kind, :, q] += np.mean(variance[:, groups == q]), np.mean(error[:, groups == q] ** 2)
        told(done, len(jobs))
    ratios, names = np.sqrt(sums[:, 0] / sums[:, 1]), tuple(f"{how} {machine.axes[axis]}" for how, axis in kinds)
    return Held(ratios, names, float(np.mean(nis)), usual_means(surprises, machine.sample_rate_Hz), len(jobs))


def scaled(noise: ObserverNoise, factors: Sequence[float] | np.ndarray) -> ObserverNoise:
    """Return the noise of an observer whose stated deviations are multiplied by factors (quantities,)."""
    return replace(noise, published=np.asarray(factors, float))
