"""Transients of periodic records, estimated from the bins between the lines and removed: (3.24) to (3.36), (4.7) to (4.13).

The thesis's (3.30) has K = [1, r, ..., -r Z, ...]: in print the Z of the last entries lacks its r. (3.35) is right; (4.29) is right with
Sigma inverted. The window is strictly larger than the number of unknowns, which (3.29) does not ensure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.errors import IdentificationError
from hil.identification.bla.detection_lines import distortion
from hil.identification.local.local_model import LocalModel, powers, transient_offsets
from hil.identification.local.regression import fits_with_true_residuals
from hil.identification.records import PeriodicRecords
from hil.identification.result import Distortion
from hil.identification.spectra import record_spectra


@dataclass(frozen=True)
class SteadyState:
    """Spectra of the records with their transients removed.

    Attributes
    ----------
    z : (M, E, K, n_z) compensated outputs at `lines`, (3.36).
    noise : (M, E, K, n_z, n_z) noise covariance of each, (3.34).
    dof : (K,) complex degrees of freedom of each `noise`.
    lines : (K,)
    periods : P, used of each record.
    notes : what was left out.
    """

    z: np.ndarray
    noise: np.ndarray
    dof: np.ndarray
    lines: np.ndarray
    periods: int
    notes: tuple[str, ...]


def steady_state(records: PeriodicRecords, model: LocalModel, lines: np.ndarray) -> SteadyState:
    """Estimate and remove the transient at `lines` (K,), multiples of f_s / N.

    Raises
    ------
    IdentificationError
        One period; no degree of freedom left.
    """
    signals, periods, notes = complete_periods(records, model.skip_periods)
    n_z = sum(signal.shape[3] for signal in signals)
    offsets = transient_offsets(model, periods, records.n_outputs, n_z)
    beyond = int(offsets[-1])
    if beyond >= signals[0].shape[2] // 2:
        raise IdentificationError(f"a transient window of {len(offsets)} bins is wider than the spectrum of {signals[0].shape[2]} samples")
    spectra = np.concatenate([record_spectra(signal, beyond) for signal in signals], axis=3)
    M, E, bins, _ = spectra.shape
    centres = lines * periods + beyond
    rows = (np.arange(M * E)[:, None, None] * bins + (centres[:, None] + offsets)).reshape(-1, len(offsets))
    r = offsets / np.abs(offsets).max()
    fits = fits_with_true_residuals(
        rows,
        powers(r, model.transient)[None],
        powers(r, model.denominator)[None],
        np.ones((M * E * bins, 1), complex),
        spectra.reshape(M * E * bins, n_z),
        n_y=records.n_outputs,
    )
    leverage = 1.0 + np.real(fits.inverse_gram[:, 0, 0])
    noise = fits.residual_products * (leverage / fits.dof)[:, None, None]
    return SteadyState(
        z=spectra[:, :, centres] - fits.response[:, :, 0].reshape(M, E, len(lines), n_z),
        noise=noise.reshape(M, E, len(lines), n_z, n_z),
        dof=fits.dof.reshape(M * E, len(lines)).min(axis=0).astype(float),
        lines=lines,
        periods=periods,
        notes=notes,
    )


def even_odd(records: PeriodicRecords, steady: SteadyState, G: np.ndarray) -> Distortion | None:
    """Return the distortion on the detection lines, which follow the excited ones in `steady`."""
    spectrum = np.zeros((*steady.z.shape[:2], records.period_samples // 2 + 1, steady.z.shape[3]), complex)
    spectrum[:, :, steady.lines] = steady.z
    return distortion(records, spectrum, G, lambda at: steady.noise[:, :, len(records.lines) :] if len(at) else None)


def complete_periods(records: PeriodicRecords, skip: int) -> tuple[tuple[np.ndarray, ...], int, tuple[str, ...]]:
    """Return outputs, and inputs in closed loop, over the longest run of complete periods of each record, cut to equal length.

    Returns
    -------
    signals : one or two of (M, E, P N, n). periods : P. notes : what was left out.
    """
    N = records.period_samples
    if records.unexcited_reference_lines:
        skip = max(skip, records.settle_periods)  # the jog is faded in over them: a motion that is neither periodic nor a transient
    measured = (records.outputs,) if records.inputs is None else (records.outputs, records.inputs)
    signals = tuple(signal[:, :, skip * N :] for signal in measured)
    M, E, T = signals[0].shape[:3]
    if T < N:
        raise IdentificationError(f"skip_periods = {skip} of {records.periods} periods leaves none")
    if not any(np.isnan(signal).any() for signal in signals):
        return signals, T // N, ()
    complete = np.all([~np.isnan(signal).reshape(M, E, T // N, -1).any(axis=3) for signal in signals], axis=0)
    runs = {(m, e): _longest_run(complete[m, e]) for m in range(M) for e in range(E)}
    periods = min(length for _, length in runs.values())
    if periods == 0:
        raise IdentificationError("a record has no complete period")
    kept = tuple(np.stack([[signal[m, e, runs[m, e][0] * N :][: periods * N] for e in range(E)] for m in range(M)]) for signal in signals)
    return kept, periods, (f"missing samples: {periods} complete periods in a row are used of {T // N}",)


def _longest_run(complete: np.ndarray) -> tuple[int, int]:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], complete.astype(np.int8), [0]))))
    if len(edges) == 0:
        return 0, 0
    starts, lengths = edges[::2], edges[1::2] - edges[::2]
    longest = int(lengths.argmax())
    return int(starts[longest]), int(lengths[longest])
