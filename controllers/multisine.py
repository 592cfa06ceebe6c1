"""Random-phase multisines for one or several inputs, and their crest factors.

Thesis Sec. 3.3: (3.8), which sums to below N/2 (errata), and (3.9) W(k) = D_W(k) T D_phi(k), which is complex (errata).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from controllers.errors import DesignError
from controllers.hadamard_experiments import Mixing, mixing_matrix

Phases = Literal["random", "optimised"]

DRAWS = 24
"""Independent draws of random phases, of which the one with the lowest crest factor is taken; each doubling gains less than 1 %."""

SWAPS = 200
"""Rounds of the swapping algorithm; the crest factor has settled to about 1 % by then."""

CLIP_START, CLIP_END = 0.75, 0.97
"""Share of its peak to which a signal is clipped, from first round to last: deep clipping searches widely, light clipping refines."""


@dataclass(frozen=True)
class Multisine:
    """The experiments of one realisation, one period each.

    Attributes
    ----------
    signals : (n_experiments, n_inputs, N) array
        w(t) in the unit of the amplitudes.
    lines : (n_lines,) int array
    spectrum : (n_lines, n_inputs, n_experiments) complex array
        W(k) of (3.9): w(t) = sum_k |W| sin(2 pi k t / N + angle W).
    """

    signals: np.ndarray
    lines: np.ndarray
    spectrum: np.ndarray

    @property
    def crest_factor(self) -> np.ndarray:
        """Peak over rms, (n_experiments, n_inputs); 0 where an input rests."""
        return crest_factor(self.signals)


def crest_factor(signals: np.ndarray) -> np.ndarray:
    """Return peak over rms along the last axis; 0 for a signal that is zero."""
    peak, rms = np.abs(signals).max(axis=-1), np.sqrt(np.mean(signals**2, axis=-1))
    factor: np.ndarray = np.divide(peak, rms, out=np.zeros_like(peak), where=rms > 0.0)
    return factor


def multisine(
    lines: np.ndarray,
    rms: np.ndarray,
    period_samples: int,
    *,
    mixing: Mixing = "orthogonal",
    weights: np.ndarray | None = None,
    seed: int = 0,
    realisation: int = 0,
    phases: Phases = "random",
) -> Multisine:
    """Make one realisation of a full random orthogonal multisine, or of single-input ones.

    Parameters
    ----------
    lines : (n_lines,) int array
        Harmonics of the base period, 1 to below N/2.
    rms : (n_inputs,) array
        Rms of each input's signal while it is excited, in command units; the same in every experiment and realisation.
    period_samples : int
        N.
    mixing : "orthogonal" or "single"
        All inputs in every experiment, mixed by an orthogonal matrix; or one input per experiment.
    weights : (n_lines,) array, optional
        Relative amplitude per line; flat when left out.
    seed, realisation : int
        Draw the phases; realisations of one seed are independent.
    phases : "random" or "optimised"
        "random": uniform and independent, the best of DRAWS draws, as the robust method's averaging over realisations asks for.
        "optimised": swapped between time and frequency domain for a low crest factor; lines' phases are then no longer independent of
        each other, so take it for single realisations (the fast method).

    Raises
    ------
    DesignError
        Lines out of range, or weights or rms that are not positive.

    Examples
    --------
    Each input has the rms that it was given, in each of the two experiments.

    >>> import numpy as np
    >>> from controllers.multisine import multisine
    >>> made = multisine(np.arange(1, 40, 2), np.array([0.5, 2.0]), 1024)
    >>> np.sqrt(np.mean(made.signals**2, axis=-1)).round(6).tolist()
    [[0.5, 2.0], [0.5, 2.0]]
    """
    lines = np.asarray(lines, dtype=np.int64)
    rms = np.asarray(rms, dtype=float)
    shape = np.ones(len(lines)) if weights is None else np.asarray(weights, dtype=float)
    if shape.shape != lines.shape or not (np.isfinite(shape) & (shape > 0.0)).all():
        raise DesignError(f"weights: {len(lines)} positive numbers are needed, one per line, got {shape.shape}")
    if not (np.isfinite(rms) & (rms > 0.0)).all():
        raise DesignError(f"amplitude {rms.tolist()}: must be positive")
    if lines.size == 0 or lines.min() < 1 or 2 * lines.max() >= period_samples:
        raise DesignError(f"lines must lie within 1 to {(period_samples + 1) // 2 - 1} for a period of {period_samples} samples")
    mix = mixing_matrix(len(rms), mixing)
    amplitudes = np.sqrt(2.0) * shape / np.linalg.norm(shape)  # rms 1: Parseval
    # every entry of T that is not zero has the same modulus; D_W makes up for it so that `rms` is what the input gets
    scale = rms[:, None] / np.abs(mix).max()
    best = None
    for draw in range(DRAWS if phases == "random" else 1):
        random = np.random.default_rng([seed, realisation, draw])
        input_phases = random.uniform(0.0, 2.0 * np.pi, (len(lines), len(rms)))
        experiment_phases = random.uniform(0.0, 2.0 * np.pi, (len(lines), len(rms)))
        spectrum = amplitudes[:, None, None] * scale * _with_phases(mix, input_phases, experiment_phases)
        found = Multisine(_signals(spectrum, lines, period_samples), lines, spectrum)
        if best is None or found.crest_factor.max() < best.crest_factor.max():
            best = found
    assert best is not None
    return best if phases == "random" else _swapped(best, mix)


def _with_phases(mix: np.ndarray, input_phases: np.ndarray, experiment_phases: np.ndarray) -> np.ndarray:
    """Return D_W T D_phi with unit amplitudes, (n_lines, n_inputs, n_experiments)."""
    phased: np.ndarray = np.exp(1j * input_phases)[:, :, None] * mix * np.exp(1j * experiment_phases)[:, None, :]
    return phased


def _signals(spectrum: np.ndarray, lines: np.ndarray, period_samples: int) -> np.ndarray:
    """Return the signals (n_experiments, n_inputs, N) of W(k)."""
    inputs = spectrum.shape[1]
    transform = np.zeros((inputs, inputs, period_samples // 2 + 1), dtype=complex)
    transform[:, :, lines] = spectrum.transpose(2, 1, 0) * (-0.5j * period_samples)  # sines, (3.8)
    return np.fft.irfft(transform, period_samples)


def _swapped(start: Multisine, mix: np.ndarray) -> Multisine:
    """Lower the largest crest factor of all experiments and inputs at fixed amplitudes.

    Van der Ouderaa, Schoukens, Renneboog 1988, "Peak factor minimization using a time-frequency domain swapping algorithm": clip in time,
    restore the amplitudes in frequency, repeat. For several inputs the phases are put back into the form angle(D_W T D_phi) each round, by
    one round of alternating projections on D_W and D_phi; so every W(k) stays orthogonal.
    """
    amplitudes = np.abs(start.spectrum)
    period_samples = start.signals.shape[-1]
    experiment_unit = np.ones(start.spectrum.shape[::2], dtype=complex)
    signals, best = start.signals, start
    for level in np.linspace(CLIP_START, CLIP_END, SWAPS):
        peak = np.abs(signals).max(axis=-1, keepdims=True) * level
        clipped = np.fft.rfft(np.clip(signals, -peak, peak))[:, :, start.lines].transpose(2, 1, 0) * 1j
        ratio = clipped * mix.conj()  # (n_lines, n_inputs, n_experiments), to be a rank-one product of unit numbers
        input_unit = _unit((ratio * experiment_unit.conj()[:, None, :]).sum(axis=2))
        experiment_unit = _unit((ratio * input_unit.conj()[:, :, None]).sum(axis=1))
        phase = input_unit[:, :, None] * mix * experiment_unit[:, None, :]
        spectrum = amplitudes * _unit(phase)
        signals = _signals(spectrum, start.lines, period_samples)
        found = Multisine(signals, start.lines, spectrum)
        if found.crest_factor.max() < best.crest_factor.max():
            best = found
    return best


def _unit(values: np.ndarray) -> np.ndarray:
    size = np.abs(values)
    unit: np.ndarray = np.divide(values, size, out=np.zeros_like(values), where=size > 0.0)
    return unit
