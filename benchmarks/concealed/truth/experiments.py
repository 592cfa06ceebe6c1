"""What the benchmark's user ran: sweeps both ways at several speeds, multisines under a jog, steps, moves over the full range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from concealed.truth.plant import Drive, Machine

KINDS = ("mixed", "sweeps", "multisine", "steps")
HELD_OUT = "other"
LITTLE = "little"
DURATION_S = 10.0
SMOOTHING_S = 0.12
"""A moving average of this length makes a reference's jerk finite, after one that keeps its acceleration in the machine's limit."""


@dataclass(frozen=True)
class Experiment:
    """A plan: kind, its own seed, and the part of the range it visits (-1 to 1)."""

    kind: str
    seed: int
    low: float = -1.0
    high: float = 1.0
    duration_s: float = DURATION_S


def plan(machine: Machine, experiment: Experiment) -> Drive:
    """References, excitations and the start pose, without disturbance."""
    rng = np.random.default_rng(experiment.seed)
    samples, n = round(experiment.duration_s * machine.rate_Hz), len(machine.axes)
    reference, excitation = np.zeros((samples, n)), np.zeros((samples, n))
    start = np.zeros(n)
    for i, axis in enumerate(machine.axes):
        if not machine.closed:
            excitation[:, i] = _force(rng, machine, axis, experiment, samples)
            continue
        reach = 0.75 * machine.reach(axis)
        low, high = reach * experiment.low, reach * experiment.high
        start[i] = float(rng.uniform(0.3, 0.7)) * (high - low) + low
        reference[:, i], excitation[:, i] = _moves(rng, machine, axis, experiment, (low, high), float(start[i]), samples)
    return Drive(reference, excitation, start)


def _moves(
    rng: np.random.Generator, machine: Machine, axis: str, experiment: Experiment, span: tuple[float, float], start: float, samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """Reference and excitation of one axis in its loop."""
    low, high = span
    top = _top_speed(machine, axis)
    excitation = np.zeros(samples)
    if experiment.kind == LITTLE:
        t = np.arange(samples) / machine.rate_Hz
        return start + 0.004 * (high - low) * np.sin(2.0 * np.pi * 0.3 * t) ** 2, excitation
    end = samples
    if experiment.kind in ("multisine", "mixed", HELD_OUT):
        share = {"multisine": 0.0, "mixed": 0.6, HELD_OUT: 0.7}[experiment.kind]
        end = round(share * samples)
        excitation[end:] = _multisine(rng, machine, samples - end) * 0.25 * machine.limits[machine.axes.index(axis)] * rng.uniform(0.5, 1.0)
    way = _way(rng, experiment.kind, low, high, start, top, end, machine.rate_Hz)
    reference = np.full(samples, way[-1] if len(way) else start)
    reference[: len(way)] = way
    if end < samples:  # jog under the multisine, so that the axis does not stick
        t = np.arange(samples - end) / machine.rate_Hz
        jog = 0.45 if experiment.kind == "multisine" else 0.12
        reference[end:] += _inward(reference[end], low, high) * jog * (high - low) * np.sin(np.pi * rng.uniform(0.2, 0.35) * t) ** 2
    return _smooth(
        _smooth(reference, machine.rate_Hz, top / _limit(machine, axis, "acceleration")), machine.rate_Hz, SMOOTHING_S
    ), excitation


def _inward(at: float, low: float, high: float) -> float:
    return 1.0 if at < 0.5 * (low + high) else -1.0


def _way(
    rng: np.random.Generator, kind: str, low: float, high: float, start: float, top: float, samples: int, rate_Hz: float
) -> np.ndarray:
    """Moves between turning points at constant speeds, short rests between them."""
    at, pieces, total = start, [np.full(round(0.3 * rate_Hz), start)], round(0.3 * rate_Hz)
    speeds = {"sweeps": (0.12, 0.3, 0.7), "steps": (0.9, 0.9, 0.9), "mixed": (0.6, 0.15, 0.9), HELD_OUT: (0.5, 0.2, 0.8)}.get(
        kind, (0.3, 0.3, 0.3)
    )
    number = 0
    while total < samples and kind != "multisine":
        speed = speeds[(number // 2) % 3] * top * rng.uniform(0.85, 1.15)
        short = (kind == "steps" and number > 1) or speed < 0.25 * top
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        far = middle + half * (rng.uniform(0.1, 0.5) if short else rng.uniform(0.8, 1.0)) * (1.0 if number % 2 else -1.0)
        if speed < 0.25 * top:
            far = at + np.sign(far - at) * min(abs(far - at), speed * 1.2)
        steps = max(2, round(abs(far - at) / speed * rate_Hz))
        rest = round(rng.uniform(0.1, 0.35) * rate_Hz)
        pieces += [np.linspace(at, far, steps), np.full(rest, far)]
        total += steps + rest
        at, number = far, number + 1
    return np.concatenate(pieces)[:samples]


def _top_speed(machine: Machine, axis: str) -> float:
    return 0.8 * _limit(machine, axis, "speed")


def _limit(machine: Machine, axis: str, quantity: str) -> float:
    """The machine file's limit of an axis [rad or m, s]."""
    value = next(float(value) for key, value in machine.table["limits"][axis].items() if key.startswith(quantity))
    return value * (1.0 if machine.length[machine.axes.index(axis)] else np.pi / 180.0)


def _smooth(reference: np.ndarray, rate_Hz: float, window_s: float) -> np.ndarray:
    width = max(1, round(window_s * rate_Hz))
    padded = np.concatenate([np.full(width - 1, reference[0]), reference])
    return np.convolve(padded, np.ones(width) / width, mode="valid")


def _multisine(rng: np.random.Generator, machine: Machine, samples: int) -> np.ndarray:
    """Random phases, lines from 0.5 to 25 Hz, falling in amplitude above 5 Hz; peak 1."""
    frequency = np.arange(0.5, 25.0, 0.5) + 0.25 * float(rng.integers(0, 2))
    t = np.arange(samples) / machine.rate_Hz
    amplitude = 1.0 / np.maximum(1.0, frequency / 5.0)
    phases = rng.uniform(-np.pi, np.pi, len(frequency))
    signal = (amplitude[:, None] * np.sin(2.0 * np.pi * frequency[:, None] * t + phases[:, None])).sum(0)
    fade = np.minimum(1.0, np.arange(samples) / (0.2 * machine.rate_Hz))
    return np.asarray(fade * signal / np.abs(signal).max())


def _force(rng: np.random.Generator, machine: Machine, axis: str, experiment: Experiment, samples: int) -> np.ndarray:
    """Open loop: a chirp up and down, a multisine, steps of force, at a seldom repeated level."""
    t = np.arange(samples) / machine.rate_Hz
    limit = machine.limits[machine.axes.index(axis)]
    if experiment.kind == LITTLE:
        return 0.01 * limit * np.sin(2.0 * np.pi * 0.4 * t)
    level = 0.35 * limit * rng.uniform(0.8, 1.2) * max(abs(experiment.low), abs(experiment.high))
    multisine = level * _multisine(rng, machine, samples)
    turns = np.sign(np.sin(2.0 * np.pi * rng.uniform(0.15, 0.3) * t + rng.uniform(0.0, 3.0)))
    steps = _smooth(0.6 * level * turns * np.minimum(1.0, t / 0.5), machine.rate_Hz, SMOOTHING_S)
    sweep = 0.5 * level * np.sin(2.0 * np.pi * (0.3 * t + 0.5 * 8.0 / experiment.duration_s * t * t)) * np.minimum(1.0, t / 0.5)
    weights = {"mixed": (0.6, 0.6, 0.3), "sweeps": (0.1, 0.2, 1.0), "multisine": (1.0, 0.0, 0.0), "steps": (0.2, 1.0, 0.0)}
    weight = weights.get(experiment.kind, (0.5, 0.4, 0.4))
    return np.asarray(weight[0] * multisine + weight[1] * steps + weight[2] * sweep)
