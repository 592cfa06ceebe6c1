"""Robust local polynomial and rational method, Sec. 3.4.2: transients estimated and removed, then averaged over realisations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.identification.bla.averaging import average_realisations
from hil.identification.bla.detection_lines import detection_lines
from hil.identification.bla.transient import even_odd, steady_state
from hil.identification.local.local_model import LocalModel
from hil.identification.records import PeriodicRecords
from hil.identification.result import FrequencyResponse
from hil.identification.spectra import period_spectra


def robust_local(records: PeriodicRecords, model: LocalModel | None = None) -> FrequencyResponse:
    """Estimate the response with the robust LRM (LPM where `model.denominator` is 0) from M realisations of n_u experiments.

    Every period is used, the settling ones too.

    Raises
    ------
    IdentificationError
        As `hil.identification.bla.robust_bla.robust_bla`; one period; no degree of freedom left in the transient's window.
    """
    model = model or LocalModel()
    silent = detection_lines(records)
    steady = steady_state(records, model, np.concatenate((records.lines, silent)))
    excited = slice(0, len(records.lines))
    w = period_spectra(records.excitation[:, :, : records.period_samples], records.period_samples)[:, :, 0]
    response = average_realisations(
        records,
        steady.z[:, :, excited],
        w[:, :, records.lines],
        steady.noise[:, :, excited].mean(axis=(0, 1)),
        steady.dof[excited] * records.realisations * records.experiments,
        method=f"robust_{model.name}",
        settings={"periods": steady.periods, **model.settings},
        notes=(*records.notes, *steady.notes),
    )
    return replace(response, even_odd=even_odd(records, steady, response.G))
