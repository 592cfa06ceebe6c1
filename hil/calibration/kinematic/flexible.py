"""The flexible kinematic model fitted to phantom-calibrated poses: the thesis's model-based calibration (Sec. 2.3.4)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from controllers.models.flexible_chain import SOURCE_NAMES, FlexibleChain
from hil.calibration.kinematic.identify_denavit_hartenberg import free_parameters
from hil.calibration.kinematic.observable import NullCombination, combinations_seen, fit_seen
from hil.calibration.use.lookup_table import LookUp
from hil.errors import UnusableInputError
from hil.imaging.geometry import ConeBeam

TOLERANCE = {"m": 5e-3, "rad": 0.02, "-": 0.01}
"""How far a machine may be from its drawing before it is measured; for a compliance, its own nominal value."""

ROUNDS = 4
"""Rounds of fitting and of estimating what the residuals leave unexplained."""

SHAPE = np.diag(np.repeat([1.0, 1.0, 1.0 / 0.5], 3) ** 2)
"""What is not modelled moves source and phantom alike, and turns the panel as at the end of half a metre."""

FIRST_UNMODELLED_M, LEAST_UNMODELLED_M = 1e-4, 1e-7
"""An image shows some combinations to micrometres; trusted fully at first, those would distort the model to absorb its own errors."""

SMALL = 1e-3
"""Share of the way to the next exposure over which a pose's change is differenced."""

SIX, NINE = np.arange(3, 9), np.arange(9)


@dataclass(frozen=True)
class FlexibleFit:
    """A model fitted to poses.

    Attributes
    ----------
    model : FlexibleChain
    covariance : (p, p) array
        Of all parameters, from the poses and the drawing's tolerance; zero for what was frozen.
    rank : int
        Combinations of the free parameters that the poses determine better than the drawing.
    singular_values : array
        Tolerance over standard deviation of every combination.
    null : tuple of NullCombination
        The other combinations: left near the drawing.
    frozen : tuple of str
        Kept by request, or not moved by any scan, or the source of six-parameter poses.
    residual : (N, 9) array
        Deviation of the measured poses from the model's, as `ConeBeam.moved` takes it [m, rad].
    chi2 : float
        Mean squared residual in units of the poses' covariance, per degree of freedom.
    unmodelled_m : float
        Additional scatter of the poses [m], and over half a metre in angle: shaking, and what the model leaves out. It is added to
        the poses' covariance.
    """

    model: FlexibleChain
    covariance: np.ndarray
    rank: int
    singular_values: np.ndarray
    null: tuple[NullCombination, ...]
    frozen: tuple[str, ...]
    residual: np.ndarray
    chi2: float
    unmodelled_m: float


def beam_of(model: FlexibleChain, positions: np.ndarray) -> ConeBeam:
    """Return the model's geometry at axis positions (N, axes), referred to the phantom."""
    source, phantom, to_detector = model.poses(np.atleast_2d(positions))
    return ConeBeam(source, phantom, np.swapaxes(to_detector, 1, 2))


def fit_flexible(
    start: FlexibleChain, positions: np.ndarray, measured: ConeBeam, covariance: np.ndarray, frozen: Collection[str] = ()
) -> FlexibleFit:
    """Fit the model to measured poses by Levenberg-Marquardt, every parameter within its tolerance of the drawing.

    The tolerances count as measurements of the nominal values. A parameter that the poses do not show then stays at the drawing, and one
    that they hardly show does not absorb the model's own error (errata: delta_theta_4 and theta_z reach 3e5 rad without this).

    Parameters
    ----------
    start : FlexibleChain
        Nominal parameters.
    positions : (N, axes) array
        Of the machine's axes [rad].
    measured : ConeBeam
        Of the N exposures.
    covariance : (N, 9, 9) array
        Of their deviations; zero for a source that was held: then the six others alone are used and the source is frozen.
    frozen : collection of str
        Parameters not to fit.

    Raises
    ------
    UnusableInputError
        Fewer equations than parameters, an unknown name in `frozen`, or parallel moving axes.
    BadAnswerError
        The iteration does not converge.
    """
    held = _source_held(covariance)
    used = SIX if held else NINE
    free = free_parameters(start.chain, start.names, start.angles(positions), {*frozen, *(SOURCE_NAMES if held else ())})
    if used.size * len(positions) <= free.size:
        raise UnusableInputError(
            f"{len(positions)} exposures give {used.size * len(positions)} equations for {free.size} parameters; take more"
        )
    nominal, tolerance = start.values, tolerances(start)
    values, unmodelled = nominal, FIRST_UNMODELLED_M
    for _ in range(ROUNDS):
        white = _whitening(covariance + unmodelled**2 * SHAPE, used)

        def deviation_of(values: np.ndarray, white: np.ndarray = white) -> np.ndarray:
            deviation = measured.deviation_from(beam_of(start.with_values(values), positions))
            residuals: np.ndarray = (white @ deviation[:, used, None]).ravel()
            return residuals

        def jacobian_of(values: np.ndarray, white: np.ndarray = white) -> np.ndarray:
            jacobian = start.with_values(values).jacobian(positions)
            jacobian[:, 6:] *= -1.0  # the model turns the phantom in the detector's frame, a deviation the detector in the phantom's
            rows: np.ndarray = (white @ jacobian[:, used]).reshape(-1, len(start.names))
            return rows

        def residual_of(values: np.ndarray, white: np.ndarray = white) -> np.ndarray:
            return np.concatenate([deviation_of(values, white), (nominal - values) / tolerance])

        def slope_of(values: np.ndarray, white: np.ndarray = white) -> np.ndarray:
            return np.concatenate([jacobian_of(values, white), np.diag(1.0 / tolerance)])

        fit = fit_seen(residual_of, slope_of, values, free, start.names)
        values = fit.values
        seen, null = combinations_seen(jacobian_of(values)[:, free], tolerance[free], [start.names[k] for k in free])
        rank = len(free) - len(null)
        residual = measured.deviation_from(beam_of(start.with_values(values), positions))
        freedom = used.size * len(positions) - rank
        unmodelled = _unmodelled(residual, covariance, used, freedom)
    return FlexibleFit(
        model=start.with_values(values),
        covariance=fit.covariance,
        rank=rank,
        singular_values=seen,
        null=null,
        frozen=tuple(name for k, name in enumerate(start.names) if k not in set(free)),
        residual=residual,
        chi2=_chi2(residual, covariance, used) / freedom,
        unmodelled_m=unmodelled,
    )


def _unmodelled(residual: np.ndarray, covariance: np.ndarray, used: np.ndarray, freedom: int) -> float:
    """Return the error of every pose beside its covariance that explains residuals (N, 9) as large as these [m]; 0 if none is needed."""

    def excess(unmodelled_m: float) -> float:
        return _chi2(residual, covariance + unmodelled_m**2 * SHAPE, used) - freedom

    if excess(LEAST_UNMODELLED_M) <= 0.0:
        return 0.0
    most = LEAST_UNMODELLED_M
    while excess(most) > 0.0:
        most *= 2.0
    return float(brentq(excess, 0.5 * most, most, xtol=1e-9))


def _chi2(residual: np.ndarray, covariance: np.ndarray, used: np.ndarray) -> float:
    return float(np.sum((_whitening(covariance, used) @ residual[:, used, None]) ** 2))


def clock_lag(fit: FlexibleFit, tables: Sequence[LookUp]) -> tuple[float, float]:
    """Return how much later the images were taken than their positions say, and its standard deviation.

    Both are in exposure periods. The residuals are regressed on how the poses change from exposure to exposure, with what the parameters
    could have absorbed projected out. One direction of motion shows nothing: a lag is then an offset of the joint. Exposures of a table are
    taken as evenly spaced.

    Parameters
    ----------
    fit : FlexibleFit
    tables : sequence of LookUp
        What it was fitted to, each in the order of time.
    """
    positions = np.concatenate([table.positions for table in tables])
    covariance = np.concatenate([table.covariance for table in tables])
    used = SIX if _source_held(covariance) else NINE
    white = _whitening(covariance + fit.unmodelled_m**2 * SHAPE, used)
    step = np.concatenate([np.gradient(table.positions, axis=0) for table in tables if len(table.positions) > 1])
    if len(step) != len(positions):
        return 0.0, np.inf
    ahead, behind = beam_of(fit.model, positions + SMALL * step), beam_of(fit.model, positions - SMALL * step)
    change = (white @ (ahead.deviation_from(behind) / (2.0 * SMALL))[:, used, None]).ravel()
    free = [k for k, name in enumerate(fit.model.names) if name not in fit.frozen]
    jacobian = fit.model.jacobian(positions)
    jacobian[:, 6:] *= -1.0
    known = (white @ jacobian[:, used][..., free]).reshape(-1, len(free)) * tolerances(fit.model)[free]
    u, s, _ = np.linalg.svd(known, full_matrices=False)
    taken = u[:, s > 1.0]
    change = change - taken @ (taken.T @ change)
    seen = float(change @ change)
    if seen < 1e-12:
        return 0.0, np.inf
    return float(change @ (white @ fit.residual[:, used, None]).ravel()) / seen, 1.0 / np.sqrt(seen)


def _source_held(covariance: np.ndarray) -> bool:
    return not np.diagonal(covariance, axis1=1, axis2=2)[:, :3].any(axis=1).all()


def _whitening(covariance: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return W (N, m, m) with W' W the inverse of the covariance of the deviations `used`."""
    return np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariance[:, used[:, None], used])), 1, 2)


def tolerances(model: FlexibleChain) -> np.ndarray:
    """Return how far each parameter may be from the drawing, (p,)."""
    rigid = len(model.names) - len(model.compliance)
    return np.array([TOLERANCE[unit] if k < rigid else model.values[k] for k, unit in enumerate(model.units)])


def joined(tables: Sequence[LookUp]) -> LookUp:
    """Join the tables of several scans.

    Raises
    ------
    UnusableInputError
        Six and nine parameters, or other axes, side by side.
    """
    first = tables[0]
    for table in tables[1:]:
        if table.axes != first.axes:
            raise UnusableInputError(
                f"one table is over {', '.join(first.axes)}, another over {', '.join(table.axes)}; calibrate one machine"
            )
        if bool(table.notes.get("six")) != bool(first.notes.get("six")):
            raise UnusableInputError("one table has six parameters, another nine; calibrate the phantom the same way for all")
    return replace(
        first,
        positions=np.concatenate([table.positions for table in tables]),
        deviation=np.concatenate([table.deviation for table in tables]),
        covariance=np.concatenate([table.covariance for table in tables]),
    )
