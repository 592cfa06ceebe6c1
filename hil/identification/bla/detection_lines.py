"""Even and odd distortions from the lines that were not excited: (3.21), (3.22), and the levels per output."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.identification.records import PeriodicRecords
from hil.identification.result import Distortion


def detection_lines(records: PeriodicRecords) -> np.ndarray:
    """Return the unexcited lines between the first and the last excited one, without the jog's lines."""
    band = np.arange(records.lines[0], records.lines[-1] + 1)
    return np.setdiff1d(band, np.concatenate((records.lines, np.asarray(records.unexcited_reference_lines, int))))


def interpolate(values: np.ndarray, at: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate linearly over lines, (3.22), constant beyond the ends; also return the upper neighbour's share, (len(wanted),)."""
    upper = np.clip(np.searchsorted(at, wanted), 1, max(len(at) - 1, 1))
    if len(at) == 1:
        return np.repeat(values, len(wanted), axis=0), np.zeros(len(wanted))
    lower = upper - 1
    share = np.clip((wanted - at[lower]) / (at[upper] - at[lower]), 0.0, 1.0)
    shape = (-1, *([1] * (values.ndim - 1)))
    return values[lower] * (1.0 - share).reshape(shape) + values[upper] * share.reshape(shape), share


def loop_corrected(mean_z: np.ndarray, G: np.ndarray, lines: np.ndarray, at: np.ndarray, records: PeriodicRecords) -> np.ndarray:
    """Return Y - G U on the lines `at`, (3.21), with G interpolated; Y itself in open loop.

    From (M, E, N // 2 + 1, n_z) to (M, E, K, n_y).
    """
    n_y = records.n_outputs
    Y = mean_z[:, :, at, :n_y]
    if records.inputs is None:
        return Y
    between, _ = interpolate(G, lines, at)
    corrected: np.ndarray = Y - np.einsum("kij,mekj->meki", between, mean_z[:, :, at, n_y:])
    return corrected


def distortion(
    records: PeriodicRecords,
    mean_z: np.ndarray,
    G: np.ndarray,
    variance_of_mean: Callable[[np.ndarray], np.ndarray | None],
) -> Distortion | None:
    """Return the distortion on the detection lines less the noise; None without detection lines or without a noise estimate."""
    at = detection_lines(records)
    if len(at) == 0:
        return None
    noise_z = variance_of_mean(at)
    if noise_z is None:
        return None
    n_y = records.n_outputs
    noise_z = noise_z.mean(axis=(0, 1))
    if records.inputs is None:
        noise_y = noise_z
    else:
        between, _ = interpolate(G, records.lines, at)
        Q = np.concatenate((np.broadcast_to(np.eye(n_y), (len(at), n_y, n_y)), -between), axis=2)
        noise_y = Q @ noise_z @ np.conj(np.swapaxes(Q, 1, 2))
    noise = np.real(np.diagonal(noise_y, axis1=1, axis2=2))
    square = np.mean(np.abs(loop_corrected(mean_z, G, records.lines, at, records)) ** 2, axis=(0, 1))
    return Distortion(
        lines=at,
        frequencies_Hz=at * records.sample_rate_Hz / records.period_samples,
        level=np.maximum(square - noise, 0.0),
        noise=noise,
        dof=records.realisations * records.experiments,
    )
