"""How far every stage of an answer is from the recordings, and whether it helps to predict those held out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from hil.diagnosis.prediction.open_runs import Predicted
from hil.diagnosis.result import Fit, Stages


def helps(held: Predicted | None, than: str) -> bool | None:
    """Return whether held-out recordings are predicted better with the answer than at another stage; None without them."""
    if held is None or not held.channels:
        return None
    if held.gained is not None:
        return held.gained > 0.0
    with_it, without = (math.prod(stages[stage] for stages in held.channels.values()) for stage in ("extended", than))
    return with_it < without  # no infinite error of a simulation that ran away is less than another


def fit_of(train: Predicted | None, held: Predicted | None = None, *, has_held_out: bool) -> Fit:
    """Return how far every stage is from the recordings."""
    judged = held if has_held_out else train
    on_train = _total(train)
    on_held_out = _total(held) if has_held_out else None
    best = on_held_out or on_train
    channels = {} if judged is None else {name: _stages(table) for name, table in judged.channels.items()}
    shares = _removed(best.retuned, best.extended), _removed(best.nominal, best.extended)
    fit = Fit(channels, on_train, on_held_out, *shares)
    return fit if judged is None else replace(fit, errors_of=judged.errors_of, horizon_s=judged.horizon_s)


def _stages(table: Mapping[str, float]) -> Stages:
    kept = {name: value if math.isfinite(value) else None for name, value in table.items()}
    return Stages(kept["nominal"], kept["retuned"], kept["extended"], None, kept["noise"], kept["baseline"])


def _total(found: Predicted | None) -> Stages:
    """Return E: over channels, rms errors in units of the channel's noise."""
    if found is None:
        return Stages()
    total: dict[str, float | None] = {}
    for stage in ("nominal", "retuned", "extended", "baseline"):
        ratios = [table[stage] / table["noise"] for table in found.channels.values() if table["noise"] > 0.0]
        value = math.hypot(*ratios) / math.sqrt(len(ratios)) if ratios else math.inf
        total[stage] = value if math.isfinite(value) else None
    return Stages(total["nominal"], total["retuned"], total["extended"], None, 1.0, total["baseline"])


def _removed(before: float | None, after: float | None) -> float | None:
    if before is None or after is None or before <= 1.0:
        return None
    return float((1.0 - (after / before) ** 2) / (1.0 - before**-2.0))  # without squares of what ran away
