"""Metadata of an experiment in a recording: one set of keys for every kind of experiment."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np


def experiment_metadata(
    kind: str,
    *,
    period_samples: int,
    settle_periods: int,
    periods: int,
    start_pose: np.ndarray,
    realisation: int = 0,
    realisations: int = 1,
    experiment: int = 0,
    experiments: int = 1,
    excited_lines: Iterable[int] = (),
    seed: int = 0,
    amplitude: Iterable[float] = (),
    crest_factor: Iterable[float] = (),
    jog: dict[str, Any] | None = None,
    odd_even_split: bool = False,
) -> dict[str, Any]:
    """Return metadata as plain values; `realisation` and `experiment` count from 0, `amplitude` (rms) and `crest_factor` are by axis."""
    rest = [0.0] * len(start_pose)
    return {
        "kind": kind,
        "period_samples": int(period_samples),
        "settle_periods": int(settle_periods),
        "periods": int(periods),
        "realisation": int(realisation),
        "realisations": int(realisations),
        "experiment": int(experiment),
        "experiments": int(experiments),
        "excited_lines": [int(line) for line in excited_lines],
        "seed": int(seed),
        "amplitude": [float(value) for value in amplitude] or rest,
        "crest_factor": [float(value) for value in crest_factor] or rest,
        "jog": jog or {},
        "start_pose": [float(value) for value in start_pose],
        "odd_even_split": bool(odd_even_split),
    }
