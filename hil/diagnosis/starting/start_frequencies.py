"""Starts over frequency: lines of a base motion and lightly damped modes."""

from __future__ import annotations

import numpy as np
import scipy.ndimage

from hil.diagnosis.starting.typical import FIRST_SHARE, Start, Typical
from virtual_bus.effects.residual import Residual, harmonics

LIGHT = 0.03
"""Damping ratio of a mode that a fit starts with, and steps between the logarithms of frequencies that are looked at."""

LIGHTEST = 0.01
"""Of jointed structures. Modes twice as far apart, a half-power bandwidth, are told from each other."""

LOWEST_MODE_Hz, HIGHEST_MODE_Hz = 1.5, 30.0
"""Between which modes are looked for."""

LINES_AROUND = 41
"""Of a spectrum, whose median power is what noise has there."""


def lines(first: Start, residual: Residual, typical: Typical) -> list[Start]:
    """The two strongest lines of the missing effort."""
    frequencies = np.fft.rfftfreq(len(residual.time_s), typical.sample_s)
    window = np.hanning(len(residual.time_s))
    found: list[Start] = []
    spectrum = np.abs(np.fft.rfft((residual.effort - residual.effort.mean()) * window))
    spectrum[:2] = 0.0
    for _ in range(2):
        k = int(np.argmax(spectrum))
        f = float(frequencies[k])
        ((amplitude, phase),) = harmonics(2.0 * np.pi * f * residual.time_s, residual.effort, (1,))
        found.append({**first, "A": max(amplitude, 0.05 * typical.effort), "f": f, "phi": _wrapped(phase + 0.5 * np.pi)})
        spectrum[max(0, k - 4) : k + 5] = 0.0
    return found


def modes(first: Start, residual: Residual, typical: Typical) -> list[Start]:
    """Where the missing effort is large against the motion, and a grid over the band."""
    frequencies = np.fft.rfftfreq(len(residual.time_s), typical.sample_s)
    window = np.hanning(len(residual.time_s))
    effort = np.abs(np.fft.rfft(residual.effort * window)) ** 2
    motion = np.abs(np.fft.rfft(residual.acceleration * window)) ** 2
    kernel = np.ones(9) / 9.0
    effort, motion = np.convolve(effort, kernel, "same"), np.convolve(motion, kernel, "same")
    band = (frequencies > 2.0) & (frequencies < highest_mode_Hz(typical))
    ratio = np.where(band, effort / np.maximum(motion + 1e-3 * motion.max(), 1e-12 * effort.max() + 1e-300), 0.0)
    peak = float(frequencies[int(np.argmax(ratio))])
    inertia = FIRST_SHARE * typical.inertia
    grid = [*_resonances(residual, typical, 2), round(peak, 2), 5.0, 9.0, 15.0, 24.0]
    return [{"J": inertia, "f": f, "zeta": LIGHT} for f in dict.fromkeys(grid)]


def highest_mode_Hz(typical: Typical) -> float:
    """Up to which modes are looked for at this sample rate."""
    return min(HIGHEST_MODE_Hz, 0.3 / typical.sample_s)


def _resonances(residual: Residual, typical: Typical, count: int) -> list[float]:
    """Frequencies [Hz] at which a lightly damped mass that hangs on the joint takes most out of the missing effort.

    Beside a mass, a damper and a spring, every line weighs as much as its effort stands out of the lines around it.
    """
    frequencies = np.fft.rfftfreq(len(residual.time_s), typical.sample_s)
    highest = highest_mode_Hz(typical)
    band = (frequencies > 0.5) & (frequencies < 1.3 * highest)
    window = np.hanning(len(residual.time_s))
    moved = [residual.acceleration, residual.speed, residual.position - residual.position.mean()]
    effort, acceleration, *others = (np.fft.rfft((values - values.mean()) * window)[band] for values in (residual.effort, *moved))
    s = 2j * np.pi * frequencies[band]
    around = scipy.ndimage.median_filter(np.abs(effort) ** 2, LINES_AROUND, mode="nearest")
    weight = 1.0 / np.sqrt(np.maximum(around, 1e-300))

    def column(line: np.ndarray) -> np.ndarray:
        return np.concatenate([(weight * line).real, (weight * line).imag])

    basis, _ = np.linalg.qr(np.column_stack([column(line) for line in (acceleration, *others)]))
    wanted = column(effort)
    wanted = wanted - basis @ (basis.T @ wanted)
    tried = np.exp(np.arange(np.log(LOWEST_MODE_Hz), np.log(highest), LIGHT))
    gains = np.zeros(len(tried))
    for k, w in enumerate(2.0 * np.pi * tried):
        pull = column(-acceleration * (w * w + 2.0 * LIGHT * w * s) / (s * s + 2.0 * LIGHT * w * s + w * w))
        pull = pull - basis @ (basis.T @ pull)
        gains[k] = max(float(pull @ wanted), 0.0) ** 2 / max(float(pull @ pull), 1e-300)
    found: list[float] = []
    for k in np.argsort(-gains):
        if gains[k] > 0.0 and all(abs(np.log(tried[k] / other)) > 4.0 * LIGHT for other in found):
            found.append(round(float(tried[k]), 3))
        if len(found) == count:
            break
    return found


def _wrapped(phase: float) -> float:
    return float((phase + np.pi) % (2.0 * np.pi) - np.pi)
