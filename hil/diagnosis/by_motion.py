"""A diagnosis along the recorded motion: efforts in, motions out, no controller in between. docs/explanation/diagnosis.md follows it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from hil.diagnosis.answered.answer import Answered, answer, first_answer, nothing_seen, play_seen
from hil.diagnosis.answering.verdict import FAINT_GAIN, NULLS_LEFT
from hil.diagnosis.audit.audit import Audit
from hil.diagnosis.named.fitting import Fitted, fit
from hil.diagnosis.named.naming import Named, name
from hil.diagnosis.observed.groups import groups
from hil.diagnosis.result import Diagnosis, EffectAt, Hypothesis
from hil.diagnosis.seen.see import see
from hil.errors import BenchError
from hil.machine import Machine
from hil.recording import Recording
from virtual_bus.errors import EmulatorError

EVEN = 0.5
"""Share of a confidence that is left where two ways of equal standing say different things."""


def diagnose_along(
    machine: Machine,
    recordings: Mapping[str, Recording],
    held_out: Mapping[str, Recording],
    audit: Audit,
    report: Callable[[str, float], None] = lambda what, share: None,
    first: Callable[[Diagnosis], None] = lambda diagnosis: None,
) -> Answered:
    """Diagnose a machine along its recorded motion.

    Parameters
    ----------
    machine : Machine
        The simulation.
    recordings, held_out : mapping of str to Recording
        By name; held-out ones are scored and decide nothing.
    audit : Audit
        Of the recordings that are fitted to.
    report : callable, optional
        Told what is being done, and the share of the whole that is done.
    first : callable, optional
        Told a first answer as soon as there is one.

    Raises
    ------
    RecordingError
        Recordings that cannot be used.
    """
    began = time.monotonic()
    report("reading the motion", 0.0)
    seen = see(machine, recordings)
    if seen.is_still:
        return nothing_seen(machine, audit, seen, time.monotonic() - began)
    if audit.has_play:
        return play_seen(machine, audit, seen, time.monotonic() - began)

    def say(baseline: Fitted) -> None:
        first(first_answer(machine, audit, seen, baseline, time.monotonic() - began))

    named = name(seen, report, say)
    report("weighing rivals", 0.9)
    return answer(machine, audit, named, held_out, began)


def with_second_opinion(machine: Machine, recordings: Mapping[str, Recording], diagnosis: Diagnosis) -> Diagnosis:
    """Return an answer by free runs, less sure where another set of effects explains the recorded motion down to its noise.

    A set that is part of the answer's is no other one, and an effect that gains little is no part of a set.
    """
    if diagnosis.verdict not in ("explained", "ambiguous") or not diagnosis.findings:
        return diagnosis
    try:
        seen = see(machine, recordings)
        if seen.levels.are_assumed:
            return diagnosis
        named = name(seen)
    except (BenchError, EmulatorError, np.linalg.LinAlgError):
        return diagnosis
    best = named.best
    other = tuple(EffectAt(one.name, one.at) for k, one in enumerate(best.settings) if _gain(named, k) > FAINT_GAIN)
    own = tuple(finding.effect for finding in diagnosis.findings)
    if best.squares > (1.0 + NULLS_LEFT) * named.tuned.readings or set(other) <= set(own):
        return diagnosis
    said = " and ".join(map(str, other))
    findings = tuple(
        replace(
            finding,
            confidence=finding.confidence if finding.effect in other else EVEN * finding.confidence,
            ambiguous_with=tuple(dict.fromkeys((*finding.ambiguous_with, *(one for one in other if one not in own)))),
            ambiguous_sets=finding.ambiguous_sets if finding.effect in other else (*finding.ambiguous_sets, other),
            evidence_against=(*finding.evidence_against, f"{said} explains the recorded motion down to its noise"),
        )
        for finding in diagnosis.findings
    )
    listed = [h for h in diagnosis.hypotheses if set(h.effects) != set(other)]
    first = max((h.confidence for h in listed), default=1.0)
    hypotheses = [replace(h, confidence=EVEN * h.confidence) for h in listed]
    hypotheses.append(Hypothesis(other, EVEN * first, parameters=len(best.parameters)))
    return replace(
        diagnosis,
        verdict="ambiguous",
        reason=f"{diagnosis.reason}; along the recorded motion {said} explains as much",
        findings=findings,
        hypotheses=tuple(sorted(hypotheses, key=lambda h: -h.confidence)),
    )


def _gain(named: Named, number: int) -> float:
    """Return by how much one effect of the answer lowers the squares beside the others, everything fitted again."""
    best = named.best
    without = fit(named.tuned, (*best.settings[:number], *best.settings[number + 1 :]), best.offset, best.dispersion)
    return math.inf if without is None else without.cost(best.dispersion) - best.cost(best.dispersion)


def is_along_the_motion(machine: Machine, recordings: Mapping[str, Recording], audit: Audit) -> bool:
    """Return whether recordings are diagnosed along their motion, and not by free runs of the closed loop.

    They are where no free run of the loop would be the machine's: its controllers are not the file's, or are not known; or where nothing
    repeats, so that a free run cannot be told from noise, and every joint has an encoder, without which disturbances of a joint are not
    seen. Play that encoders show is read off.
    """
    recorded = {channel for recording in recordings.values() for channel in recording.channels}
    followed = {encoder.joints[0] for encoder in machine.plant.encoders if len(encoder.joints) == 1 and encoder.channel in recorded}
    if not followed:  # by an IMU alone no motion is known
        return False
    if audit.has_play or audit.wrong or not audit.are_controllers_as_filed:
        return True
    if any(joint.name not in followed for joint in machine.plant.tree.joints):
        return False
    has_periods = any(recording.experiment.get("period_samples") for recording in recordings.values())
    return not has_periods and all(len(group.repeats) == 1 for group in groups(machine, recordings))
