"""How far the evidence goes when nothing changes, and so from where on it is said: false alarms at a stated rate."""

from __future__ import annotations

import functools

import numpy as np
from scipy.stats import norm

from hil.fleet.change.bank import CUT, Bank
from hil.fleet.change.scatter_model import FleetModel

YEAR = 365
STATED_PER_MACHINE_YEAR = 0.01
"""False alarms a machine and year, over all of its parameters."""

SPENT = 0.5
"""Share of the stated rate at which drawn tracks pass; the other half is for what a fleet's scatter does that its model does not know."""

SETTLING = 14
"""Nights from which a fleet's scatter is learned, and before which nothing is said."""

TRACKS, SEED = 4000, 20260101
"""Sound tracks of a year that are drawn: 4000 years of one parameter."""

TAIL = np.linspace(3.9, 4.5, 7)
"""Evidence at which first crossings are counted; the tail beyond has the form of `tail`, of which these counts give the size."""


@functools.lru_cache(maxsize=32)
def threshold(parameters: int, bad_nights: float, per_machine_year: float = STATED_PER_MACHINE_YEAR) -> float:
    """Return the evidence [standard deviations] that sound machines pass at the stated rate.

    Sound tracks of independent nights are drawn, a share of them bad by any amount, and go through the bank. The rate of first crossings
    of h a track-year is fitted by A h exp(-h^2/2), the form of Siegmund and Venkatraman 1995 (Ann. Stat. 23(1), Theorem 1), and each of
    the machine's parameters is given an equal share of `SPENT`.

    Parameters
    ----------
    parameters : int
        Of a machine.
    bad_nights : float
        Share of results farther out than noise explains.
    per_machine_year : float
        False alarms over all parameters.
    """
    size = tail_size(float(np.ceil(100.0 * bad_nights - 1e-6)) / 100.0)  # in whole per cent, so that fleets share what is drawn
    target = SPENT * per_machine_year / parameters
    low, high = 3.0, 12.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if size * tail(middle) > target else (low, middle)
    return high


def tail(h: float | np.ndarray) -> np.ndarray:
    """Return the form of the rate at which h is crossed."""
    return np.asarray(h * np.exp(-0.5 * np.square(h)))


@functools.lru_cache(maxsize=8)
def tail_size(bad_nights: float) -> float:
    """Return A of the rate A h exp(-h^2/2) a track-year, by simulation."""
    rates = crossing_rates(TAIL, bad_nights, TRACKS, SEED)
    return float(np.mean(rates / tail(TAIL))) if rates.any() else np.inf


def crossing_rates(levels: np.ndarray, bad_nights: float, tracks: int, seed: int) -> np.ndarray:
    """Return how often a year the evidence of a sound track first passes each level.

    Parameters
    ----------
    levels : (L,) array
    bad_nights : float
    tracks : int
        Of a year each.
    seed : int
    """
    random = np.random.default_rng(seed)
    one = np.ones(1)
    model = FleetModel(one, np.eye(1), np.eye(1), one, 0.0 * one, 0.0 * one, 0.0 * one, 10.0 * one, bad_nights)
    highest = np.zeros(tracks)
    for start in range(0, tracks, 1000):
        part = min(1000, tracks - start)
        bank = Bank(part, model)
        nobody = np.zeros((part, 1), dtype=bool)
        for day in range(YEAR + SETTLING):
            u = random.standard_normal((part, 1))
            u += np.where(random.random((part, 1)) < bad_nights, 10.0 * CUT * random.choice([-1.0, 1.0], (part, 1)), 0.0)
            most = bank.night(day, u, np.zeros((part, 1)), nobody, nobody[:, 0], False)
            if day >= SETTLING:
                np.maximum(highest[start : start + part], most[:, 0], out=highest[start : start + part])
    passed = (highest[:, None] > levels).mean(axis=0)
    return np.asarray(-np.log1p(-np.minimum(passed, 1.0 - 1.0 / tracks)))  # of a constant rate, by the share of years without a crossing


def step_rate(h: float, shortest: float, longest: float) -> float:
    """Return how often a night a known level's evidence for a step, tried at lengths from `shortest` to `longest`, passes h.

    Siegmund and Venkatraman 1995, Theorem 1: h phi(h) times the integral of x nu(x)^2 between h / sqrt(longest) and h / sqrt(shortest),
    for both signs.
    """
    x = np.linspace(h / np.sqrt(longest), h / np.sqrt(shortest), 2000)
    nu = (2.0 / x) * (norm.cdf(x / 2.0) - 0.5) / (x / 2.0 * norm.cdf(x / 2.0) + norm.pdf(x / 2.0))
    return float(h * norm.pdf(h) * np.trapezoid(x * nu**2, x))
