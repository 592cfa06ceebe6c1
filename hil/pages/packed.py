"""Charts as the page's own script reads them: a table of arrays, each once, and what each chart draws of them."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.pages.chart import Chart

EVEN = 1e-6
"""Of a step, by which an abscissa may be off and still be sent as first value and step."""


class Packed:
    """Arrays and charts of a page."""

    def __init__(self) -> None:
        self.arrays: list[dict[str, Any]] = []
        self.charts: list[dict[str, Any]] = []
        self._places: dict[bytes, int] = {}

    def add(self, chart: Chart) -> int:
        """Add a chart; return its number."""
        self.charts.append(
            {
                "x": _scale(chart.x.is_log, chart.x.ends),
                "y": _scale(chart.y.is_log, chart.y.ends),
                "labels": [chart.x.label, chart.y.label],
                "group": chart.group,
                "height": chart.height,
                "series": [
                    {
                        "label": one.label,
                        "x": self._abscissa(one.x),
                        "y": self._values(one.y),
                        **style._asdict(),
                    }
                    for one, style in zip(chart.series, chart.styles(), strict=True)
                ],
                "bands": [
                    {"label": one.label, "x": self._abscissa(one.x), "low": self._values(one.low), "high": self._values(one.high)}
                    for one in chart.bands
                ],
                "marks": [mark.x for mark in chart.marks],
            }
        )
        return len(self.charts) - 1

    def _abscissa(self, x: Sequence[float] | np.ndarray) -> int:
        values = np.ascontiguousarray(x, dtype="<f8")
        if len(values) > 2:
            step = (values[-1] - values[0]) / (len(values) - 1)
            if step > 0.0 and np.abs(values - values[0] - step * np.arange(len(values))).max() <= EVEN * step:
                return self._place({"first": float(values[0]), "step": float(step), "count": len(values)})
        return self._place({"f8": base64.b64encode(values.tobytes()).decode()})

    def _values(self, y: Sequence[float] | np.ndarray) -> int:
        """Single precision about the middle: what is drawn is far coarser, and the middle keeps large numbers exact."""
        values = np.asarray(y, dtype=float)
        finite = values[np.isfinite(values)]
        middle = float(0.5 * (finite.min() + finite.max())) if finite.size else 0.0
        with np.errstate(over="ignore"):
            single = np.ascontiguousarray(np.where(np.isfinite(values), values - middle, np.nan), dtype="<f4")
        return self._place({"f4": base64.b64encode(single.tobytes()).decode(), "middle": middle})

    def _place(self, array: dict[str, Any]) -> int:
        """Return the number of an array, the same for the same values."""
        key = hashlib.blake2b(repr(array).encode(), digest_size=16).digest()
        if key not in self._places:
            self._places[key] = len(self.arrays)
            self.arrays.append(array)
        return self._places[key]


def _scale(is_log: bool, ends: tuple[float, float] | None) -> dict[str, Any]:
    return {"log": is_log, "ends": ends}
