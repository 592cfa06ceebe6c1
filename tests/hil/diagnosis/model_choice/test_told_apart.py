"""When a rival counts as told apart: drawn noise whose agreement is known, and the arithmetic of evidence."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.diagnosis.model_choice.alternatives import Alternative
from hil.diagnosis.model_choice.cross_validation import STEADY, agreement_in
from hil.diagnosis.verdict.findings import rivals_of
from virtual_bus.settings import EffectSetting

ROWS = 6000
SIZE = 400.0  # of what separates two sets, in the noise's squares: twenty standard deviations
DRY = EffectSetting("coulomb_friction", "carriage", {"Fc": 1.0})


def drawn(repeats: int, loud: float = 0.0) -> tuple[list[np.ndarray], list[np.ndarray], list[list[np.ndarray]]]:
    """What the truth leaves of the mean, what a set without the effect leaves, and what repeats differ by; `loud` acts in one repeat."""
    rng = np.random.default_rng(repeats)
    shape = np.sin(np.arange(ROWS) / 40.0)
    change = math.sqrt(SIZE) * shape / np.linalg.norm(shape)
    each = math.sqrt(repeats) * rng.normal(size=(repeats, ROWS))
    each[0] += repeats * loud * change
    mean = each.mean(axis=0)
    return [mean - loud * change], [mean + (1.0 - loud) * change], [[one - mean for one in each]]


@pytest.mark.parametrize("repeats", [3, 4, 8])
def test_what_all_repeats_share_is_as_large_as_it_is_whichever_set_is_the_answer(repeats: int) -> None:
    with_it, without, differ = drawn(repeats)
    found = agreement_in(without, with_it, differ)
    assert found == pytest.approx(math.sqrt(SIZE), rel=0.5)
    assert agreement_in(with_it, without, differ) == pytest.approx(found)


def test_what_one_repeat_alone_says_is_no_agreement() -> None:
    assert agreement_in(*drawn(3, loud=1.0)) < STEADY


def rival(behind: float, leaves: float, agreement: float, allowed: float = 0.0, held_out: float = 0.0) -> Alternative:
    stands_for = (EffectSetting("stribeck_friction", "carriage", {}),)
    return Alternative(stands_for, behind, (0,), True, 0.0, 3, allowed, leaves, agreement, held_out=held_out)


def test_only_what_repeats_do_not_agree_in_is_taken_back() -> None:
    assert rival(50.0, 40.0, 5.0).told_apart == 50.0
    assert rival(50.0, 40.0, 2.0).told_apart == pytest.approx(50.0 - 40.0 + 4.0)
    assert rival(36.0, 0.0, 0.0).told_apart == 36.0  # numbers that had to move far against their prior
    assert rival(-480.0, -500.0, 20.0).told_apart == -480.0
    assert rival(-480.0, -500.0, 1.0).told_apart == pytest.approx(20.0 - 1.0)


def test_held_out_recordings_bring_a_rival_nearer_and_take_it_no_farther() -> None:
    assert rival(50.0, 50.0, 9.0, held_out=-40.0).told_apart == 10.0
    assert rival(50.0, 50.0, 9.0, held_out=40.0).told_apart == 50.0
    assert rival(3.0, 3.0, 9.0, allowed=5.0, held_out=-0.01).told_apart == 0.0  # chance makes nothing likelier


def test_a_variant_is_a_rival_where_it_is_likelier_or_was_given_up() -> None:
    behind, likelier = rival(16.0, -2.0, 9.0), rival(-5.0, -25.0, 9.0)
    assert rivals_of((DRY,), [behind, likelier]) == [likelier]
    assert rivals_of((DRY,), [behind, likelier], frozenset({("stribeck_friction", "carriage")})) == [behind, likelier]
