"""Self-contained pages: the answer first, pictures that can be zoomed, details folded. `uplot/` is uPlot 1.6.32 (MIT), unchanged."""
