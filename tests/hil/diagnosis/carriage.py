"""The EMPS carriage in its position loop, simulated here by its own recursion: it shares nothing with the project but the CSV's names.

One mass with viscous and Coulomb friction and a disturbing force of its own in every repeat. Timing: docs/explanation/notation.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.signal

from hil.machine import load_machine
from hil.recording import Channel, Recording, recording_metadata

MACHINE = load_machine("emps")
RATE_Hz = 1000.0
MASS_kg, DAMPING, GAIN = 95.1089, 203.5034, 35.15065
STEPS = 8  # of the integration per sample


def reference(duration_s: float, seed: int = 0) -> np.ndarray:
    """To and fro at several speeds, from rest at 0."""
    time_s = np.arange(round(duration_s * RATE_Hz)) / RATE_Hz
    random = np.random.default_rng(seed)
    wanted = sum(a * np.sin(2.0 * np.pi * f * time_s + random.uniform(0.0, 6.3)) for a, f in ((0.05, 0.7), (0.006, 1.6), (0.001, 3.7)))
    gate = 0.5 - 0.5 * np.cos(np.pi * np.clip(time_s / 0.5, 0.0, 1.0))
    return gate * wanted


def disturbance(rows: int, rms_N: float, seed: int, corner_Hz: float = 4.0) -> np.ndarray:
    """A slow force, another one in every repeat."""
    b, a = scipy.signal.butter(1, corner_Hz / (0.5 * RATE_Hz))
    white = np.random.default_rng(seed).standard_normal(rows + 4000)
    coloured = scipy.signal.lfilter(b, a, white)[4000:]
    return rms_N * coloured / coloured.std()


def run(
    wanted: np.ndarray,
    *,
    mass: float = MASS_kg,
    damping: float = DAMPING,
    gain: float = GAIN,
    coulomb_N: float = 0.0,
    force_N: np.ndarray | None = None,
    load_N: float = 0.0,
    at: Callable[[float], float] = lambda x: 0.0,
    noise_seed: int = 0,
    feeds_back: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """(position [m], command [V]) rows; `at` is a force [N] over position.

    With `feeds_back` the encoder's noise is in the loop, and commands are exact.
    """
    rows = len(wanted)
    force_N = np.zeros(rows) if force_N is None else force_N
    h = 1.0 / (RATE_Hz * STEPS)
    decay = np.exp(-h * damping / mass)
    x, v, command = 0.0, 0.0, 0.0
    history = [0.0, 0.0]
    position, commands = np.zeros(rows), np.zeros(rows)
    random = np.random.default_rng(1000 + noise_seed)
    noise = 1e-7 * random.standard_normal(rows)
    for k in range(rows):
        effort = command
        position[k] = x
        read = x + noise[k] if feeds_back else x
        command = 38995.821 * wanted[k] - 160720.821 * read + 121725.0 * history[0]
        command = min(max(command, -10.0), 10.0)
        commands[k] = command
        history = [history[1], read]
        push = gain * effort + force_N[k] + load_N + at(x)
        for _ in range(STEPS):  # speed exactly at constant effort, friction held implicitly
            free = v * decay + (1.0 - decay) * push / damping
            slip = (1.0 - decay) * coulomb_N / damping
            new = np.sign(free) * max(abs(free) - slip, 0.0)
            x += 0.5 * h * (v + new)
            v = new
    return position + noise, commands if feeds_back else commands + 2e-3 * random.standard_normal(rows)


def recording(wanted: np.ndarray, position: np.ndarray, command: np.ndarray) -> Recording:
    """As the bench would have recorded it."""
    rows = len(wanted)
    channels = {
        "time": Channel("s", np.arange(rows) / RATE_Hz),
        "reference_carriage": Channel("m", wanted),
        "excitation_carriage": Channel("V", np.zeros(rows)),
        "command_carriage": Channel("V", command),
        "position_carriage": Channel("m", position),
    }
    return Recording(channels, recording_metadata(MACHINE, experiment={"start_pose": [0.0]}))


def repeats(
    count: int = 4,
    duration_s: float = 3.0,
    seed: int = 0,
    disturbance_N: float = 1.0,
    experiment: int = 0,
    **truth: float | Callable[[float], float],
) -> dict[str, Recording]:
    """Repeats of one experiment, each with its own disturbance and noise."""
    wanted = reference(duration_s, experiment)
    found = {}
    for number in range(count):
        force = disturbance(len(wanted), disturbance_N, 100 * seed + 10 * experiment + number)
        noise_seed = 100 * seed + 10 * experiment + number
        found[f"run_{experiment}_{number}"] = recording(wanted, *run(wanted, force_N=force, noise_seed=noise_seed, **truth))
    return found
