"""Geometric parameters over a scan as charts: what exposures deviate from nominal, with two standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hil.pages import Band, Chart, Charts, Scale, Series, Table

CHART_PX = 170
SIGMAS = 2.0

Curve = tuple[np.ndarray, np.ndarray | None]
"""Values (N, P) [m, rad] and, where there is one, covariance (N, P, P)."""


def deviation_charts(along: np.ndarray, label: str, curves: Mapping[str, Curve], names: Sequence[str], units: Sequence[str]) -> Charts:
    """Return a chart for each parameter.

    Parameters
    ----------
    along : (N,) array
        What to draw over, an axis position or time.
    label : str
        Its name and unit.
    curves : mapping of str to Curve
    names, units : sequences of str
        Of the parameters; units are `mm` and `mrad`.
    """
    order = np.argsort(along, kind="stable")
    x = along[order]
    cells = []
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        series, bands = [], []
        for number, (curve, (values, covariance)) in enumerate(curves.items()):
            y = 1e3 * values[order, k]
            series.append(Series(curve, x, y, look=2 - number if number < 2 else number + 1))
            if covariance is not None:
                half = SIGMAS * 1e3 * np.sqrt(covariance[order, k, k])
                bands.append(Band(f"{SIGMAS:g} standard deviations", x, y - half, y + half))
        title = name.replace("_", " ")
        cells.append(Chart(title, Scale(label), Scale(f"deviation in {title} [{unit}]"), series, bands, group="along", height=CHART_PX))
    return Charts(cells, columns=3)


def deviation_table(values: np.ndarray, sigma: np.ndarray, names: Sequence[str], units: Sequence[str]) -> Table:
    """Return range and median standard deviation of each parameter, from (N, P) arrays [m, rad]."""
    rows = [
        (
            name,
            f"{1e3 * np.nanmin(values[:, k]):.3f}",
            f"{1e3 * np.nanmax(values[:, k]):.3f}",
            f"{1e3 * np.nanmedian(sigma[:, k]):.3f}",
            unit,
        )
        for k, (name, unit) in enumerate(zip(names, units, strict=True))
    ]
    return Table(("parameter", "least", "largest", "standard deviation", "unit"), rows, frozenset((1, 2, 3)))
