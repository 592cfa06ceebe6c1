"""The sentence on top of a page is good, bad or unsure by what was found, and names the number that decides it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM
from page_text import page_text, page_verdict

from hil.observing import Estimate
from hil.pages import write_page
from hil.reconstruction.fdk import Volume
from hil.reconstruction.wire_profiles import WireQuality
from hil.reports.calibrated import of_exposures
from hil.reports.deviations import deviation_charts, deviation_table
from hil.reports.observed import verdict
from hil.reports.reconstructed import reconstructed_page

ROWS = 200


def estimate(alarms: int) -> Estimate:
    """A detector that is off by 2 mm along y, and innovations as large as chance makes them, with so many rows of alarm."""
    columns = {f"estimate_detector_{name}": np.zeros(ROWS) for name in ("x", "y", "z", "rx", "ry", "rz")}
    columns["estimate_detector_y"] = np.full(ROWS, 2e-3)
    columns["estimate_nis"], columns["estimate_measured"] = np.full(ROWS, 6.0), np.full(ROWS, 6.0)
    columns["estimate_alarm"] = (np.arange(ROWS) < alarms).astype(float)
    values = np.stack(list(columns.values()), axis=1)
    none = np.zeros((ROWS, 0))
    return Estimate(np.arange(ROWS) / 256.0, tuple(columns), ("",) * len(columns), values, (), none, (), none, "ukf", "")


@pytest.mark.parametrize(("alarms", "kind"), [(0, "good"), (10, "unsure"), (100, "bad")])
def test_an_observer_is_as_good_as_its_innovations(alarms: int, kind: str) -> None:
    said = verdict(estimate(alarms))
    assert said.kind == kind
    assert "2 mm rms" in said.text
    assert "1.00 of what is expected" in said.text
    assert ("may be worse than stated" in said.text) == (alarms > 0)


@pytest.mark.parametrize(("used", "kind"), [(20, "good"), (10, "unsure"), (0, "bad")])
def test_exposures_without_an_answer_count_against_a_calibration(used: int, kind: str) -> None:
    said = of_exposures(used, 20, "as it is")
    assert said.kind == kind
    assert f"{used} of 20" in said.text


@pytest.mark.parametrize(("ratio", "sign"), [(0.95, "✓"), (0.4, "?")])
def test_a_volume_is_as_good_as_its_worst_wire(tmp_path: Path, ratio: float, sign: str) -> None:
    sharp = WireQuality(40.0, 0.97, np.array([1e-3, 1.1e-3]), np.array([0.0, 1e-4, 0.0]), 0.02, np.eye(5), 1e-4)
    worst = WireQuality(20.0, ratio, np.array([1e-3, 2.5e-3]), np.zeros(3), 0.02, np.eye(5), 1e-4)
    volume = Volume(np.zeros((8, 8, 8), dtype=np.float32), 1e-3, np.eye(3))
    facts = {"Geometry": "nominal geometry"}
    page = reconstructed_page(CARM, volume, {"wire x": sharp, "wire y": worst}, (Path("scan"), Path("out")), facts)
    write_page(page, tmp_path / "a.html")
    assert page_verdict(tmp_path / "a.html").startswith(sign)
    assert f"{ratio:.2f} of what they have" in page_verdict(tmp_path / "a.html")
    assert "wire y 20.0" in page_text(tmp_path / "a.html")


def test_deviations_are_drawn_in_the_order_of_what_they_are_drawn_over_with_two_standard_deviations() -> None:
    values = np.array([[3e-3, 0.3], [1e-3, 0.1], [2e-3, 0.2]])
    covariance = np.tile(np.diag([1e-8, 1e-6]), (3, 1, 1))
    charts = deviation_charts(np.array([3.0, 1.0, 2.0]), "roll [°]", {"found": (values, covariance)}, ("source_u", "angle"), ("mm", "mrad"))
    first, _ = charts.cells
    assert first.series[0].y == pytest.approx([1.0, 2.0, 3.0])
    assert first.bands[0].high - first.bands[0].low == pytest.approx([0.4] * 3)
    assert first.y.label == "deviation in source u [mm]"
    table = deviation_table(values, np.sqrt(np.einsum("nii->ni", covariance)), ("source_u", "angle"), ("mm", "mrad"))
    assert table.rows[0] == ("source_u", "1.000", "3.000", "0.100", "mm")
