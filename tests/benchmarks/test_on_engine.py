"""What a benchmark maps over seeds has the same answer on the fleet's engine as in one process."""

from __future__ import annotations

import pytest
from fleet_jobs import FAILING, draw
from on_engine import LOCAL, answers, each

pytest.importorskip("distributed")
DRAWS = [{"seed": seed, "scale": 1.0 / 3.0} for seed in (5, 2, 9)]


@pytest.mark.slow
def test_draws_are_the_same_with_and_without_a_cluster_to_the_last_digit_and_in_their_order() -> None:
    here = answers(draw, DRAWS, None)
    assert [one["seed"] for one in here] == [5, 2, 9]
    assert answers(draw, DRAWS, LOCAL) == here


@pytest.mark.slow
def test_a_draw_that_fails_on_a_cluster_is_said_and_costs_no_other() -> None:
    said: list[str] = []
    draws = [{"seed": seed, "scale": 1.0} for seed in (1, FAILING, 3)]
    found = [argument["seed"] for argument, _ in each(draw, draws, LOCAL, jobs=1, named=lambda one: f"seed {one['seed']}", say=said.append)]
    assert found == [1, 3]
    assert [line for line in said if "dashboard" not in line] == [
        f"seed {FAILING}: a fault of isocenter itself: RuntimeError('this draw fails')"
    ]


def test_without_a_cluster_the_error_is_raised_where_it_is() -> None:
    with pytest.raises(RuntimeError, match="this draw fails"):
        answers(draw, [{"seed": FAILING, "scale": 1.0}], None)
