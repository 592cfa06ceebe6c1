"""nD-LPM and nD-LRM: fast local polynomial and rational method for periodic excitations, over poses or at one.

Equations (3.37) to (3.48), (4.14) to (4.36), (4.39) to (4.47).

Transients are estimated pose by pose; the response is a local function of frequency and, over several poses, of the scheduling parameters.
With one pose the nD method is the LPM or LRM, order by order. Corrections used: (4.29) Sigma inverted; (4.34) with the conjugate of S^H S,
as (3.45); (4.36) with the inverse transpose of G_wu, as (3.46); (4.53) with all pure powers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.errors import IdentificationError
from hil.identification.bla.averaging import plant_from_closed_loop
from hil.identification.bla.detection_lines import detection_lines
from hil.identification.bla.transient import SteadyState, even_odd, steady_state
from hil.identification.covariance import kronecker, nonlinear_covariance, output_covariance
from hil.identification.local.least_squares import LocalFits
from hil.identification.local.local_model import LocalModel, half_width
from hil.identification.local.monomials import multi_indices
from hil.identification.local.regression import check_told, local_regression
from hil.identification.lpm_lrm.pose_windows import PoseBorder, PoseSymmetry, PoseWindow, pose_windows, varying_directions
from hil.identification.records import PeriodicRecords, labels
from hil.identification.result import FrequencyResponse
from hil.identification.spectra import period_spectra


@dataclass(frozen=True)
class PoseModel:
    """Orders and windows over the scheduling parameters, one entry per parameter that varies over the poses.

    Attributes
    ----------
    numerator : Q_z, orders of the response's numerator. denominator : those of the denominator, used where the model's N_d is above 0.
    windows : p_i, levels to either side.
    border : what happens at the edges of the range, see `hil.identification.lpm_lrm.pose_windows.pose_windows`.
    symmetry : of the machine along each parameter; none, or one per parameter.
    """

    numerator: tuple[int, ...] = (1,)
    denominator: tuple[int, ...] = (1,)
    windows: tuple[int, ...] = (2,)
    border: PoseBorder = "adaptive"
    symmetry: tuple[PoseSymmetry, ...] = ()


ONE_POSE = PoseModel((), (), ())
ALONE = PoseWindow(np.array([0]), np.zeros((1, 1, 0)), (), 0)
ALIKE = 1e-6  # of the largest amplitude, by which excitations of poses may differ and count as the same
ALIKE_NOTE = "poses excited alike: the total covariance is that of their weighted mean, since distortion does not average over them"


@dataclass(frozen=True)
class PoseSpectra:
    """Steady-state spectra of one pose, (R, L, n) over its R records."""

    records: PeriodicRecords
    steady: SteadyState
    z: np.ndarray = field(repr=False)
    w: np.ndarray = field(repr=False)


def nd_local(
    records_of_poses: Sequence[PeriodicRecords], model: LocalModel | None = None, over_poses: PoseModel | None = None
) -> tuple[FrequencyResponse, ...]:
    """Estimate one response per frozen pose with the nD-LRM (or nD-LPM), in the order given.

    Parameters
    ----------
    records_of_poses : records of each pose, with the same lines, inputs, outputs and number of records.
    model : orders and windows over frequency. over_poses : those over the scheduling parameters.

    Raises
    ------
    IdentificationError
        As `fast_local`; poses that do not belong together or are not known.
    """
    model = model or LocalModel()
    coordinates = scheduling(records_of_poses)
    over_poses = over_poses or PoseModel(*((value,) * coordinates.shape[1] for value in (1, 1, 2)))
    windows = pose_windows(coordinates, over_poses.windows, over_poses.border, over_poses.symmetry)
    poses = [prepare(records, model) for records in records_of_poses]
    z, w = np.stack([pose.z for pose in poses]), np.stack([pose.w for pose in poses])  # (poses, R, L, n)
    responses = []
    for pose, window in zip(poses, windows, strict=True):
        orders = local_orders(model, over_poses, window)
        around = z[window.poses], w[window.poses]
        alike = len(window.poses) > 1 and excited_alike(around[1])
        n = lines_to_either_side(*around, pose.records, model, *orders, alike=alike)
        fits = fit_pose(*around, window, pose.records, model, *orders, n)
        residuals = _weighted_mean_fits(*around, window, pose.records, model, orders[0], n) if alike else fits
        responses.append(_response(pose, fits, residuals, model, orders[0], len(window.poses)))
    return tuple(responses)


def local_orders(model: LocalModel, over_poses: PoseModel, window: PoseWindow) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return orders of numerator and denominator over frequency and each scheduling parameter, 0 where the window has no extent."""

    def carried(orders: Sequence[int]) -> tuple[int, ...]:
        return tuple(min(order, 2 * p) for order, p in zip(orders, window.reach, strict=True))

    over_denominator = over_poses.denominator if model.denominator else (0,) * len(window.reach)
    return (model.numerator, *carried(over_poses.numerator)), (model.denominator, *carried(over_denominator))


def fit_pose(
    z: np.ndarray,
    w: np.ndarray,
    neighbours: PoseWindow,
    records: PeriodicRecords,
    model: LocalModel,
    numerator: tuple[int, ...],
    denominator: tuple[int, ...],
    n: int | None = None,
) -> LocalFits:
    """Fit every line of one pose from its neighbours' steady-state spectra z (k, R, L, n_z), w (k, R, L, n_u).

    n lines to either side; None takes `lines_to_either_side`.
    """
    k, R, L, n_z = z.shape
    n_u = w.shape[3]
    if n is None:
        n = lines_to_either_side(z, w, records, model, numerator, denominator)
    lines, z, w, first = _with_images(records, z, w, n) if model.border == "periodic" else (records.lines, z, w, 0)
    here = first + np.arange(L)
    start = np.clip(here - n, 0, len(lines) - 2 * n - 1)
    window = start[:, None] + np.arange(2 * n + 1)  # (L, 2 n + 1)
    psi = (lines[window] - lines[here][:, None]).astype(float)
    psi /= np.abs(psi).max(axis=1, keepdims=True)
    block = np.arange(k * R) * len(lines)
    rows = (block[None, :, None] + window[:, None, :]).reshape(L, -1)
    return local_regression(
        rows,
        *neighbours.coordinates(psi, R),
        numerator,
        denominator,
        w.reshape(-1, n_u),
        z.reshape(-1, n_z),
        n_y=records.n_outputs,
    )


def lines_to_either_side(
    z: np.ndarray,
    w: np.ndarray,
    records: PeriodicRecords,
    model: LocalModel,
    numerator: tuple[int, ...],
    denominator: tuple[int, ...],
    *,
    alike: bool = False,
) -> int:
    """Return the half width of the window over frequency.

    Where poses are excited `alike`, it could carry the model for one pose as well.
    """
    k, R, L, n_z = z.shape
    n_u, n_y = w.shape[3], records.n_outputs
    unknowns = (1 + len(multi_indices(numerator))) * n_u + len(multi_indices(denominator)) * n_y
    # poses excited alike do not tell the inputs apart: each pose's own lines must carry the numerator over frequency
    by_itself = (1 + numerator[0]) * n_u + (denominator[0] * n_y if alike else 0)
    return max(half_width(model, unknowns, k * R, n_z, L), half_width(model, by_itself, R, n_z if alike else 0, L))


def excited_alike(w: np.ndarray) -> bool:
    """Tell whether the spectra (k, R, L, n_u) of all poses are the same.

    Then distortion is the same too, except for what the pose changes.
    """
    return bool(np.abs(w - w[0]).max() <= ALIKE * np.abs(w).max())


def _weighted_mean_fits(
    z: np.ndarray, w: np.ndarray, window: PoseWindow, records: PeriodicRecords, model: LocalModel, orders: Sequence[int], n: int
) -> LocalFits:
    """Fit, for one pose, the weighted mean of the poses' outputs that the polynomial over the poses gives at its centre.

    With the same w at every pose the regressors are those over frequency times those over the poses, so the estimate at the centre is that
    of one pose from sum_q a_q z_q, with a the first row of the pseudoinverse over the poses. Its residuals hold noise and distortion as
    they add up over the poses, however correlated. (4.31) takes them as independent; over poses with the same distortion it gives a third
    of the true covariance.
    """
    mean = np.tensordot(window.weights(orders[1:]), z, axes=1)[None]
    return fit_pose(mean, w[:1], ALONE, records, model, (orders[0],), (model.denominator,), n)


def _with_images(records: PeriodicRecords, z: np.ndarray, w: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Add the n lines' mirror images below 0 and above f_s / 2: conjugate spectra of a real, sampled signal."""
    lines, N = records.lines, records.period_samples
    below, above = slice(n - 1, None, -1) if n else slice(0, 0), slice(None, -n - 1, -1)
    extended = np.concatenate((-lines[below][-n:], lines, N - lines[above]))
    images = [np.concatenate((np.conj(s[:, :, below][:, :, -n:]), s, np.conj(s[:, :, above])), axis=2) for s in (z, w)]
    return extended, images[0], images[1], n


def _response(
    pose: PoseSpectra, fits: LocalFits, residuals: LocalFits, model: LocalModel, numerator: tuple[int, ...], neighbours: int
) -> FrequencyResponse:
    """Assemble the response of one pose.

    `residuals` are the fits that give the total covariance: `fits` themselves, or those of the weighted mean over the poses.
    """
    records, steady = pose.records, pose.steady
    L, n_y, n_u = len(records.lines), records.n_outputs, records.n_inputs
    check_told(fits, records.frequencies_Hz, records.input_names)
    G = plant_from_closed_loop(fits.response, n_y)
    to_plant = np.broadcast_to(np.eye(n_u), (L, n_u, n_u))
    if records.inputs is not None:
        to_plant = np.swapaxes(np.linalg.inv(fits.response[:, n_y:]), 1, 2)  # G_wu^-T of (3.46)
    weight, total_weight = (to_plant @ each.inverse_gram @ np.conj(np.swapaxes(to_plant, 1, 2)) for each in (fits, residuals))
    noise_z = steady.noise[:, :, :L].mean(axis=(0, 1))
    total_z = residuals.residual_products / residuals.dof[:, None, None]  # (3.48), (4.31)
    noise = kronecker(weight, output_covariance(G, noise_z))  # (3.45)
    total = kronecker(total_weight, output_covariance(G, total_z))
    M, E = records.realisations, records.experiments
    poses = "x".join(str(order) for order in numerator[1:])
    response = FrequencyResponse(
        lines=records.lines,
        frequencies_Hz=records.frequencies_Hz,
        G=G,
        G_wz=fits.response,
        noise_covariance=noise,
        total_covariance=total,
        nonlinear_covariance=nonlinear_covariance(total, noise, 1),
        noise_covariance_z=noise_z,
        total_covariance_z=total_z,
        noise_dof=steady.dof[:L] * M * E,
        total_dof=residuals.dof.astype(float),
        method=f"fast_{model.name}" if len(numerator) == 1 else f"nd_{model.name}",
        settings={
            "realisations": M,
            "experiments": E,
            "periods": steady.periods,
            **model.settings,
            **({"Q_z": poses, "poses": neighbours} if len(numerator) > 1 else {}),
        },
        notes=(*records.notes, *steady.notes, *(() if residuals is fits else (ALIKE_NOTE,))),
        **labels(records),
    )
    return replace(response, even_odd=even_odd(records, steady, G))


def prepare(records: PeriodicRecords, model: LocalModel) -> PoseSpectra:
    """Remove the transients and keep the excited lines."""
    steady = steady_state(records, model, np.concatenate((records.lines, detection_lines(records))))
    L = len(records.lines)
    w = period_spectra(records.excitation[:, :, : records.period_samples], records.period_samples)[:, :, 0, records.lines]
    return PoseSpectra(records, steady, steady.z[:, :, :L].reshape(-1, L, steady.z.shape[3]), w.reshape(-1, L, w.shape[3]))


def scheduling(records_of_poses: Sequence[PeriodicRecords]) -> np.ndarray:
    """Return the scheduling parameters that vary, (n, m); (1, 0) for one pose."""
    if not records_of_poses:
        raise IdentificationError("no records given")
    first = records_of_poses[0]
    for index, other in enumerate(records_of_poses):
        for name in ("output_names", "input_names", "period_samples", "realisations", "experiments"):
            if getattr(other, name) != getattr(first, name):
                raise IdentificationError(f"poses 1 and {index + 1} differ in {name}: {getattr(first, name)}, {getattr(other, name)}")
        if not np.array_equal(other.lines, first.lines):
            raise IdentificationError(f"poses 1 and {index + 1} are excited at different lines")
        if len(other.pose) != len(first.pose):
            raise IdentificationError(f"poses 1 and {index + 1} have {len(first.pose)} and {len(other.pose)} scheduling parameters")
    poses = np.array([records.pose for records in records_of_poses], float).reshape(len(records_of_poses), -1)
    if len(poses) == 1:
        return np.zeros((1, 0))
    poses = poses[:, varying_directions(poses)]
    if len(np.unique(poses, axis=0)) < len(poses):
        raise IdentificationError("two sets of records are of the same pose, or the poses are not known")
    return poses
