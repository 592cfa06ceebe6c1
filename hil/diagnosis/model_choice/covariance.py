"""How sure the numbers and parameters of a fit are."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.diagnosis.model_choice.fitting import Fitted
from virtual_bus.effects.registry import effects


def scattered(fitted: Fitted) -> np.ndarray:
    """Return standard deviations (P + Q,) of nuisances and parameters, by what scatters (White 1982)."""
    deviations: np.ndarray = np.sqrt(np.diag(covariance_of(fitted)))
    return deviations


def covariance_of(fitted: Fitted) -> np.ndarray:
    """Return the covariance (P + Q, P + Q) of nuisances and parameters, by what scatters."""
    squares = np.sum([each.T @ each for each in fitted.with_form], axis=0) / fitted.dispersion + np.diag(fitted.prior)
    scale = np.sqrt(np.maximum(np.diag(squares), 1e-300))
    inverse = np.linalg.pinv(squares / scale[:, None] / scale, hermitian=True)
    own = slice(len(scale) - fitted.form.count)
    covariance: np.ndarray = (inverse / scale[:, None] / scale)[own, own]
    return covariance


def away_from(fitted: Fitted, number: int, strengths: Mapping[str, float] | None = None) -> float:
    """Return how far an effect's strengths are from others, or from none of it, in squared standard deviations (Wald 1943).

    It is infinite from none where a strength that is not fitted keeps the effect acting.
    """
    own = [(k, each) for k, (of, each) in enumerate(fitted.parameters, len(fitted.offset)) if of == number and each.is_strength]
    which = [k for k, _ in own]
    values, free = fitted.settings[number].parameters, {each.name for _, each in own}
    fixed = [each for each in effects()[fitted.settings[number].name].parameters if each.is_strength and each.name not in free]
    if strengths is None and any(values[each.name] != each.neutral for each in fixed):
        return np.inf
    off = np.array([values[each.name] - (each.neutral if strengths is None else strengths[each.name]) for _, each in own])
    covariance = covariance_of(fitted)[np.ix_(which, which)]
    return float(off @ np.linalg.pinv(covariance, hermitian=True) @ off)
