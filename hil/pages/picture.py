"""What matplotlib draws, as a picture of a page."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from hil.pages.contents import Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 100


def drawn(figure: Figure, alt: str, caption: str = "") -> Picture:
    """Return a figure as a picture; `alt` says in words what it shows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    buffer = io.BytesIO()
    figure.set_dpi(DPI)
    FigureCanvasAgg(figure).print_png(buffer)  # type: ignore[no-untyped-call]  # `savefig` would draw every figure twice
    return Picture(buffer.getvalue(), alt, caption)
