"""Intervals for proportions, and how far a calibrated tool may stray."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import beta

CONFIDENCE = 0.95
BINS = 5
TAIL = (1.0 - CONFIDENCE) / BINS
DRAWS = 20000


def clopper_pearson(hits: int, n: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Exact two-sided interval for a proportion (Clopper and Pearson 1934)."""
    if n == 0:
        return 0.0, 1.0
    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, n - hits + 1))
    high = 1.0 if hits == n else float(beta.ppf(1.0 - tail, hits + 1, n - hits))
    return low, high


def upper_bound(hits: int, n: int, confidence: float = CONFIDENCE) -> float:
    """Exact one-sided upper bound."""
    return 1.0 if n == 0 or hits == n else float(beta.ppf(confidence, hits + 1, n - hits))


def calibration(confidences: Sequence[float], right: Sequence[bool], seed: int = 0) -> list[dict[str, float | bool]]:
    """Five equal-count bins: mean confidence, share right, and the band that all bins of a tool whose confidences are true stay in together
    in 95 % of benchmarks (Bonferroni)."""
    order = np.argsort(confidences, kind="stable")
    said, was = np.asarray(confidences, dtype=float)[order], np.asarray(right, dtype=float)[order]
    rng = np.random.default_rng(seed)
    bins = []
    for part in np.array_split(np.arange(len(said)), BINS):
        if len(part) == 0:
            continue
        drawn = (rng.random((DRAWS, len(part))) < said[part]).mean(axis=1)
        low, high = np.quantile(drawn, [0.5 * TAIL, 1.0 - 0.5 * TAIL])
        share = float(was[part].mean())
        bins.append(
            {
                "confidence": float(said[part].mean()),
                "right": share,
                "low": float(low),
                "high": float(high),
                "n": len(part),
                "inside": bool(low <= share <= high),
            }
        )
    return bins
