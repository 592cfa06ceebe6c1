"""A sign is right or wrong: what it removes leaves no room for an equation that errs."""

from __future__ import annotations

from hil.diagnosis.ranking.naming import CONFIDENT, Weighed, weighed

ENTRIES, TRIED = 19000.0, 50


def test_what_a_whole_sign_removes_tempers_nothing_however_much_it_is():
    """A channel without its sign, a million times above noise, beside a ripple, and beside a stop that costs less and leaves 200 more."""

    def share_of_the_ripple(by_signs: float) -> float:
        exact = {"by_numbers": (1e10, 0.0), "by_signs": (by_signs, 0.0)}
        ripple = Weighed(None, ENTRIES, 0.0, (200.0,) * 4, **exact)
        stop = Weighed(None, ENTRIES + 200.0, 0.0, (200.0,), **exact)
        ranked, _ = weighed([ripple, stop], Weighed(None, ENTRIES + 1e10, 0.0), (ENTRIES, 0.0), TRIED)
        return next(r.share for r in ranked if r.misfit == ripple.misfit)

    assert share_of_the_ripple(1e10) > CONFIDENT
    assert share_of_the_ripple(0.0) < 0.5


def test_what_a_whole_sign_leaves_of_what_it_removed_is_nothing_without_a_name():
    """A ten millionth of it, which is more than noise."""

    def share_of_the_sign(by_signs: float) -> float:
        sign = Weighed(None, ENTRIES + 1000.0, 0.0, (1e10,), by_numbers=(by_signs, 0.0), by_signs=(by_signs, 0.0))
        ranked, _ = weighed([sign], Weighed(None, ENTRIES + 1e10, 0.0), (ENTRIES, 0.0), TRIED)
        return ranked[0].share

    assert share_of_the_sign(1e10) > CONFIDENT
    assert share_of_the_sign(0.0) > CONFIDENT  # another law may err by more
