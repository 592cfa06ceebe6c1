"""The demo's page: one self-contained HTML file with figures."""

from __future__ import annotations

import base64
import html
import io
from pathlib import Path
from string import Template

from matplotlib.figure import Figure

from hil.demo.figures import experiment_figure, friction_figure, nrmse_figure, response_figure
from hil.demo.told import Story
from hil.simulation import ChannelComparison

_TEMPLATE = Path(__file__).with_name("page.html")


def write_page(story: Story, folder: Path) -> Path:
    """Write `index.html` and its figures as PNG files; return the page's path."""
    figures = {
        "experiment": experiment_figure(story),
        "response": response_figure(story),
        "friction_figure": friction_figure(story),
        "nrmse": nrmse_figure(story),
    }
    images = {}
    for name, figure in figures.items():
        png = _png(figure)
        (folder / f"{name}.png").write_bytes(png)
        images[name] = f'<img alt="{name}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'
    page = folder / "index.html"
    page.write_text(_document(story, images), encoding="utf-8")
    return page


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def _document(story: Story, images: dict[str, str]) -> str:
    frequencies = story.response.frequencies_Hz
    values = {
        "description": html.escape(story.machine.description),
        "recorded_s": f"{story.recorded_s:.0f}",
        "rate_Hz": f"{story.machine.sample_rate_Hz:g}",
        "factor": f"{story.lockstep_factor:.0f}",
        "hash": story.machine.hash[:12],
        "lines": str(len(frequencies)),
        "band": f"{frequencies[0]:.2f} to {frequencies[-1]:.1f} Hz",
        "friction": ", ".join(f"{name} = {value:g} Nm" for name, value in story.effect.parameters.items()),
        "before": f"{story.nominal_comparison['current_roll'].nrmse:.1%}",
        "after": f"{story.friction_comparison['current_roll'].nrmse:.1%}",
        "rows": "\n".join(_row(*pair) for pair in zip(story.nominal_comparison.channels, story.friction_comparison.channels, strict=True)),
        **images,
    }
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(values)


def _row(nominal: ChannelComparison, friction: ChannelComparison) -> str:
    cells = (nominal.name, *(text for c in (nominal, friction) for text in (f"{c.rms:.3g} {c.unit}", c.nrmse_text)))
    return "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>"
