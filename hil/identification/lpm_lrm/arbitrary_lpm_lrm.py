"""Local polynomial and rational method for arbitrary excitations, at one pose or many: Sec. 4.5, (4.48) to (4.51).

Response and transient are estimated together at every bin, since no bin is free of excitation. The residual holds both noise and nonlinear
distortion, so there is a total covariance and no split into the two. Every record has its own transient.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.errors import IdentificationError
from hil.identification.bla.averaging import plant_from_closed_loop
from hil.identification.covariance import kronecker, output_covariance
from hil.identification.local.least_squares import LocalFits
from hil.identification.local.local_model import LocalModel, half_width
from hil.identification.local.monomials import multi_indices
from hil.identification.local.regression import check_told, local_regression
from hil.identification.lpm_lrm.nd_lpm_lrm import ONE_POSE, PoseModel, local_orders
from hil.identification.lpm_lrm.pose_windows import PoseWindow, pose_windows, varying_directions
from hil.identification.result import FrequencyResponse
from hil.identification.spectra import record_spectra


@dataclass(frozen=True)
class ArbitraryRecords:
    """R records of any excitation at one pose.

    Attributes
    ----------
    outputs : (R, T, n_y). inputs : (R, T, n_u), or None in open loop. excitation : (R, T, n_u).
    sample_rate_Hz : f_s. The rest as in `hil.identification.records.PeriodicRecords`.
    """

    outputs: np.ndarray
    inputs: np.ndarray | None
    excitation: np.ndarray
    sample_rate_Hz: float
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_units: tuple[str, ...]
    pose: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check that the arrays fit together."""
        for name in ("outputs", "inputs", "excitation"):
            values = getattr(self, name)
            if values is not None and not np.isfinite(values).all():
                raise IdentificationError(
                    f"{name} have missing samples: a local method for arbitrary excitations needs every sample of a record"
                )
        for name, column in zip(self.input_names, np.moveaxis(self.excitation, 2, 0), strict=True):
            if not np.any(column):
                raise IdentificationError(f"input {name} is not excited in any record; excite it, or identify the other inputs only")


def arbitrary_local(
    records_of_poses: Sequence[ArbitraryRecords],
    band_Hz: tuple[float, float],
    model: LocalModel | None = None,
    over_poses: PoseModel = ONE_POSE,
) -> tuple[FrequencyResponse, ...]:
    """Estimate frequency responses over the bins of a band, one per pose.

    Parameters
    ----------
    records_of_poses : equally long records of each pose.
    band_Hz : lowest and highest frequency wanted; the excitation must have power there.
    model : orders; `plant_window` counts bins to either side. over_poses : orders and windows over the scheduling parameters.

    Raises
    ------
    IdentificationError
        Records that do not fit together, a band without bins, windows that leave no degree of freedom.
    """
    model = model or LocalModel()
    _check(records_of_poses)
    T = records_of_poses[0].outputs.shape[1]
    step_Hz = records_of_poses[0].sample_rate_Hz / T
    bins = np.arange(max(1, int(np.ceil(band_Hz[0] / step_Hz))), min((T - 1) // 2, int(np.floor(band_Hz[1] / step_Hz))) + 1)
    if len(bins) == 0:
        raise IdentificationError(f"no bin of {step_Hz:.4g} Hz spacing between {band_Hz[0]:.4g} and {band_Hz[1]:.4g} Hz")
    coordinates = _scheduling(records_of_poses)
    windows = pose_windows(coordinates, over_poses.windows, over_poses.border, over_poses.symmetry)
    z_parts, w_parts = [], []
    for records in records_of_poses:
        measured = (records.outputs,) if records.inputs is None else (records.outputs, records.inputs)
        z_parts.append(np.concatenate([record_spectra(signal) for signal in measured], axis=2))
        w_parts.append(record_spectra(records.excitation))
    z, w = np.stack(z_parts), np.stack(w_parts)  # (poses, R, T // 2 + 1, n)
    responses = []
    for records, window in zip(records_of_poses, windows, strict=True):
        orders = local_orders(model, over_poses, window)
        fits = _fit(z[window.poses], w[window.poses], window, bins, model, *orders, n_y=records.outputs.shape[2])
        responses.append(_response(records, bins, T, fits, model))
    return tuple(responses)


def _fit(
    z: np.ndarray,
    w: np.ndarray,
    neighbours: PoseWindow,
    bins: np.ndarray,
    model: LocalModel,
    numerator: tuple[int, ...],
    denominator: tuple[int, ...],
    n_y: int,
) -> LocalFits:
    k, R, available, n_z = z.shape
    n_u = w.shape[3]
    unknowns = (1 + len(multi_indices(numerator))) * n_u + len(multi_indices(denominator)) * n_y + k * R * (model.transient + 1)
    per_line = k * R
    n = half_width(model, unknowns, per_line, n_z, available - 1)
    start = np.clip(bins - n, 1, available - 2 * n - 1)  # bin 0 holds the means, which are no response
    window = start[:, None] + np.arange(2 * n + 1)
    psi = (window - bins[:, None]).astype(float)
    psi /= np.abs(psi).max(axis=1, keepdims=True)
    B = len(bins)
    rows = (np.arange(per_line)[None, :, None] * available + window[:, None, :]).reshape(B, -1)
    own_transient = np.zeros((B, per_line, 2 * n + 1, per_line, model.transient + 1))
    for record in range(per_line):
        own_transient[:, record, :, record] = psi[:, :, None] ** np.arange(model.transient + 1)
    return local_regression(
        rows,
        *neighbours.coordinates(psi, R),
        numerator,
        denominator,
        w.reshape(-1, n_u),
        z.reshape(-1, n_z),
        own_transient.reshape(B, rows.shape[1], -1),
        n_y,
    )


def _response(records: ArbitraryRecords, bins: np.ndarray, T: int, fits: LocalFits, model: LocalModel) -> FrequencyResponse:
    L, n_y, n_u = len(bins), records.outputs.shape[2], records.excitation.shape[2]
    check_told(fits, bins * records.sample_rate_Hz / T, records.input_names)
    G = plant_from_closed_loop(fits.response, n_y)
    to_plant = np.broadcast_to(np.eye(n_u), (L, n_u, n_u))
    if records.inputs is not None:
        to_plant = np.swapaxes(np.linalg.inv(fits.response[:, n_y:]), 1, 2)
    total_z = fits.residual_products / fits.dof[:, None, None]
    weight = to_plant @ fits.inverse_gram @ np.conj(np.swapaxes(to_plant, 1, 2))
    return FrequencyResponse(
        lines=bins,
        frequencies_Hz=bins * records.sample_rate_Hz / T,
        G=G,
        G_wz=fits.response,
        noise_covariance=None,
        total_covariance=kronecker(weight, output_covariance(G, total_z)),
        nonlinear_covariance=None,
        noise_covariance_z=None,
        total_covariance_z=total_z,
        noise_dof=np.zeros(L),
        total_dof=fits.dof.astype(float),
        output_names=records.output_names,
        input_names=records.input_names,
        output_units=records.output_units,
        input_units=records.input_units,
        sample_rate_Hz=records.sample_rate_Hz,
        period_samples=T,
        method=f"arbitrary_{model.name}",
        settings={"records": len(records.outputs), **model.settings},
        pose=records.pose,
        notes=records.notes,
    )


def _check(records_of_poses: Sequence[ArbitraryRecords]) -> None:
    if not records_of_poses:
        raise IdentificationError("no records given")
    first = records_of_poses[0]
    for index, other in enumerate(records_of_poses):
        if other.outputs.shape != first.outputs.shape or other.excitation.shape != first.excitation.shape:
            raise IdentificationError(f"poses 1 and {index + 1} have records of shapes {first.outputs.shape} and {other.outputs.shape}")


def _scheduling(records_of_poses: Sequence[ArbitraryRecords]) -> np.ndarray:
    poses = np.array([records.pose for records in records_of_poses], float).reshape(len(records_of_poses), -1)
    return np.zeros((1, 0)) if len(poses) == 1 else poses[:, varying_directions(poses)]
