"""Starts by the matched filter: the residual goes back through the linear loop once, for waves over position or time and for modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.starting.filtered_lines import line_starts
from hil.diagnosis.starting.filtered_modes import mode_starts
from hil.diagnosis.starting.filtered_orders import order_starts
from hil.diagnosis.starting.motion import Motion
from hil.diagnosis.starting.start_waves import FIRST_AND_SECOND
from hil.diagnosis.starting.through_the_loop import ThroughTheLoop
from hil.diagnosis.tuning.projection import Projection

STARTS = {**dict.fromkeys(FIRST_AND_SECOND, order_starts), "base_motion": line_starts, "structural_mode": mode_starts}
"""Of every effect that is a wave, or swings."""


def with_filtered_starts(
    loop: ThroughTheLoop, found: Sequence[Candidate], motions: Sequence[Motion], residual: np.ndarray
) -> list[Candidate]:
    """Candidates whose waves and modes start, before all else, at the orders and frequencies that the matched filter finds.

    Parameters
    ----------
    loop : ThroughTheLoop
        Of the training groups, without effects.
    found : sequence of Candidate
    motions : sequence of Motion
        Of every training group, beside what was found.
    residual : (M,) array
        Of the training groups there.
    """
    if not any(candidate.effect.effect in STARTS for candidate in found):
        return list(found)
    left = Projection.of(loop.tuning).left_of_residual(residual)
    behind = loop.efforts_behind(left[: len(residual)])

    def starts(candidate: Candidate) -> tuple[np.ndarray, ...]:
        of_effect = STARTS.get(candidate.effect.effect)
        return () if of_effect is None else tuple(of_effect(loop, loop.tuning, candidate, motions, behind, left))

    filtered = loop.runs.at_once(starts, found)
    return [replace(candidate, starts=(*first, *candidate.starts)) for candidate, first in zip(found, filtered, strict=True)]
