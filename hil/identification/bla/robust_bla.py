"""Robust best linear approximation: averaged over realisations, which tell nonlinear distortion from noise (thesis Sec. 3.4.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.identification.bla.averaging import (
    average_realisations,
    averaged_spectra,
    covariance_of_noise,
)
from hil.identification.bla.detection_lines import distortion
from hil.identification.records import PeriodicRecords
from hil.identification.result import FrequencyResponse


def robust_bla(records: PeriodicRecords) -> FrequencyResponse:
    """Estimate the robust best linear approximation, (3.10) to (3.20).

    M >= 2 realisations separate the stochastic nonlinear distortion from noise.

    Parameters
    ----------
    records : M realisations of n_u experiments with random-phase orthogonal multisines, or of single-input experiments.

    Returns
    -------
    FrequencyResponse
        With P = 1 there is no noise covariance, with M = 1 no total covariance; both are None then and `notes` says so.

    Raises
    ------
    IdentificationError
        Experiments that do not make up a full set, an excitation that is not orthogonal, a record without one complete period.
    """
    z, w, weights = averaged_spectra(records)
    noise_dof = float(np.sum(weights.sum(axis=2) - 1))
    response = average_realisations(
        records,
        z.mean_over_periods[..., records.lines, :],
        w[:, :, records.lines],
        covariance_of_noise(z, records.lines, weights) if noise_dof > 0 else None,
        np.full(len(records.lines), noise_dof),
        method="robust_bla",
        settings={"periods": int(weights.sum(axis=2).min())},
        notes=(*records.notes, *z.notes, *(() if noise_dof > 0 else ("one period: no noise covariance",))),
    )
    return replace(response, even_odd=distortion(records, z.mean_over_periods, response.G, z.variance_of_mean))
