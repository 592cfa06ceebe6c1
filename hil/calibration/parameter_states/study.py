"""How fast and how surely parameters as states converge: the filter on drawn runs of a known machine (thesis Sec. 5.5)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from controllers.models.flexible_chain import FlexibleChain
from hil.calibration.kinematic.flexible import fit_flexible
from hil.calibration.parameter_states.drawn_runs import POSE_STD, Conditions, Truth, drawn_run, steady
from hil.calibration.parameter_states.filter_model import Randomness, Run, SwingingMachine, pose_gap, tolerances
from hil.calibration.parameter_states.over_recording import Estimated, estimate
from hil.errors import BadAnswerError
from hil.imaging.geometry import ConeBeam
from hil.processes.workers import end_with_the_parent

ENCODER_rad, PUSH_rad_s2, PUSH_s, JERK = 2e-5, 0.05, 0.1, 1.0
IMU = np.repeat([5e-3, 5e-4], 3)
BIAS, BIAS_WALK = np.repeat([3e-3, 2e-4], 3), np.repeat([1e-5, 1e-6], 3)
"""Noise of the shipped C-arm's sensors; biases as its data sheet class has them."""

HELD_OUT = 200
"""Poses that no image showed, to judge by."""

DRIFT_WALK = 0.01
"""Of the logarithms of frequency, damping and mass per √s where they are told to drift."""


@dataclass(frozen=True)
class Draw:
    """One drawn run and what the filter made of it.

    Attributes
    ----------
    true : SwingingMachine
    run : Run
    truth : Truth
    found : Estimated
    """

    true: SwingingMachine
    run: Run
    truth: Truth
    found: Estimated

    @property
    def target(self) -> np.ndarray:
        """True values (names,) at the end, as `Estimated.values` has them."""
        start, fallen = self.found.final.machine, self.truth.frequency_ratio(float(self.run.time_s[-1]))
        gain = np.linalg.norm(start.gain, axis=1) / np.linalg.norm(self.true.gain, axis=1)
        logs = np.log(np.concatenate([fallen * self.true.frequency_Hz / start.frequency_Hz, self.true.damping / start.damping, gain]))
        return np.concatenate([self.true.chain.values, logs])

    def nees(self) -> tuple[float, float]:
        """Return the normalised estimation errors squared of the chain's and the dynamic parameters, over their number."""
        work = self.found.final
        p = len(self.true.chain.names)
        free = np.flatnonzero(np.diag(work.covariance)[work.fixed] > 0.0)
        return (
            _normalised(work.x[work.fixed][free] - self.target[:p][free], work.covariance[work.fixed, work.fixed][np.ix_(free, free)]),
            _normalised(work.x[work.dynamic] - self.target[p:], work.covariance[work.dynamic, work.dynamic]),
        )

    @cached_property
    def gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the true poses less the estimated ones along the run (K, 9), and their normalised squares over nine (K,)."""
        source, phantom, rotation = (np.concatenate(each) for each in zip(*self.found.poses, strict=True))
        rows = pose_gap(*self.truth.poses(np.array(self.found.at_s)), (source, phantom, rotation))
        return rows, np.array([_normalised(*each) for each in zip(rows, self.found.covariances, strict=True)])


def _normalised(error: np.ndarray, covariance: np.ndarray) -> float:
    std = np.sqrt(np.diag(covariance))
    return float((error / std) @ np.linalg.solve(covariance / np.outer(std, std), error / std) / len(error))


def randomness(machine: SwingingMachine, drifts: bool = False) -> Randomness:
    """Return what is random about a machine that is built within its drawing's tolerance."""
    n, m = machine.axes, machine.modes
    return Randomness(
        encoder=np.full(n, ENCODER_rad),
        imu=IMU,
        jerk=np.full(n, JERK),
        push=np.full(m, PUSH_rad_s2),
        push_s=PUSH_s,
        bias=BIAS,
        bias_walk=BIAS_WALK,
        parameters=tolerances(machine.chain),
        parameter_walk=np.zeros(len(machine.chain.names)),
        dynamic_walk=np.array([DRIFT_WALK, 0.0, 0.0]) if drifts else np.zeros(3),
    )


def drawn_machine(start: SwingingMachine, random: Randomness, seed: int, scale: float = 1.0, dynamic_scale: float = 1.0) -> SwingingMachine:
    """Return a machine whose parameters are off the start by `scale` times their deviations, the dynamic ones by `dynamic_scale`."""
    rng = np.random.default_rng([seed, 1])
    values = start.chain.values + scale * rng.normal(0.0, random.parameters)
    bends = len(values) - len(start.chain.elastic)
    values[bends:] = np.maximum(values[bends:], 0.1 * start.chain.values[bends:])  # a compliance is positive
    frequency, damping, mass = np.exp(dynamic_scale * rng.normal(0.0, np.repeat(random.dynamic, start.modes))).reshape(3, -1)
    return replace(
        start,
        chain=start.chain.with_values(values),
        frequency_Hz=start.frequency_Hz * frequency,
        damping=np.minimum(start.damping * damping, 0.3),
        gain=start.gain / mass[:, None],
    )


def draw(
    start: SwingingMachine,
    true: SwingingMachine,
    seed: int,
    conditions: Conditions,
    withdrawn: int | None = None,
    drift: Callable[[float], float] | None = None,
) -> Draw:
    """Draw one run of the machine `true` and filter it from `start`."""
    random = randomness(start, drift is not None)
    run, truth = drawn_run(true, random, conditions, seed, drift or steady)
    return Draw(true, run, truth, estimate(start, random, run, withdrawn))


def draw_of(
    start: SwingingMachine,
    base: SwingingMachine | None,
    seed: int,
    conditions: Conditions,
    withdrawn: int | None = None,
    drift: Callable[[float], float] | None = None,
) -> Draw:
    """Return `draw` of the machine `base`, else of one drawn with the run's seed."""
    return draw(start, base or drawn_machine(start, randomness(start), seed), seed, conditions, withdrawn, drift)


def side_by_side(of_seed: Callable[[int], Draw], seeds: range, jobs: int | None = None) -> Iterator[Draw]:
    """Yield what becomes of each seed, in their order.

    Parameters
    ----------
    of_seed : callable
        A function of a module with its arguments (`functools.partial`): processes are sent it.
    seeds : range
    jobs : int, optional
        Processes, else as many as there are processors. A run is the same in any of them.
    """
    jobs = min(jobs or os.cpu_count() or 1, len(seeds))
    if jobs > 1:
        with ProcessPoolExecutor(jobs, initializer=end_with_the_parent) as pool:
            yield from pool.map(of_seed, seeds)
    else:
        yield from map(of_seed, seeds)


def held_out(true: FlexibleChain, found: FlexibleChain, reach_rad: np.ndarray | float = 1.0) -> tuple[float, float]:
    """Return the rms distance [m] and angle [rad] of phantom poses between two chains, over poses within the reach."""
    positions = _unseen(true, reach_rad)
    return _apart(true.poses(positions), found.poses(positions))


def _unseen(chain: FlexibleChain, reach_rad: np.ndarray | float) -> np.ndarray:
    positions: np.ndarray = np.random.default_rng(9000).uniform(-1.0, 1.0, (HELD_OUT, len(chain.driven))) * reach_rad
    return positions


def _apart(true: tuple[np.ndarray, np.ndarray, np.ndarray], found: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[float, float]:
    gap = pose_gap(*true, found)
    return float(np.sqrt(np.mean(np.sum(gap[:, 3:6] ** 2, axis=1)))), float(np.sqrt(np.mean(np.sum(gap[:, 6:] ** 2, axis=1))))


def by_model(start: SwingingMachine, run: Run) -> FlexibleChain | None:
    """Return the model-based calibration from a run's images: the chain fitted to all of them at once; None where it does not converge."""
    at = np.array([image.time_s for image in run.images])
    positions = np.column_stack([np.interp(at, run.time_s, column) for column in run.encoder.T])
    source, phantom, rotation = (np.array([getattr(image, name) for image in run.images]) for name in ("source", "phantom", "rotation"))
    covariance = np.array([image.covariance for image in run.images])
    try:
        return fit_flexible(start.chain, positions, ConeBeam(source, phantom, np.swapaxes(rotation, 1, 2)), covariance).model
    except BadAnswerError:
        return None


CONDITIONS: dict[str, dict[str, object]] = {
    "as stated": {},
    "chain twice as far from the drawing": {"scale": 2.0},
    "chain three times as far": {"scale": 3.0},
    "modes twice as far": {"dynamic_scale": 2.0},
    "all noise twice what is stated": {"noise": 2.0},
    "one image in ten wrong": {"wrong_images": 0.1},
    "images 1 s late": {"late_s": 1.0},
    "an image every 2 s": {"images_Hz": 0.5},
    "modes hardly excited": {"effort": 0.2},
    "no inertial sensor": {"is_blind": True},
    "frequencies fall by 5 %, not told": {"drift": 0.05},
    "frequencies fall by 5 %, told": {"drift": 0.05, "is_told": True},
    "only two axes move": {"reach": (1, 2)},
    "only one axis moves": {"reach": (1,)},
}
"""Ways in which a run is unlike what the filter believes, or tells less."""


def under(start: SwingingMachine, base: SwingingMachine | None, seed: int, conditions: Conditions, changes: dict[str, object]) -> Draw:
    """Draw one run under an entry of `CONDITIONS`; `base` is the true machine, else one is drawn."""
    work = dict(changes)
    scale, drift = float(str(work.pop("scale", 1.0))), float(str(work.pop("drift", 0.0)))
    modes = float(str(work.pop("dynamic_scale", 1.0)))
    is_told, is_blind = bool(work.pop("is_told", False)), bool(work.pop("is_blind", False))
    moving = work.pop("reach", None)
    if isinstance(moving, tuple):
        reach = np.zeros(start.axes)
        reach[[axis for axis in moving if axis < start.axes]] = np.max(conditions.reach_rad)
        work["reach_rad"] = reach
    conditions = replace(conditions, **work)  # type: ignore[arg-type]
    random = randomness(start, is_told)
    true = drawn_machine(start, random, seed, scale, modes) if base is None else _farther(start, base, scale, modes)
    run, truth = drawn_run(true, random, conditions, seed, falling(drift, conditions.seconds))
    if is_blind:
        run = replace(run, imu=np.full_like(run.imu, np.nan))
    return Draw(true, run, truth, estimate(start, random, run))


def falling(share: float, seconds: float) -> Callable[[float], float]:
    """Return a ratio that falls from 1 by a share over a time, evenly."""
    return partial(_fallen, share, seconds)


def _fallen(share: float, seconds: float, at: float) -> float:
    return 1.0 - share * at / seconds


def _farther(start: SwingingMachine, true: SwingingMachine, scale: float, modes: float) -> SwingingMachine:
    values = start.chain.values + scale * (true.chain.values - start.chain.values)
    values[-len(start.chain.elastic) :] = true.chain.values[-len(start.chain.elastic) :]
    return replace(
        true,
        chain=start.chain.with_values(values),
        frequency_Hz=start.frequency_Hz * (true.frequency_Hz / start.frequency_Hz) ** modes,
        damping=start.damping * (true.damping / start.damping) ** modes,
    )


def curve(draws: list[Draw], reach_rad: np.ndarray | float) -> np.ndarray:
    """Return the held-out distance [m] and angle [rad] after every image (draws, images + 1, 2); images refused leave it as it was."""
    count = min(len(each.found.values) for each in draws)
    result = np.zeros((len(draws), count, 2))
    for number, each in enumerate(draws):
        chain, p = each.true.chain, len(each.true.chain.names)
        positions = _unseen(chain, reach_rad)
        true = chain.poses(positions)
        for k in range(count):
            result[number, k] = _apart(true, chain.with_values(each.found.values[k][:p]).poses(positions))
    return result


def converged(held: np.ndarray, conditions: Conditions) -> int | None:
    """Return after how many images a curve (images + 1, 2) stays below what a single image is unsure by; None: never."""
    std = POSE_STD if conditions.pose_std is None else conditions.pose_std
    bounds = np.array([np.linalg.norm(std[3:6]), np.linalg.norm(std[6:])])
    above = np.flatnonzero((held > bounds).any(axis=1))
    first = int(above[-1]) + 1 if len(above) else 0
    return first if first < len(held) else None
