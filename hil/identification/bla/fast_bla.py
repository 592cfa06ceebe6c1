"""Fast best linear approximation: one realisation, whose detection lines give the distortion (thesis Sec. 3.4.1).

Correction used: (3.23) is Y Y^H without the modulus.
"""

from __future__ import annotations

import numpy as np

from hil.errors import IdentificationError
from hil.identification.bla.averaging import (
    amplitude_and_phase,
    as_matrices,
    averaged_spectra,
    check_full_set,
    closed_loop_and_plant,
    covariance_of_noise,
    inverse_gram,
)
from hil.identification.bla.detection_lines import detection_lines, distortion, interpolate, loop_corrected
from hil.identification.covariance import kronecker, nonlinear_covariance, plant_covariance
from hil.identification.records import PeriodicRecords, labels
from hil.identification.result import FrequencyResponse


def fast_bla(records: PeriodicRecords) -> FrequencyResponse:
    """Estimate the fast best linear approximation from one realisation, (3.21) to (3.23).

    The total covariance comes from the detection lines.

    The detection lines' outputs are corrected for the loop, (3.21), with G interpolated between excited lines, (3.22); their covariance
    Y Y^H is interpolated back to the excited lines. Where only odd lines are excited the odd detection lines are used, the even ones
    being reached by distortions that do not touch the response. More than one realisation is averaged coherently before.

    Raises
    ------
    IdentificationError
        As `robust_bla`; no detection line in the excited band.
    """
    check_full_set(records)
    if records.realisations > 1:
        raise IdentificationError(f"the fast method takes one realisation, not {records.realisations}: use the robust method")
    z, w, weights = averaged_spectra(records)
    lines = records.lines
    mean_z, W = as_matrices(z.mean_over_periods[..., lines, :]), as_matrices(w[:, :, lines])
    amplitude, T = amplitude_and_phase(W)
    averaged = (mean_z @ np.conj(np.swapaxes(T, -1, -2)))[0]
    G_wz, G, U = closed_loop_and_plant(averaged, amplitude, records)
    notes = list(records.notes) + z.notes

    E = records.experiments
    noise_dof = float(np.sum(weights.sum(axis=2) - 1))
    noise_z = noise = None
    if noise_dof > 0:
        noise_z = covariance_of_noise(z, lines, weights)
        noise = plant_covariance(G, U, noise_z)
    else:
        notes.append("one period: no noise covariance")

    detection = detection_lines(records)
    if np.all(lines % 2 == 1) and np.any(detection % 2 == 1):
        detection = detection[detection % 2 == 1]
    elif np.all(lines % 2 == 1):
        notes.append("no odd detection line: the total covariance is that of the even distortions and misses the odd ones")
    if len(detection) == 0:
        raise IdentificationError("every line of the band is excited: the fast method needs detection lines, 1 in 2, 3 or 4 left out")
    outer = loop_corrected(z.mean_over_periods, G, lines, detection, records)[0]  # (E, K, n_y), (3.21)
    covariance = np.einsum("eki,ekj->kij", outer, np.conj(outer)) / E  # (3.23)
    total_y, share = interpolate(covariance, detection, lines)
    total = kronecker(inverse_gram(U), total_y)
    nonlinear = None if noise is None else nonlinear_covariance(total, noise, 1)

    return FrequencyResponse(
        lines=lines,
        frequencies_Hz=records.frequencies_Hz,
        G=G,
        G_wz=G_wz,
        noise_covariance=noise,
        total_covariance=total,
        nonlinear_covariance=nonlinear,
        noise_covariance_z=noise_z,
        total_covariance_z=None,
        noise_dof=np.full(len(lines), noise_dof),
        total_dof=E / (share**2 + (1.0 - share) ** 2),
        even_odd=distortion(records, z.mean_over_periods, G, z.variance_of_mean),
        method="fast_bla",
        settings={"realisations": 1, "experiments": E, "periods": int(weights.sum(axis=2).min()), "detection_lines": len(detection)},
        notes=tuple(notes),
        **labels(records),
    )
