"""The whole diagnosis, from recordings to the answer: docs/explanation/diagnosis.md follows this file."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hil.diagnosis.answering.drift import chance_of_drift
from hil.diagnosis.answering.estimates import believed, effect_estimates, retuned_values
from hil.diagnosis.answering.held_out_alone import OnlyHeldOut, only_held_out
from hil.diagnosis.answering.hypotheses import against_held_out, hypothesis_of, predicted, read_off_findings, rivals_of
from hil.diagnosis.answering.misfit import channel_stages, total_stages
from hil.diagnosis.answering.placebo import add_placebo
from hil.diagnosis.answering.spread import spread_of
from hil.diagnosis.answering.sufficiency import what_is_missing
from hil.diagnosis.answering.suspicions import suspicions
from hil.diagnosis.answering.verdict import Standing, findings_of, only_there, verdict_of, what_may_act_too, with_read_off
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.errors_of_laws import erring
from hil.diagnosis.judging.held_out import HeldOut
from hil.diagnosis.locating.disturbance import disturbance_shares
from hil.diagnosis.locating.location import locate, locate_outcome
from hil.diagnosis.observed.known import known_effects
from hil.diagnosis.observed.shaken import what_may_hide
from hil.diagnosis.ranking.both_motions import with_both_motions
from hil.diagnosis.ranking.naming import (
    CAP_UNCONFIRMED,
    LIKELIER,
    Evidence,
    Weighed,
    confidence_of,
    imitated,
    ranking,
    standing_alone,
    tempers_of,
)
from hil.diagnosis.ranking.weighing import cap_of, evidence_of, plausible_among, with_unsure
from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.excess import certain_excess
from hil.diagnosis.residuals.mismatch import Mismatch, mismatch
from hil.diagnosis.result import Diagnosis, DisturbanceShares, EffectAt, Finding, Fit
from hil.diagnosis.searching.bounded_noise import candidates_for, with_bounded_noise
from hil.diagnosis.searching.selection import Selection, select
from hil.diagnosis.searching.step_error import with_finer_steps
from hil.diagnosis.searching.without_effects import without_effects
from hil.diagnosis.separating.next_experiment import Proposal, propose
from hil.diagnosis.separating.separation import Model
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import Tuning, retune
from hil.machine import Machine
from hil.recording import Recording
from virtual_bus.settings import EffectSetting

Report = Callable[[str, float], None]
NEXT_EXPERIMENT = "next_experiment.toml"
"""File in the answer's folder."""

NOTHING_SHOWS = ("consistent", "retuned")
"""Verdicts beside which something that was not shaken may hide."""

SAYS_WHAT_IT_IS = ("explained", "ambiguous", "retuned")
"""Verdicts whose simulation is offered as the machine's."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """The answer and what it was made from, for files and pages.

    Attributes
    ----------
    diagnosis : Diagnosis
    effects : tuple of EffectSetting
        Found, with their fitted parameters.
    values : (parameters,) array
        Plant parameters, re-tuned together with the effects.
    tuning : Tuning
        Without effects.
    train, held_out : Mismatch
        Beside the nominal simulation; held_out is None where none was given.
    stages : mapping of str to mapping of str to list of (N, C) arrays
        "train" and "held_out": simulated rows per group at "nominal", "retuned" and "extended", "without_effects", the extended one's
        numbers without its effects, and `first_effects(1)` and so on, with the first of several.
    selection : Selection
    evidence : Evidence
        What `hypotheses` were weighed from.
    hypotheses : tuple of Weighed
    proposal : Proposal or None
        The experiment that would tell an ambiguous verdict's hypotheses apart.
    chosen : Fitted or None
        The set that the extended simulation has; what was read off the recordings is not in it.
    short : Mismatch
        Training beside the re-tuned simulation, whose equations are short; where held-out recordings alone show that physics is missing,
        these beside the machine that is re-tuned to them alone.
    short_values : (parameters,) array
        Plant parameters of that simulation.
    is_only_held_out : bool
        Which of both.
    """

    diagnosis: Diagnosis
    effects: tuple[EffectSetting, ...]
    values: np.ndarray
    tuning: Tuning
    train: Mismatch
    held_out: Mismatch | None
    stages: Mapping[str, Mapping[str, list[np.ndarray]]]
    selection: Selection
    evidence: Evidence
    hypotheses: tuple[Weighed, ...]
    proposal: Proposal | None
    chosen: Fitted | None
    short: Mismatch
    short_values: np.ndarray
    is_only_held_out: bool

    @property
    def simulated(self) -> tuple[EffectAt, ...]:
        """Effects of the extended simulation."""
        return () if self.chosen is None else self.chosen.effects


def diagnose(
    machine: Machine,
    recordings: Mapping[str, Recording],
    held_out: Mapping[str, Recording] | None = None,
    *,
    jobs: int = 1,
    report: Report = lambda what, share: None,
    look_further: bool = True,
) -> Outcome:
    """Diagnose a machine from its recordings.

    Parameters
    ----------
    machine : Machine
        The simulation.
    recordings, held_out : mapping of str to Recording
        By name; held-out ones are fitted to by nothing.
    jobs : int
        Threads of simulations.
    report : callable
        Told what is being done, and the share of the whole that is done.
    look_further : bool
        Whether to look for the experiment that would tell an ambiguous verdict's hypotheses apart.

    Raises
    ------
    RecordingError
        Recordings that cannot be simulated or have no channel in common with the simulation.
    BadAnswerError
        The nominal machine cannot be simulated.
    """
    began = time.monotonic()
    report = _never_back(report)
    report("simulating", 0.0)
    train = with_bounded_noise(mismatch(machine, aligned(machine, recordings)), jobs, report)
    sets = {TRAIN: train}
    if held_out:
        sets[HELD_OUT] = mismatch(machine, aligned(machine, held_out), channels=train.channels, noise=train.noise)
    with FreeRuns(sets, train.noise, jobs) as runs:
        report("re-tuning", 0.05)
        tuning = retune(runs)
        measured = runs.measured()
        noise = float(len(measured))
        judged = HeldOut(runs, tuning) if runs.has_held_out else None
        selection = select(runs, tuning, judged, noise, candidates_for(runs, tuning), report)
        for begun_anew in (without_effects, with_finer_steps):
            again = begun_anew(runs, tuning, selection)
            if again is not tuning:
                tuning = again
                runs.weigh_lines(HELD_OUT, None)  # what other fits leave there is asked anew
                judged = HeldOut(runs, tuning) if runs.has_held_out else None
                selection = select(runs, tuning, judged, noise, candidates_for(runs, tuning), report)
        report("weighing", 0.95)
        passed, tried = selection.chosen is not None, len(selection.screened)
        weigh = partial(evidence_of, runs, tuning, judged, formless=selection.formless, tried=tried, found=passed)
        evidence = weigh(selection.contenders)
        if judged is not None and passed:
            tempers = tempers_of(evidence.sets, evidence.base, (evidence.entries_train, evidence.entries_held_out))
            selection = selection.moved(partial(with_both_motions, runs, tuning, judged, tempers=tempers))
            weigh = partial(weigh, formless=selection.formless)
            evidence = weigh(selection.contenders)
        hypotheses = ranking(evidence)
        chosen = hypotheses[0].fitted if selection.chosen is not None else None
        values = tuning.values if chosen is None else tuning.at(chosen.offset)
        effects = () if chosen is None else chosen.settings
        stages = simulated_stages(runs, tuning, values, effects)
        misfits = [_energy(runs, rows) for rows in (stages[TRAIN]["nominal"], stages[TRAIN]["retuned"], stages[TRAIN]["extended"])]
        shown = int(np.sum(np.diag(tuning.covariance) < 0.5))
        best_held_out = hypotheses[0].held_out if hypotheses else evidence.base.held_out
        only = OnlyHeldOut() if passed else only_held_out(runs, tuning, judged, sets.get(HELD_OUT), jobs)
        standing = Standing(
            gates=selection.gates,
            hypotheses=hypotheses,
            nominal_misfit=misfits[0],
            retuned_misfit=misfits[1],
            best_misfit=misfits[2],
            noise=noise,
            shown=shown,
            missing=what_is_missing(train, selection),
            held_out=None if judged is None else (evidence.base.held_out, best_held_out, evidence.entries_held_out),
            drift=_drift(runs, tuning, judged, selection, chosen),
            further=selection.further if _is_same_set(chosen, selection.chosen) else math.inf,
            gained=selection.gained_by_least(chosen),
            only_held_out=only.times,
            imitated=_imitated(selection, evidence),
            is_noise_known=train.noise.kind != "assumed",
        )
        verdict, reason = verdict_of(standing)
        is_only_held_out = reason == only_there(standing)
        short, short_values = train.with_simulated(stages[TRAIN]["retuned"]), tuning.values
        if is_only_held_out:
            short, short_values = sets[HELD_OUT].with_simulated(only.rows), only.values
        unsure: tuple[Weighed, ...] = ()
        if verdict == "ambiguous":
            unsure = plausible_among(selection.unsure, ranking(weigh((*selection.contenders, *selection.unsure))))
            reason += what_may_act_too(unsure)
        verdict, reason = with_read_off(verdict, reason, [what.says(channel) for channel, what in train.read_off])
        if verdict in NOTHING_SHOWS:
            reason = f"{reason}; {what_may_hide(recordings)}"
        whole = confidence_of(cap_of(runs))
        if verdict == "explained" and chosen is not None:
            whole, hypotheses = standing_alone(whole), tuple(replace(h, confidence=standing_alone(h.confidence)) for h in hypotheses)
        spread = spread_of(runs, tuning, chosen)
        findings: tuple[Finding, ...] = ()
        if chosen is not None and verdict in ("ambiguous", "explained", "unknown_physics"):
            estimates = effect_estimates(machine.plant, believed(runs, tuning, hypotheses, spread))
            findings = findings_of(selection.contenders, hypotheses, estimates, whole, verdict, unsure)
        if verdict == "unknown_physics":
            findings = tuple(replace(finding, confidence=min(finding.confidence, CAP_UNCONFIRMED)) for finding in findings)
            hypotheses = tuple(_at_most(h, CAP_UNCONFIRMED) for h in hypotheses)
        if verdict == "inconclusive":
            hypotheses = ()
        fit = _fit(train, sets.get(HELD_OUT), stages)
        findings = tuple(replace(one, evidence_against=(*one.evidence_against, *against_held_out(fit))) for one in findings)
        read_off = read_off_findings(train)
        findings += read_off
        proposal = None
        if verdict == "ambiguous" and look_further:
            proposal = _next_experiment(machine, train, tuning, hypotheses, jobs, report)
        if proposal is not None:
            findings = tuple(replace(finding, separating_experiment=NEXT_EXPERIMENT) for finding in findings)
        retuned, frozen = retuned_values(tuning, chosen, spread)
        explainable = misfits[1] - noise if misfits[1] - noise > certain_excess(noise) else 0.0
        has_excess = explainable > 0.0 or is_only_held_out
        disturbed = disturbance_shares(short, short_values) if has_excess else DisturbanceShares()
        contenders = (*selection.contenders, *selection.unsure)
        diagnosis = Diagnosis(
            verdict=verdict,
            reason=reason,
            findings=findings,
            hypotheses=tuple(
                hypothesis_of(h, contenders, [finding.effect for finding in read_off], judged is not None)
                for h in with_unsure(hypotheses, unsure, whole)
            ),
            retuned=retuned,
            frozen=frozen,
            noise=train.noise.kind,
            location=locate(short)
            if is_only_held_out
            else locate_outcome(
                train,
                stages[TRAIN]["retuned"],
                _change(runs, values, effects),
                named=bool(findings),
                unknown=verdict == "unknown_physics",
            ),
            fit=fit,
            unexplained_share=float(np.clip((misfits[2] - noise) / explainable, 0.0, 1.0))
            if explainable > 0.0
            else float(is_only_held_out),
            seconds=time.monotonic() - began,
            disturbance=disturbed,
            suspicions=suspicions(train, train.with_simulated(stages[TRAIN]["extended"]) if verdict in SAYS_WHAT_IT_IS else None),
            known=known_effects(machine.plant),
            separations=() if proposal is None else predicted(proposal, [h.fitted for h in rivals_of(hypotheses)]),
        )
    found = (*effects, *(what.setting(channel) for channel, what in train.read_off))
    return Outcome(
        diagnosis, found, values, tuning, train, sets.get(HELD_OUT), stages, selection, evidence, hypotheses, proposal, chosen, short,
        short_values, is_only_held_out,
    )  # fmt: skip


def _never_back(report: Report) -> Report:
    """A search that is begun once more is at the share where it was."""
    done = 0.0

    def say(what: str, share: float) -> None:
        nonlocal done
        done = max(done, share)
        report(what, done)

    return say


def _imitated(selection: Selection, evidence: Evidence) -> str:
    """Why the set that fits best is no name, where that is likelier than all that are; "" where it is not."""
    share, likeliest = imitated(evidence)
    return next((c.gate.lost_form for c in selection.formless if share > LIKELIER and likeliest and c.fitted is likeliest.fitted), "")


def _drift(runs: FreeRuns, tuning: Tuning, judged: HeldOut | None, selection: Selection, chosen: Fitted | None) -> float:
    """Chance of the values that the held-out recordings want of the chosen set's parameters; 1 where there are none."""
    found = next((one for one in selection.contenders if one.fitted is chosen), None)
    if judged is None or found is None:
        return 1.0
    energies = erring(found.gained, found.by_numbers[0]), erring(found.gained_held_out, found.by_numbers[1])
    return chance_of_drift(runs, tuning, judged, found.fitted, energies, found.moved)


def _is_same_set(one: Fitted | None, other: Fitted | None) -> bool:
    """Whether both are of the same effects: of a set that two ways came to, the fit that is closer competes for the name."""
    return one is other or (one is not None and other is not None and set(one.effects) == set(other.effects))


def _at_most(hypothesis: Weighed, cap: float) -> Weighed:
    return replace(hypothesis, confidence=min(hypothesis.confidence, cap))


def _next_experiment(
    machine: Machine, train: Mismatch, tuning: Tuning, hypotheses: tuple[Weighed, ...], jobs: int, report: Report
) -> Proposal | None:
    """What separates the likeliest set from those that are plausible beside it."""
    rivals = rivals_of(hypotheses)
    models = [Model.of(tuning, h.fitted) for h in rivals if h.fitted is not None]
    shares = [h.confidence for h in rivals]

    def say(share: float) -> None:
        report("looking for the next experiment", 0.97 + 0.03 * share)

    return propose(machine, models, shares, train.noise, train.channels, jobs=jobs, report=say)


def simulated_stages(
    runs: FreeRuns, tuning: Tuning, values: np.ndarray, effects: tuple[EffectSetting, ...]
) -> dict[str, dict[str, list[np.ndarray]]]:
    """Simulated rows of every set at nominal, retuned and extended, there also with none and the first of its effects and, where there are
    effects, with their placebo; see `Outcome`.
    """
    trials = {"nominal": Trial(runs.nominal), "retuned": Trial(tuning.values), "extended": Trial(values, effects)}
    trials["without_effects"] = Trial(values)
    trials |= {first_effects(count): Trial(values, effects[:count]) for count in range(1, len(effects))}
    found: dict[str, dict[str, list[np.ndarray]]] = {}
    for name in runs.sets:
        found[name] = {}
        for stage, trial in trials.items():
            rows = runs.rows(trial, name)
            found[name][stage] = [np.full_like(group.simulated, np.nan) for group in runs.sets[name].groups] if rows is None else rows
    if effects:
        add_placebo(runs, found)
    return found


def first_effects(count: int) -> str:
    """Stage of the extended simulation with its first effects alone."""
    return f"first_{count}"


def _change(runs: FreeRuns, values: np.ndarray, effects: tuple[EffectSetting, ...]) -> list[np.ndarray] | None:
    """What the effects add to the training groups, each machine held by its own controllers at first; None where one cannot be simulated.

    From the recorded states, which hold what the effects do, a machine without them would jump.
    """
    full, bare = (runs.rows(Trial(values, some), settled=True) for some in (effects, ()))
    return None if full is None or bare is None else [one - other for one, other in zip(full, bare, strict=True)]


def _energy(runs: FreeRuns, rows: list[np.ndarray]) -> float:
    return float(np.sum((runs.measured() - runs.joined(rows)) ** 2))


def _fit(train: Mismatch, held_out: Mismatch | None, stages: Mapping[str, Mapping[str, list[np.ndarray]]]) -> Fit:
    def in_order(name: str) -> list[list[np.ndarray] | None]:
        rows = stages[name]
        return [rows["nominal"], rows["retuned"], rows["extended"], rows.get("placebo")]

    on_train = total_stages(train, in_order(TRAIN))
    on_held_out = None if held_out is None else total_stages(held_out, in_order(HELD_OUT))
    judged = on_train if on_held_out is None else on_held_out
    return Fit(
        channels=channel_stages(train, in_order(TRAIN)) if held_out is None else channel_stages(held_out, in_order(HELD_OUT)),
        train=on_train,
        held_out=on_held_out,
        removed_share=removed_share(judged.retuned, judged.extended, judged.noise_floor),
        removed_share_from_nominal=removed_share(judged.nominal, judged.extended, judged.noise_floor),
    )


def removed_share(before: float | None, after: float | None, floor: float | None) -> float | None:
    """(E_before^2 - E_after^2) / (E_before^2 - E_floor^2); more than 1 where the end is below the floor, None where the beginning is."""
    if before is None or after is None or floor is None or before <= floor:
        return None
    return (before**2 - after**2) / (before**2 - floor**2)
