"""Averaging over periods, realisations and experiments: what the robust and the fast best linear approximation of Sec. 3.4.1 share.

Corrections used: W is complex in (3.9); T of (3.13) is unitary only with a Hadamard matrix over sqrt(n_u); (3.20) holds for the mean over M
realisations and is multiplied by M for one.
"""

from __future__ import annotations

import numpy as np

from hil.errors import IdentificationError
from hil.identification.covariance import nonlinear_covariance, plant_covariance
from hil.identification.records import PeriodicRecords, labels
from hil.identification.result import FrequencyResponse
from hil.identification.spectra import period_spectra

UNITARY_TOLERANCE = 1e-4  # on T T^H - I and on the amplitudes' spread; excitations rounded to a file's precision pass


def average_realisations(
    records: PeriodicRecords,
    mean_z: np.ndarray,
    w: np.ndarray,
    noise_of_record: np.ndarray | None,
    noise_dof: np.ndarray,
    *,
    method: str,
    settings: dict[str, float | int | str],
    notes: tuple[str, ...],
) -> FrequencyResponse:
    """Average over realisations and map to the plant, (3.12) to (3.20): the part that the robust methods share.

    Parameters
    ----------
    mean_z : (M, E, L, n_z) steady-state spectrum of each record. w : (M, E, L, n_u) excitation.
    noise_of_record : (L, n_z, n_z) noise covariance of one record's `mean_z`, averaged over the records, or None.
    noise_dof : (L,) complex degrees of freedom behind it.
    """
    check_full_set(records)
    columns, W = as_matrices(mean_z), as_matrices(w)
    amplitude, T = amplitude_and_phase(W)
    corrected = columns @ np.conj(np.swapaxes(T, -1, -2))  # (3.14)
    averaged = corrected.mean(axis=0)  # (3.15)
    G_wz, G, U = closed_loop_and_plant(averaged, amplitude, records)
    M, E = mean_z.shape[:2]
    noise_z = noise = total_z = total = nonlinear = None
    if noise_of_record is not None:
        noise_z = noise_of_record / M  # (3.16)
        noise = plant_covariance(G, U, noise_z)
    if M > 1:
        deviation = (corrected - averaged).transpose(1, 2, 0, 3).reshape(len(G), corrected.shape[2], M * E)
        total_z = deviation @ np.conj(np.swapaxes(deviation, 1, 2)) / (E * M * (M - 1))  # (3.19)
        total = plant_covariance(G, U, total_z)
        if noise is not None:
            nonlinear = nonlinear_covariance(total, noise, M)
    else:
        notes = (*notes, "one realisation: no total covariance; the fast methods need but one")
    return FrequencyResponse(
        lines=records.lines,
        frequencies_Hz=records.frequencies_Hz,
        G=G,
        G_wz=G_wz,
        noise_covariance=noise,
        total_covariance=total,
        nonlinear_covariance=nonlinear,
        noise_covariance_z=noise_z,
        total_covariance_z=total_z,
        noise_dof=noise_dof,
        total_dof=np.full(len(G), float(E * (M - 1))),
        method=method,
        settings={"realisations": M, "experiments": E, **settings},
        notes=notes,
        **labels(records),
    )


class AveragedOutputs:
    """Closed-loop output spectra over the periods of each record, with missing periods left out.

    Attributes
    ----------
    spectra : (M, E, P, L, n_z), mean_over_periods : (M, E, L, n_z), notes : list of str
    weights : (M, E, P) 1 for a complete period, 0 for one with missing samples.
    """

    def __init__(self, spectra: np.ndarray, weights: np.ndarray, notes: list[str]) -> None:
        self.spectra = spectra
        self.weights = weights
        self.notes = notes
        if weights.all():
            self.mean_over_periods = spectra.mean(axis=2)
        else:
            self.mean_over_periods = np.einsum("mep,mepln->meln", weights, spectra) / weights.sum(axis=2)[:, :, None, None]

    def variance_of_mean(self, lines: np.ndarray) -> np.ndarray | None:
        """Return the sample covariance of the mean over periods, (3.11), (M, E, K, n_z, n_z); None if a record has only one period."""
        P = self.weights.sum(axis=2)
        if P.min() < 2:
            return None
        deviation = (self.spectra[..., lines, :] - self.mean_over_periods[:, :, None][..., lines, :]) * self.weights[..., None, None]
        deviation = np.moveaxis(deviation, 2, -1)
        sample_covariance: np.ndarray = deviation @ np.conj(np.swapaxes(deviation, -1, -2)) / (P * (P - 1))[:, :, None, None, None]
        return sample_covariance


def averaged_spectra(records: PeriodicRecords) -> tuple[AveragedOutputs, np.ndarray, np.ndarray]:
    """Return the spectra of the settled periods, the excitation's spectrum (M, E, N // 2 + 1, n_u), and the weights (M, E, P)."""
    N, settle = records.period_samples, records.settle_periods
    z = records.closed_loop_outputs[:, :, settle * N :]
    M, E, T, n_z = z.shape
    complete = ~np.isnan(z).reshape(M, E, T // N, N * n_z).any(axis=3)
    notes = []
    if not complete.all():
        if not complete.any(axis=2).all():
            m, e = np.argwhere(~complete.any(axis=2))[0]
            raise IdentificationError(f"realisation {m}, experiment {e}: every period has missing samples")
        notes.append(f"{int((~complete).sum())} of {complete.size} periods have missing samples and are left out")
        z = np.nan_to_num(z)
    spectra = period_spectra(z, N)
    w = period_spectra(records.excitation[:, :, :N], N)[:, :, 0]
    return AveragedOutputs(spectra, complete.astype(float), notes), w, complete.astype(float)


def amplitude_and_phase(W: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split W into a diagonal of amplitudes and a unitary matrix, (3.13).

    Parameters
    ----------
    W : (M, L, n_u, n_u) excitation, one column per experiment.

    Returns
    -------
    amplitude : (L, n_u), the same in every realisation. T : (M, L, n_u, n_u) unitary.

    Raises
    ------
    IdentificationError
        The experiments of a realisation are not orthogonal, or amplitudes differ between realisations.
    """
    rows = np.sqrt(np.sum(np.abs(W) ** 2, axis=3))
    amplitude = rows.mean(axis=0)
    if rows.min() <= 0.0:
        m, _, i = np.argwhere(rows <= 0.0)[0]
        raise IdentificationError(f"realisation {m}: input {i} is not excited at some of the excited lines")
    T = W / rows[..., None]
    deviation = np.abs(T @ np.conj(np.swapaxes(T, 2, 3)) - np.eye(W.shape[2])).max(axis=(1, 2, 3))
    if deviation.max() > UNITARY_TOLERANCE:
        raise IdentificationError(
            f"realisation {int(deviation.argmax())}: the experiments' excitations are not orthogonal (off by {deviation.max():.2g});"
            " use orthogonal random-phase multisines or one input per experiment"
        )
    spread = np.abs(rows / amplitude - 1.0).max()
    if spread > UNITARY_TOLERANCE:
        raise IdentificationError(
            f"excitation amplitudes differ by {spread:.2g} between realisations: they must be the same in all of them"
        )
    return amplitude, T


def plant_from_closed_loop(G_wz: np.ndarray, n_y: int) -> np.ndarray:
    """Return G = G_wy G_wu^-1, (3.17) and (4.27); in open loop (n_z = n_y) G_wz itself."""
    if G_wz.shape[1] == n_y:
        return G_wz
    return np.swapaxes(np.linalg.solve(np.swapaxes(G_wz[:, n_y:], 1, 2), np.swapaxes(G_wz[:, :n_y], 1, 2)), 1, 2)


def closed_loop_and_plant(
    averaged: np.ndarray, amplitude: np.ndarray, records: PeriodicRecords
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return G_wz (L, n_z, n_u), G (L, n_y, n_u) and, of the experiments turned by T, the plant's inputs U (L, n_u, n_u)."""
    G_wz = averaged / amplitude[:, None, :]
    G = plant_from_closed_loop(G_wz, records.n_outputs)
    n_u = records.n_inputs
    U = averaged[:, records.n_outputs :] if records.inputs is not None else amplitude[:, :, None] * np.eye(n_u)
    return G_wz, G, U


def covariance_of_noise(z: AveragedOutputs, lines: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Average (3.11) over all records: (L, n_z, n_z)."""
    P = weights.sum(axis=2)
    scale = weights / np.sqrt(P * np.maximum(P - 1, 1) * np.count_nonzero(P > 1))[:, :, None]
    deviation = (z.spectra[..., lines, :] - z.mean_over_periods[:, :, None][..., lines, :]) * scale[..., None, None]
    n_z = deviation.shape[-1]
    stacked = np.moveaxis(deviation, -2, 0).reshape(len(lines), -1, n_z)
    covariance: np.ndarray = np.swapaxes(stacked, 1, 2) @ np.conj(stacked)
    return covariance


def as_matrices(spectra: np.ndarray) -> np.ndarray:
    """Arrange (M, E, L, n) as (M, L, n, E): experiments as columns, (3.12)."""
    return np.moveaxis(spectra, 1, -1)


def inverse_gram(U: np.ndarray) -> np.ndarray:
    """Return the conjugate of (U U^H)^-1: (L, n_u, n_u)."""
    inverse = np.linalg.inv(U)
    gram: np.ndarray = np.conj(np.conj(np.swapaxes(inverse, 1, 2)) @ inverse)
    return gram


def check_full_set(records: PeriodicRecords) -> None:
    """Raise IdentificationError unless there are as many experiments as inputs."""
    if records.experiments != records.n_inputs:
        raise IdentificationError(
            f"{records.experiments} experiments for {records.n_inputs} inputs ({', '.join(records.input_names)}): averaging needs as many"
            " experiments as inputs; a fast local method takes one"
        )
