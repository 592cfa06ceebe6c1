"""All that the results page shows, in its order."""

from __future__ import annotations

from docs.generate.shown.calibration import CALIBRATION
from docs.generate.shown.diagnosis import DIAGNOSIS
from docs.generate.shown.faults import FAULTS
from docs.generate.shown.fleet import FLEET
from docs.generate.shown.identification import IDENTIFICATION
from docs.generate.shown.imaging import IMAGING
from docs.generate.shown.observer import OBSERVER
from docs.generate.shown.shaping import SHAPING
from docs.generate.shown.timing import TIMING

SHOWN = (
    *DIAGNOSIS,
    *FAULTS,
    *FLEET,
    *TIMING,
    *OBSERVER,
    *SHAPING,
    *IDENTIFICATION,
    *IMAGING,
    *CALIBRATION,
)

PROOF = "concealed/scores_sealed.json"
PROOF_COMMAND = "python benchmarks/concealed all --results DIR --work WORK"
PROOF_TEXT = """
Machines with concealed physics, simulated by code that shares nothing with the diagnosis. [The proof](../explanation/proof.md) says
how they are drawn and judged.

A *null* hides nothing. The *oracle* is a fit that knows what is hidden; it *separates* an effect whose name may be asked for.
*Confident* is the verdict `explained`. A law off the catalogue is *spanned* where an effect of the catalogue imitates it, in the
strength that was drawn. The column *of* holds what was counted, and how many there were.
"""
