"""The machine's numbers beside a channel that reads the wrong way: there they move it the other way."""

from __future__ import annotations

from dataclasses import replace

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning, linearised
from virtual_bus.effects.effect import SIGN
from virtual_bus.effects.registry import effects


def tuning_at(runs: FreeRuns, tuning: Tuning, fitted: Fitted) -> Tuning:
    """The numbers where a set's fit ended, with their sensitivities taken there where one of its effects is a sign."""
    at = replace(tuning, offset=fitted.offset, values=tuning.at(fitted.offset), predicted=fitted.predicted)
    return linearised(runs, at, fitted.settings) if _has_a_sign(fitted) else at


def _has_a_sign(fitted: Fitted) -> bool:
    return any(effects()[effect.effect].kind is SIGN for effect in fitted.effects)
