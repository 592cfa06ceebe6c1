"""Self-contained pages: the answer first, pictures that can be zoomed, details folded. `uplot/` is uPlot 1.6.32 (MIT), unchanged."""

from hil.pages.build import html_of, write_page
from hil.pages.chart import Band, Chart, Charts, Mark, Scale, Series
from hil.pages.contents import Bullets, Page, Picture, Section, Table, Text, Verdict

__all__ = [
    "Band",
    "Bullets",
    "Chart",
    "Charts",
    "Mark",
    "Page",
    "Picture",
    "Scale",
    "Section",
    "Series",
    "Table",
    "Text",
    "Verdict",
    "html_of",
    "write_page",
]
