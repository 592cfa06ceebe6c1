"""The rail's block as Euler steps of a mass on a damper in its loop: from docs/explanation/notation.md, sharing nothing with the plant."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import sosfilt

from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata

RAIL = load_machine(Path(__file__).with_name("rail.toml"))
MASS_kg, DAMPING_N_s_m, GAIN_N_V = 20.0, 60.0, 25.0
STEPS = 20
NOISE = np.array([0.02, 5e-6])  # V and m rms, white


def pushed_mass(
    reference: np.ndarray,
    push: Callable[[float, float, float], float],
    excitation: np.ndarray | None = None,
    *,
    count: float = 0.0,
    target_step: float = 0.0,
    zero: float = 0.0,
    begins: tuple[float, float] = (0.0, 0.0),
    gain: float = 1.0,
    early: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Position and command (N,) along a reference (N,), pushed by `push(time, position, speed)` [N] besides its drive and damper.

    The encoder reads multiples of `count` and is `zero` off, the drive applies multiples of `target_step`. It begins so far off the
    reference and so fast. `gain` is that of the controller, in units of the file's. Commands act so much of a row `early`.
    """
    period_s = 1.0 / RAIL.sample_rate_Hz
    sections = RAIL.controllers[0].position_sections
    state = np.zeros((len(sections), 2))
    position, speed, command = float(reference[0]) + begins[0], begins[1], 0.0
    rows = np.zeros((len(reference), 2))
    for k in range(len(reference)):
        effort = rounded(command, target_step)
        reading = rounded(position, count) + zero
        fed_back, state = sosfilt(sections, [reference[k] - reading], zi=state)
        command = gain * float(fed_back[0]) + (0.0 if excitation is None else float(excitation[k]))
        rows[k] = reading, command
        for step in range(STEPS):
            if step == round((1.0 - early) * STEPS):
                effort = rounded(command, target_step)
            force = GAIN_N_V * effort - DAMPING_N_s_m * speed + push(k * period_s, position, speed)
            speed += force / MASS_kg * period_s / STEPS
            position += speed * period_s / STEPS
    return rows[:, 0], rows[:, 1]


def rounded(value: float, step: float) -> float:
    return step * np.floor(value / step + 0.5) if step else value


def recorded(
    reference: np.ndarray,
    push: Callable[[float, float, float], float],
    seed: int,
    *,
    excitation: np.ndarray | None = None,
    experiment: dict[str, Any] | None = None,
    noise: float = 1.0,
    gain: float = 1.0,
    early: float = 0.0,
) -> Recording:
    """A recording of it, with so many times NOISE."""
    position, command = pushed_mass(reference, push, excitation, gain=gain, early=early)
    rows = np.random.default_rng(seed).standard_normal((len(reference), 2)) * NOISE * noise
    channels = {
        "time": Channel("s", np.arange(len(reference)) / RAIL.sample_rate_Hz),
        "reference_carriage": Channel("m", reference),
        "excitation_carriage": Channel("V", np.zeros(len(reference)) if excitation is None else excitation),
        "command_carriage": Channel("V", command + rows[:, 0]),
        "position_carriage": Channel("m", position + rows[:, 1]),
    }
    return Recording(channels, recording_metadata(RAIL, experiment=experiment or {"start_pose": [float(reference[0])]}))
