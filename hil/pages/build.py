"""A page's contents as one self-contained HTML file."""

from __future__ import annotations

import base64
import datetime
from pathlib import Path
from typing import Any

from hil.errors import UnusableInputError
from hil.pages.chart import Chart, Charts
from hil.pages.contents import Bullets, Page, Picture, Table, Text
from hil.pages.packed import Packed
from hil.version import software_version

HERE = Path(__file__).parent
NAMES = {Text: "text", Bullets: "bullets", Table: "table", Picture: "picture", Charts: "charts"}
"""How the template tells blocks apart."""

WORDS = {"good": ("✓", "good"), "bad": ("✗", "bad"), "unsure": ("?", "not sure"), "plain": ("", "")}
"""Sign and word of each kind of verdict: colour is never the only difference."""


def write_page(page: Page, path: Path) -> Path:
    """Write a page and return its path.

    Raises
    ------
    UnusableInputError
        The file cannot be written.
    """
    text = html_of(page)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(f"{path}: cannot be written: {error.strerror or error}") from None
    return path


def html_of(page: Page, made: str = "") -> str:
    """Return the page's text.

    Parameters
    ----------
    page : Page
    made : str, optional
        When it was made; now unless given.
    """
    import jinja2  # a tenth of a second that only pages need
    from markupsafe import Markup

    packed = Packed()
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode()
    has_charts = any(isinstance(block, Charts) for section in page.sections for block in section.blocks)

    def shipped(name: str) -> Markup:
        return Markup((HERE / name).read_text(encoding="utf-8"))

    template = environment.get_template("page.html")
    made = made or datetime.datetime.now().astimezone().isoformat(sep=" ", timespec="minutes")
    return template.render(
        page=page,
        sections=[
            {"title": section.title, "is_folded": section.is_folded, "blocks": [_block(block, packed) for block in section.blocks]}
            for section in page.sections
        ],
        facts={**page.facts, "Made": f"{made} by {software_version()}"},
        words=WORDS,
        packed={"arrays": packed.arrays, "charts": packed.charts},
        has_charts=has_charts,
        style=shipped("style.css"),
        chart_style=shipped("uplot/uPlot.min.css") if has_charts else "",
        scripts=[shipped("uplot/uPlot.iife.min.js"), shipped("charts.js")] if has_charts else [],
    )


def _block(block: object, packed: Packed) -> dict[str, Any]:
    """Return a block with its name, charts with their numbers and legends."""
    named: dict[str, Any] = {"name": NAMES[type(block)], "is": block}
    if isinstance(block, Charts):
        named["stacks"] = [[_chart(chart, packed) for chart in stack] for stack in block.stacks()]
    return named


def _chart(chart: Chart, packed: Packed) -> dict[str, Any]:
    legend = [{"label": one.label, **style._asdict()} for one, style in zip(chart.series, chart.styles(), strict=True)]
    return {"is": chart, "number": packed.add(chart), "legend": legend, "bands": [band.label for band in chart.bands]}
