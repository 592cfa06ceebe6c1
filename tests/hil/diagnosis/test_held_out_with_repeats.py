"""Held-out recordings may take assurance away from an answer by repeats: an effect that does not help them is not explained."""

from __future__ import annotations

from carriage import MACHINE, repeats

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.verdict.answer import NO_HELP

FRICTION_N = 3.0


def test_an_effect_that_held_out_recordings_have_not_is_ambiguous_and_one_that_they_have_is_explained() -> None:
    train = repeats(3, seed=31, coulomb_N=FRICTION_N)
    for coulomb_N, verdict in ((0.0, "ambiguous"), (FRICTION_N, "explained")):
        found = diagnose(MACHINE, train, repeats(1, seed=32, experiment=1, coulomb_N=coulomb_N)).diagnosis
        assert [str(finding.effect) for finding in found.findings] == ["coulomb_friction at carriage"]
        assert found.verdict == verdict, found.reason
        gained = found.hypotheses[0].gained_held_out
        assert gained is not None
        assert (gained > 0.0) is (verdict == "explained")
        assert (NO_HELP in found.findings[0].evidence_against) is (verdict == "ambiguous")
