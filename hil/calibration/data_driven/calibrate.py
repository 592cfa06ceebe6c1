"""The data-driven filter (Chapter 5) run over a recording and its images: the geometry of every sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.calibration.data_driven.observed_beam import ObservedBeam
from hil.calibration.data_driven.parameter_filter import STRAYS_S, DataDrivenFilter, displacement_columns, place_sigma, take_in
from hil.calibration.data_driven.quasi_static import QuasiStatic, marker_view
from hil.calibration.data_driven.smoothed import smoothed_displacement
from hil.calibration.data_driven.values import CHANGE, REFUSED, Calibration, Measurement, Parameters, Sight


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
    """Write geometry and deviations of samples [first, stop) with what is known at time `now`."""
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
