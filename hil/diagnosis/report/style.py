"""What the report's drawings have in common."""

from __future__ import annotations

ORANGE, SKY, GREEN, VERMILION = "#E69F00", "#56B4E9", "#009E73", "#D55E00"
"""Of Okabe and Ito's palette: told apart by colour-blind readers and in grey."""

STAGE_NAMES = {"nominal": "nominal", "retuned": "re-tuned", "extended": "with the effects"}
