"""Data-driven calibration (Chapter 5): quasi-static parameters and the detector's displacement as states of one filter at the sample rate.

The observer's estimate moves the displacement from sample to sample and draws it back where it has strayed, so that it cannot drift; the
parameters stay, but for what they may have changed by since the last scan. Images measure the sum of both at the instant they show. They
arrive late: the displacement of that instant is kept as a state of its own until they do, which is the same as having had them in time.
Once the parameters have converged, images of the phantom are no longer needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from hil.calibration.observed_beam import ObservedBeam
from hil.calibration.quasi_static import QuasiStatic, marker_view
from hil.calibration.smoothed import smoothed_displacement

STRAYS_S = 3.0
"""How long an error of the observer's displacement lasts: most of it lies below 0.5 Hz (docs/observer.md)."""

CHANGED = {size: float(chi2.ppf(1.0 - 1e-6, size)) for size in (6, 9)}
"""An image of so many numbers farther off than this is no accident: the machine has changed, or the image shows something else."""

USED, CHANGE, REFUSED = "used", "change", "refused"
"""What became of an image."""

SPOT_M = 10e-6
"""Wobble of the focal spot with the anode, which no image of it can foresee."""


@dataclass(frozen=True)
class Measurement:
    """What one image says of its exposure.

    Attributes
    ----------
    time_s : float
        Middle of the exposure, in the loop's time.
    values : (k,) array
        "phantom": the nine deviations from the nominal geometry at the observer's positions. "marker": what the plate shows beyond nominal,
        focal_u, focal_v, focal_length [m], theta_x, theta_y, theta_z [rad].
    covariance : (k, k) array
    kind : "phantom" or "marker"
    """

    time_s: float
    values: np.ndarray
    covariance: np.ndarray
    kind: str = "phantom"


Sight = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Of a measurement: change with the parameters (k, p) and with the displacement (k, 6), and what it says beyond the observer (k,)."""


@dataclass(frozen=True)
class Parameters:
    """What is known of the quasi-static parameters.

    Attributes
    ----------
    values : (p,) array
    covariance : (p, p) array
    """

    values: np.ndarray
    covariance: np.ndarray

    @classmethod
    def unknown(cls, model: QuasiStatic) -> Parameters:
        """Before any image."""
        return cls(np.zeros(len(model.names)), np.diag(model.prior**2))

    def aged(self, model: QuasiStatic) -> Parameters:
        """For another scan than the one they were found in."""
        return Parameters(self.values.copy(), self.covariance + np.diag(model.between_scans**2))


@dataclass
class Calibration:
    """A recording's geometry, found.

    Attributes
    ----------
    live : (N, 9) array
        Deviations from nominal as they were known at each sample.
    final : (N, 9) array
        With the parameters found at the end; where marker plates were seen, with the displacement that all images tell.
    covariance : (N, 9, 9) array
        Of `live`.
    parameters : Parameters
        At the end.
    used, refused : lists of int
        Measurements taken in, and those that contradict the rest.
    changes : list of int
        Measurements at which the mount was found moved.
    phantoms : int
        How many of those used show the phantom.
    converged : int or None
        How many of these it took until the place was known as well as asked for.
    history : (images + 1, p) array, (images + 1, p) array
        Parameters and their standard deviations after each image.
    place_sigma_m : list of float
        Predicted standard deviation of the isocentre's place over the recording after each image.
    """

    live: np.ndarray
    final: np.ndarray
    covariance: np.ndarray
    parameters: Parameters
    used: list[int] = field(default_factory=list)
    refused: list[int] = field(default_factory=list)
    changes: list[int] = field(default_factory=list)
    phantoms: int = 0
    converged: int | None = None
    history: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    place_sigma_m: list[float] = field(default_factory=list)

    @property
    def sigma(self) -> np.ndarray:
        """(N, 9) standard deviations of `live`."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))


class DataDrivenFilter:
    """States: p parameters, six errors of the observer's displacement, and six more for every image on its way.

    Parameters
    ----------
    model : QuasiStatic
    start : Parameters
    displacement_std : (6,) array

    Attributes
    ----------
    x, covariance : (states,), (states, states) arrays
    renewed_variance : (6,) array
        Of the displacement's error when nothing is known of it any more.
    """

    def __init__(self, model: QuasiStatic, start: Parameters, displacement_std: np.ndarray) -> None:
        self.model, self.size = model, len(model.names)
        self.renewed_variance = np.asarray(displacement_std) ** 2
        count = self.size + 6
        self.x, self.covariance = np.zeros(count), np.zeros((count, count))
        self.x[: self.size] = start.values
        self.covariance[: self.size, : self.size] = start.covariance
        self.covariance[self.size :, self.size :] = np.diag(self.renewed_variance)
        self._waiting: list[int] = []

    @property
    def parameters(self) -> Parameters:
        """The present estimate."""
        return Parameters(self.x[: self.size].copy(), self.covariance[: self.size, : self.size].copy())

    def predict(self, seconds: float) -> None:
        """Time passes: the displacement's error fades and is renewed."""
        place = slice(self.size, self.size + 6)
        kept = np.exp(-seconds / STRAYS_S)
        self.x[place] *= kept
        self.covariance[place, :] *= kept
        self.covariance[:, place] *= kept
        self.covariance[place, place] += (1.0 - kept**2) * np.diag(self.renewed_variance)

    def exposed(self, number: int) -> None:
        """An image is taken now: remember the displacement's error until it arrives."""
        place = slice(self.size, self.size + 6)
        self.x = np.concatenate([self.x, self.x[place]])
        grown = np.vstack([self.covariance, self.covariance[place, :]])
        self.covariance = np.hstack([grown, grown[:, place]])
        self._waiting.append(number)

    def dropped(self, number: int) -> None:
        """An image will not come, or has been taken in."""
        first = self.size + 6 + 6 * self._waiting.index(number)
        keep = np.r_[0:first, first + 6 : len(self.x)]
        self.x, self.covariance = self.x[keep], self.covariance[np.ix_(keep, keep)]
        self._waiting.remove(number)

    def innovation(self, number: int, rows: np.ndarray, twist: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What an image says beyond what is expected, and how it depends on the states.

        Parameters
        ----------
        number : int
            Of an image exposed.
        rows : (k, p) array
            Change of what it measures with the parameters.
        twist : (k, 6) array
            With the detector's displacement.
        rest : (k,) array
            Measured, less what the observer says.
        """
        gradient = np.zeros((len(rest), len(self.x)))
        gradient[:, : self.size] = rows
        first = self.size + 6 + 6 * self._waiting.index(number)
        gradient[:, first : first + 6] = twist
        return rest - gradient @ self.x, gradient

    def update(self, innovation: np.ndarray, gradient: np.ndarray, covariance: np.ndarray) -> None:
        """Take it in (Joseph's form, which keeps the covariance positive)."""
        spread = gradient @ self.covariance @ gradient.T + covariance
        gain = np.linalg.solve(spread, gradient @ self.covariance).T
        rest = np.eye(len(self.x)) - gain @ gradient
        self.x = self.x + gain @ innovation
        self.covariance = rest @ self.covariance @ rest.T + gain @ covariance @ gain.T

    def surprise(self, innovation: np.ndarray, gradient: np.ndarray, covariance: np.ndarray) -> float:
        """Normalised innovation squared."""
        spread = gradient @ self.covariance @ gradient.T + covariance
        return float(innovation @ np.linalg.solve(spread, innovation))

    def forget_mount(self) -> None:
        """The machine was moved against what is imaged: of the mount nothing is known any more."""
        for k, name in enumerate(self.model.names):
            if name.startswith(("mount_place", "mount_turn")):
                self.covariance[k, k] += self.model.prior[k] ** 2


def calibrate_data(
    model: QuasiStatic,
    observed: ObservedBeam,
    measurements: Sequence[Measurement],
    start: Parameters,
    *,
    late_s: float = 0.2,
    until_m: float = 0.0,
    most: int | None = None,
) -> Calibration:
    """Run the filter over a recording.

    Parameters
    ----------
    model : QuasiStatic
    observed : ObservedBeam
        The observer's geometry at every sample.
    measurements : sequence of Measurement
        In the order of their exposures.
    start : Parameters
    late_s : float
        How long after its exposure's middle an image is there.
    until_m : float
        Images are withdrawn once the isocentre's place is known to this standard deviation over the recording; 0: never.
    most : int, optional
        Images are withdrawn after so many.
    """
    late_s = max(late_s, 1e-9)
    events = [(float(each.time_s), 0, k) for k, each in enumerate(measurements)]
    events += [(float(each.time_s) + late_s, 1, k) for k, each in enumerate(measurements)]
    sights = _at_exposures(model, observed, measurements)
    work = DataDrivenFilter(model, start, observed.displacement_std)
    all_rows = model.rows(observed.positions, observed.load)
    twist_now = all_rows[:, :, displacement_columns(model)]
    result = Calibration(observed.deviation.copy(), observed.deviation.copy(), np.zeros((len(observed), 9, 9)), start)
    result.history.append((work.x[: work.size].copy(), np.sqrt(np.diag(work.covariance)[: work.size])))
    sparse = all_rows[:: max(1, len(observed) // 40), 3:6]
    result.place_sigma_m.append(place_sigma(work, sparse))
    now, row = float(observed.time_s[0]), 0
    is_withdrawn = most == 0
    for time_s, kind, k in [*sorted(events), (np.inf, 2, -1)]:
        stop = int(np.searchsorted(observed.time_s, time_s, side="left")) if np.isfinite(time_s) else len(observed)
        row = _publish(work, observed, all_rows, twist_now, result, row, stop, now)
        if kind == 2:
            break
        work.predict(max(time_s - now, 0.0))
        now = max(time_s, now)
        if kind == 0:
            work.exposed(k)
            continue
        is_phantom = measurements[k].kind == "phantom"
        how = "" if is_phantom and is_withdrawn else take_in(work, k, *sights[k], measurements[k].covariance)
        if how == REFUSED:
            result.refused.append(k)
        elif how:
            result.used.append(k)
            if how == CHANGE:
                result.changes.append(k)
            result.phantoms += is_phantom
            result.history.append((work.x[: work.size].copy(), np.sqrt(np.diag(work.covariance)[: work.size])))
            result.place_sigma_m.append(place_sigma(work, sparse))
            if result.converged is None and until_m > 0.0 and result.place_sigma_m[-1] < until_m:
                result.converged = result.phantoms
            is_withdrawn = result.converged is not None or (most is not None and result.phantoms >= most)
        work.dropped(k)
    result.parameters = work.parameters
    result.final = observed.deviation + all_rows @ work.x[: work.size]
    if any(measurements[k].kind == "marker" for k in result.used):
        order = sorted(result.used, key=lambda k: measurements[k].time_s)
        parameters, strayed = smoothed_displacement(
            DataDrivenFilter(model, start, observed.displacement_std),
            STRAYS_S,
            np.array([measurements[k].time_s for k in order]),
            [sights[k] for k in order],
            [measurements[k].covariance for k in order],
            {order.index(k) for k in result.changes},
            observed.time_s,
        )
        result.final = observed.deviation + all_rows @ parameters + np.einsum("nij,nj->ni", twist_now, strayed)
    return result


def _at_exposures(model: QuasiStatic, observed: ObservedBeam, measurements: Sequence[Measurement]) -> list[Sight]:
    if not measurements:
        return []
    positions, expected, load = observed.at(np.array([each.time_s for each in measurements]))
    rows = model.rows(positions, load)
    of_plate, expected_of_plate = model.marker_rows(rows), marker_view(expected)
    twist = displacement_columns(model)
    return [
        (rows[k], rows[k][:, twist], each.values - expected[k])
        if each.kind == "phantom"
        else (of_plate[k], of_plate[k][:, twist], each.values - expected_of_plate[k])
        for k, each in enumerate(measurements)
    ]


def displacement_columns(model: QuasiStatic) -> slice:
    """The detector's own offsets: its displacement moves the geometry as they do."""
    first = model.names.index("detector_place_x")
    return slice(first, first + 6)


def take_in(work: DataDrivenFilter, k: int, rows: np.ndarray, twist: np.ndarray, rest: np.ndarray, covariance: np.ndarray) -> str:
    """Take a measurement in that was exposed as number `k`, see `DataDrivenFilter.innovation`.

    Returns
    -------
    str
        `USED`; `CHANGE`: after the mount had been made unknown; `REFUSED`: it contradicts even then.
    """
    innovation, gradient = work.innovation(k, rows, twist, rest)
    how = USED
    if work.surprise(innovation, gradient, covariance) > CHANGED[len(innovation)]:
        before = work.covariance.copy()
        work.forget_mount()
        if work.surprise(innovation, gradient, covariance) > CHANGED[len(innovation)]:
            work.covariance = before
            return REFUSED
        how = CHANGE
    work.update(innovation, gradient, covariance)
    return how


def place_sigma(work: DataDrivenFilter, rows: np.ndarray) -> float:
    """Standard deviation [m] of the isocentre's place in the detector's frame by the parameters alone, rms over poses, per component."""
    covariance = work.covariance[: work.size, : work.size]
    return float(np.sqrt(np.mean(np.sum((rows @ covariance) * rows, axis=2))))


def _publish(
    work: DataDrivenFilter,
    observed: ObservedBeam,
    all_rows: np.ndarray,
    twist: np.ndarray,
    result: Calibration,
    first: int,
    stop: int,
    now: float,
) -> int:
    """Geometry and deviations of samples [first, stop) with what is known at `now`."""
    if stop <= first:
        return first
    size = work.size
    part = slice(first, stop)
    kept = np.exp(-(observed.time_s[part] - now) / STRAYS_S)[:, None, None]
    gradient = np.concatenate([all_rows[part], kept * twist[part]], axis=2)
    states = work.x[: size + 6]
    result.live[part] = observed.deviation[part] + gradient @ states
    covariance = work.covariance[: size + 6, : size + 6]
    renewed = np.maximum(1.0 - kept**2, 0.0) * ((twist[part] * work.renewed_variance) @ twist[part].transpose(0, 2, 1))
    result.covariance[part] = gradient @ covariance @ gradient.transpose(0, 2, 1) + renewed
    return stop
