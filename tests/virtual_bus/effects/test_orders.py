"""The orders over which most effort is missing, where laws of waves begin."""

from __future__ import annotations

import numpy as np
import pytest

from virtual_bus.effects.law import Place

SEED = 3


def place(position: np.ndarray, missing: np.ndarray) -> Place:
    """A joint that moved like this."""
    return Place(
        low=float(position.min()), high=float(position.max()), speed=1.0, effort=1.0, current=1.0, ratio=1.0, stiffness=0.0, inertia=1.0,
        period_s=0.001, duration_s=0.001 * len(position), is_seen_twice=False, is_prismatic=False, position=position, missing=missing,
        noise=np.zeros((0, len(position))),
    )  # fmt: skip


@pytest.mark.parametrize(("order", "per_turn"), [(1, 1.0), (72, 1.0), (144, 1.0), (12, 100.0)])
def test_the_order_of_a_wave_comes_first_and_a_weaker_one_behind(order: int, per_turn: float) -> None:
    print(f"seed {SEED}")
    position = np.cumsum(np.random.default_rng(SEED).uniform(0.0, 0.002, 20_000)) / min(per_turn, 4.0)
    weaker = order + 5
    missing = np.cos(order * per_turn * position + 1.0) + 0.5 * np.sin(weaker * per_turn * position) + 3.0
    told_apart = 2.0 * np.pi / (per_turn * float(np.ptp(position)))
    assert place(position, missing).orders(per_turn)[:2] == pytest.approx([order, weaker], abs=0.25 * told_apart)


def test_an_order_is_left_out_where_no_whole_period_is_passed() -> None:
    position = np.linspace(0.0, 0.5, 5000)  # a twelfth of a turn
    assert min(place(position, np.cos(20.0 * position)).orders()) >= 13.0
