"""Orders and windows of a local model chosen from the data: the recommendation left open in Sec. 3.5.3.

The criterion is how well each line's output is predicted from its neighbours alone. At the centre of its own window the local model reduces
to z = N_0 w, so leaving the centre line out costs nothing: with H = w (K^H K)^-1 w^H over the centre's records, the prediction error is
(I - H)^-1 (z - N_0 w). Its mean square is noise + variance of the estimate + bias^2. The noise is the same for every candidate, so the
candidate with the least mean square has the least total error, with bias and variance weighted as in the response.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.errors import IdentificationError
from hil.identification.bla.averaging import plant_from_closed_loop
from hil.identification.local.least_squares import LocalFits
from hil.identification.local.local_model import LocalModel, smallest_half_width
from hil.identification.local.regression import check_told
from hil.identification.lpm_lrm.nd_lpm_lrm import ONE_POSE, PoseModel, PoseSpectra, fit_pose, local_orders, prepare, scheduling
from hil.identification.lpm_lrm.pose_windows import pose_windows
from hil.identification.records import PeriodicRecords

ALONE = 1e-9  # share of a line's own estimate that its neighbours give, below which they count as giving none


@dataclass(frozen=True)
class Candidate:
    """Orders and windows over frequency and over the poses."""

    model: LocalModel
    over_poses: PoseModel = ONE_POSE


@dataclass(frozen=True)
class Selection:
    """The candidate that was chosen, and how every candidate did.

    Attributes
    ----------
    chosen : Candidate
    candidates : those that the data had enough lines for.
    scores : (n,) mean over lines and outputs of the squared prediction error in units of the noise variance, 1 at best.
    refused : (candidate, reason) of those without a degree of freedom.
    """

    chosen: Candidate
    candidates: tuple[Candidate, ...]
    scores: np.ndarray
    refused: tuple[tuple[Candidate, str], ...]


def default_candidates(records: PeriodicRecords, poses: int = 1) -> tuple[Candidate, ...]:
    """Return polynomial and rational models of moderate order.

    Each comes with windows from the smallest possible one to three times its size.

    Parameters
    ----------
    records : of one pose; they set how many equations a line gives. poses : how many poses there are along one scheduling parameter.
    """
    n_u = records.n_inputs
    rows = records.realisations * records.experiments
    made = []
    for numerator, denominator in ((1, 0), (2, 0), (3, 0), (4, 0), (5, 0), (1, 1), (2, 1), (3, 1), (4, 1), (2, 2), (4, 2)):
        unknowns = (numerator + 1) * n_u + denominator * records.n_outputs
        for stretch in (1.0, 1.5, 2.0, 3.0):
            n = smallest_half_width(int(stretch * (unknowns + 2)), rows)
            model = LocalModel(numerator, 2, denominator, plant_window=n)
            made.append(Candidate(model))
            for q, p in ((1, 1), (1, 2), (2, 2)) if poses > 2 else ():
                made.append(Candidate(model, PoseModel((q,), (q,) if denominator else (0,), (p,))))
    return tuple(dict.fromkeys(made))


def select_local_model(records_of_poses: Sequence[PeriodicRecords], candidates: Sequence[Candidate] | None = None) -> Selection:
    """Choose among candidates by leaving each line out.

    Parameters
    ----------
    records_of_poses : records of each pose; a list of one for one pose.
    candidates : None takes `default_candidates`; over several scheduling parameters they must be given.

    Raises
    ------
    IdentificationError
        No candidate leaves a degree of freedom; the first one's reason.
    """
    coordinates = scheduling(records_of_poses)
    if candidates is None:
        if coordinates.shape[1] > 1:
            raise IdentificationError("over several scheduling parameters the candidates to select from must be given")
        candidates = default_candidates(records_of_poses[0], len(records_of_poses))
    prepared: dict[tuple[object, ...], list[PoseSpectra]] = {}
    noise: list[np.ndarray] = []
    errors, usable, refused = [], [], []
    for candidate in candidates:
        model = candidate.model
        key = (model.transient, model.denominator, model.transient_window, model.skip_periods)
        try:
            if key not in prepared:
                prepared[key] = [prepare(records, model) for records in records_of_poses]
            if not noise:
                noise = [pose.steady.noise[:, :, : len(pose.records.lines)].mean(axis=(0, 1)) for pose in prepared[key]]
            errors.append(_foretold(prepared[key], coordinates, candidate, noise))
            usable.append(candidate)
        except IdentificationError as error:
            refused.append((candidate, str(error)))
    if not usable:
        raise IdentificationError(f"none of {len(candidates)} candidates fits the data: {refused[0][1]}")
    scores = np.array([error.mean() for error in errors])
    return Selection(usable[int(scores.argmin())], tuple(usable), scores, tuple(refused))


def _foretold(poses: list[PoseSpectra], coordinates: np.ndarray, candidate: Candidate, noise: list[np.ndarray]) -> np.ndarray:
    """Return the mean square over records of the prediction error of y - G u, in units of its noise variance: (poses, L, n_y)."""
    model, over_poses = candidate.model, candidate.over_poses
    windows = pose_windows(coordinates, over_poses.windows, over_poses.border, over_poses.symmetry)
    z, w = np.stack([pose.z for pose in poses]), np.stack([pose.w for pose in poses])
    squares = []
    for here, (pose, window) in enumerate(zip(poses, windows, strict=True)):
        fits = fit_pose(z[window.poses], w[window.poses], window, pose.records, model, *local_orders(model, over_poses, window))
        squares.append(_at_centre(pose, fits, noise[here]))
    return np.stack(squares)


def _at_centre(pose: PoseSpectra, fits: LocalFits, noise_z: np.ndarray) -> np.ndarray:
    check_told(fits, pose.records.frequencies_Hz, pose.records.input_names)
    w, z = np.moveaxis(pose.w, 0, 1), np.moveaxis(pose.z, 0, 1)  # (L, R, n)
    own_share = w @ fits.inverse_gram @ np.conj(np.swapaxes(w, 1, 2))
    residual = z - w @ np.swapaxes(fits.response, 1, 2)
    others_share = np.eye(w.shape[1]) - own_share
    if np.min(np.linalg.eigvalsh(others_share)) < ALONE:
        raise IdentificationError("a line's window leaves it to itself: its neighbours foretell nothing of it")
    error = np.linalg.solve(others_share, residual)
    n_y = pose.records.n_outputs
    if pose.records.inputs is not None:
        G = plant_from_closed_loop(fits.response, n_y)
        Q = np.concatenate((np.broadcast_to(np.eye(n_y), (len(G), n_y, n_y)), -G), axis=2)
        error = error @ np.swapaxes(Q, 1, 2)
        noise_z = Q @ noise_z @ np.conj(np.swapaxes(Q, 1, 2))
    variance = np.real(np.diagonal(noise_z, axis1=1, axis2=2))
    squares: np.ndarray = np.mean(np.abs(error) ** 2, axis=1) / variance
    return squares
