"""Pages in a browser: charts zoom together, by mouse and keys, show every extreme however far out, and fit a narrow screen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from browser import WIDTHS

from hil.pages import Band, Chart, Charts, Mark, Page, Scale, Section, Series, Table, Verdict, write_page

if TYPE_CHECKING:
    from playwright.sync_api import Page as Tab

ROWS, RATE_Hz = 100_000, 1000.0
SPIKE = 54_321
TIME_s = np.arange(ROWS) / RATE_Hz
QUIET = np.sin(0.5 * TIME_s)
SPIKED = QUIET + 9.0 * (np.arange(ROWS) == SPIKE)
FREQUENCY_Hz = np.geomspace(0.1, 100.0, 300)
ENDS = "i => { const s = document.querySelectorAll('figure.chart')[i].chart.u.scales.x; return [s.min, s.max]; }"
ROWS_SHOWN = "([i, k]) => document.querySelectorAll('figure.chart')[i].chart.u.data[k]"


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> str:
    wave = Chart("Wave", Scale("time [s]"), Scale("wave [m]"), [Series("recorded", TIME_s, SPIKED)], group="time")
    other = Chart(
        "Two recordings",
        Scale("time [s]"),
        Scale("wave [m]"),
        [Series("first", TIME_s, QUIET), Series("second", TIME_s[:500] * 7.0, QUIET[:500])],
        bands=[Band("noise", TIME_s, QUIET - 0.1, QUIET + 0.1)],
        group="time",
    )
    response = Chart(
        "Response",
        Scale("frequency [Hz]", is_log=True),
        Scale("|G| [m/A]", is_log=True),
        [Series("|G|", FREQUENCY_Hz, 1.0 / FREQUENCY_Hz), Series("noise", FREQUENCY_Hz[::9], 0.01 / FREQUENCY_Hz[::9], is_points=True)],
        marks=[Mark(8.0, "8 Hz, damping 0.02")],
        group="frequency",
    )
    wide = Table([f"column {k}" for k in range(5)], [["a_name_without_a_gap"] * 5])
    many = Table([f"column {k}" for k in range(20)], [[f"value {k}" for k in range(20)]])
    sections = [
        Section("Time", [Charts([(wave, other)])]),
        Section("Frequency", [Charts([response])], is_folded=True),
        Section("T", [wide, many]),
    ]
    path = tmp_path_factory.mktemp("pages") / "page.html"
    write_page(Page("Trial", Verdict("All is well.", "good"), sections, "isocenter plot run.mf4 -o run.html"), Path(path))
    return path.as_uri()


def opened(page: Tab, url: str) -> None:
    page.goto(url)
    page.wait_for_selector("html[data-drawn]", state="attached")


def test_a_drag_across_one_chart_zooms_all_of_its_group_and_a_double_click_shows_all(page: Tab, url: str) -> None:
    opened(page, url)
    assert page.evaluate(ENDS, 0) == pytest.approx([0.0, TIME_s[-1]])
    box = page.locator("figure.chart .u-over").first.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.50 * box["width"], box["y"] + 50, steps=3)
    page.mouse.up()
    for chart in (0, 1):
        assert page.evaluate(ENDS, chart) == pytest.approx([25.0, 50.0], abs=0.3)
    page.mouse.dblclick(box["x"] + 60, box["y"] + 40)
    assert page.evaluate(ENDS, 1) == pytest.approx([0.0, TIME_s[-1]])


def test_a_single_row_is_seen_from_afar_and_every_row_from_near(page: Tab, url: str) -> None:
    opened(page, url)
    from_afar = page.evaluate(ROWS_SHOWN, [0, 1])
    assert len(from_afar) < 4 * WIDTHS["wide"]
    assert max(from_afar) == pytest.approx(SPIKED.max(), abs=1e-5)
    assert min(from_afar) == pytest.approx(SPIKED.min(), abs=1e-5)
    for _ in range(8):
        page.get_by_role("button", name="Zoom in").click()
    low, high = page.evaluate(ENDS, 0)
    times, rows = page.evaluate(ROWS_SHOWN, [0, 0]), page.evaluate(ROWS_SHOWN, [0, 1])
    inside = (TIME_s >= low) & (TIME_s <= high)
    kept = [k for k, time in enumerate(times) if low <= time <= high]
    assert 100 < inside.sum() < 1000
    assert np.allclose(np.array(rows)[kept], SPIKED[inside], atol=1e-5)


def test_keys_do_what_the_mouse_does(page: Tab, url: str) -> None:
    opened(page, url)
    page.locator("figure.chart").first.focus()
    page.keyboard.press("+")
    assert page.evaluate(ENDS, 1) == pytest.approx([25.0, 75.0], abs=0.1)
    page.keyboard.press("Shift+ArrowRight")
    assert page.evaluate(ENDS, 1) == pytest.approx([37.5, 87.5], abs=0.1)
    page.keyboard.press("ArrowRight")
    page.wait_for_function("document.querySelector('figure.chart .at').textContent.startsWith('at ')")
    value = page.locator("figure.chart .legend button output").first.inner_text()
    assert -1.1 < float(value) < 1.1
    page.keyboard.press("0")
    assert page.evaluate(ENDS, 0) == pytest.approx([0.0, TIME_s[-1]])


def test_a_curve_is_taken_away_by_its_name_in_the_legend(page: Tab, url: str) -> None:
    opened(page, url)
    second = page.get_by_role("button", name="second")
    second.press("Enter")
    assert second.get_attribute("aria-pressed") == "false"
    assert page.evaluate("document.querySelectorAll('figure.chart')[1].chart.u.series[2].show") is False


def test_what_is_folded_is_drawn_when_opened_and_for_the_printer(page: Tab, url: str) -> None:
    opened(page, url)
    folded = page.locator("details figure.chart")
    assert folded.locator("canvas").count() == 0
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    folded.locator("canvas").wait_for()
    low, high = page.evaluate(ENDS, 2)
    assert (low, high) == pytest.approx((0.1, 100.0))


def test_a_narrow_screen_shows_the_verdict_at_once_and_never_scrolls_sideways(page: Tab, url: str) -> None:
    page.set_viewport_size({"width": WIDTHS["narrow"], "height": 800})
    opened(page, url)
    assert page.evaluate("document.documentElement.scrollWidth") <= WIDTHS["narrow"]
    assert page.get_by_text("value 19").is_visible()
    verdict, command = page.locator(".verdict").bounding_box(), page.locator(".next").bounding_box()
    assert verdict is not None
    assert command is not None
    assert command["y"] + command["height"] < 400
    drawn = page.locator("figure.chart .uplot").first.bounding_box()
    assert drawn is not None
    assert 300 < drawn["width"] <= WIDTHS["narrow"]
