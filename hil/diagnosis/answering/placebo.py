"""A change of the simulation as large as the found effects' and of their spectrum, but without their cause: theirs, backwards in time."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns

Stages = dict[str, dict[str, list[np.ndarray]]]


def add_placebo(runs: FreeRuns, stages: Stages) -> None:
    """Add "placebo" to every set: the re-tuned rows plus the effects' change run backwards, its size fitted to the training set."""
    change = _backwards(stages, TRAIN)
    whitened = runs.joined(change)
    residual = runs.measured() - runs.joined(stages[TRAIN]["retuned"])
    energy = float(whitened @ whitened)
    size = float(whitened @ residual) / energy if energy > 0.0 else 0.0
    for name in stages:
        backwards = _backwards(stages, name)
        stages[name]["placebo"] = [rows + size * moved for rows, moved in zip(stages[name]["retuned"], backwards, strict=True)]


def _backwards(stages: Stages, name: str) -> list[np.ndarray]:
    """(N, C) per group."""
    return [(extended - retuned)[::-1] for extended, retuned in zip(stages[name]["extended"], stages[name]["retuned"], strict=True)]
