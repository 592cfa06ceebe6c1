"""What a diagnosis says, as blocks of its page."""

from __future__ import annotations

from collections.abc import Mapping

from hil.diagnosis.next_experiment.proposal import Proposal
from hil.diagnosis.report.style import STAGE_NAMES
from hil.diagnosis.result import STAGES, Diagnosis, Finding, ParameterEstimate, Stages
from hil.diagnosis.verdict.values import RIGHT, counted_as
from hil.pages import Bullets, Table, Text, Verdict
from hil.pages.contents import Block, Kind

KINDS: Mapping[str, Kind] = {
    "consistent": "good", "retuned": "good", "explained": "good",
    "ambiguous": "unsure", "inconclusive": "unsure",
    "unknown_physics": "bad", "misconfigured": "bad",
}  # fmt: skip
SHOWN = tuple(stage for stage in STAGES if stage != "placebo")
"""Stages that an answer has numbers of."""


def verdict(diagnosis: Diagnosis) -> Verdict:
    """Return the sentence on top of the page: the verdict, why, and the numbers of what was found."""
    found = [f"{finding.name}: {_numbers_of(finding)}" for finding in diagnosis.findings if finding.parameters]
    word = diagnosis.verdict.replace("_", " ").capitalize()
    return Verdict(". ".join([f"{word}: {diagnosis.reason}", *found]) + ".", KINDS[diagnosis.verdict])


def findings(diagnosis: Diagnosis, proposal: Proposal | None) -> list[Block]:
    """Return what was known and what was found, with its evidence."""
    blocks: list[Block] = [Text(f"Known, and in every simulation: {known(diagnosis)}.")] if diagnosis.known else []
    for finding in diagnosis.findings:
        blocks.append(Text(_numbers_of(finding), f"{finding.name}, confidence {finding.confidence:.2f}"))
        for heading, evidence in (("For:", finding.evidence_for), ("Against:", finding.evidence_against)):
            if evidence:
                blocks.append(Bullets(tuple(evidence), heading))
        if finding.ambiguous_sets:
            others = "; ".join(" and ".join(map(str, one)) for one in finding.ambiguous_sets)
            blocks.append(Text(f"Instead, these recordings allow: {others}."))
        if finding.separating_experiment and proposal is not None:
            blocks.append(Text(f"The next experiment: {proposal.said(finding.separating_experiment)}."))
    said = f"Confidence: {how_sure(diagnosis)}." if diagnosis.findings else "No effect is named."
    return [*blocks, Text(said)]


def how_sure(diagnosis: Diagnosis) -> str:
    """Return in words what confidences rest on."""
    verdict = counted_as(diagnosis)
    right, answers = RIGHT[verdict]
    beside = "; none of those was without repeats, as this one is" if diagnosis.noise == "assumed" else ""
    return f"where the truth was known, {right} of {answers} answers called {verdict} were right{beside}"


def _numbers_of(finding: Finding) -> str:
    return ", ".join(f"{name} = {_estimate(estimate)}" for name, estimate in finding.parameters.items())


def known(diagnosis: Diagnosis) -> str:
    """Return the effects that were given, with their numbers."""
    return "; ".join(
        f"{one.effect}: " + ", ".join(f"{name} = {value:.4g} {unit}".rstrip() for name, (value, unit) in one.parameters.items())
        for one in diagnosis.known
    )


def _estimate(estimate: ParameterEstimate) -> str:
    unit = f" {estimate.unit}" if estimate.unit else ""
    return f"{estimate.value:.4g}{unit} ({estimate.ci95[0]:.4g} to {estimate.ci95[1]:.4g})"


def hypotheses(diagnosis: Diagnosis) -> list[Block]:
    """Return the sets of effects that were weighed."""
    rows = [
        (
            " and ".join(str(e) for e in h.effects) or "no effect",
            f"{h.confidence:.3f}",
            f"{h.gained:.4g}",
            str(h.parameters),
            "yes" if h.is_confirmed else "no",
        )
        for h in diagnosis.hypotheses
    ]
    said = "For a set: by how much it lowers the sum of squares in units of noise, in training. Against it: how many parameters it takes"
    said += " for that. One of the sets is the answer."
    lacking = "What these confidences lack of 1 is for physics that none of them holds, and for wrong answers of this kind."
    header = ("hypothesis", "confidence", "lowers training by", "parameters", "is the answer")
    return [Text(said), Table(header, rows, frozenset((1, 2, 3))), Text(lacking)] if rows else [Text("No hypothesis was weighed.")]


def disturbance_shares(diagnosis: Diagnosis) -> list[Block]:
    """Return on which driven joints effort is missing."""
    rows = [(name, f"{share:.0%}") for name, share in falling(diagnosis.lacking)]
    said = "How the power of what the machine file's equations lack divides among the driven joints, each in units of the effort on it."
    return [Text(said), Table(("effort on", "share"), rows, frozenset({1}))] if rows else [Text("No effort is missing.")]


def falling(shares: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return names and shares, the largest first, without the smallest."""
    return sorted(((name, share) for name, share in shares.items() if share >= 0.005), key=lambda pair: -pair[1])


def fit_table(diagnosis: Diagnosis) -> Table:
    """Return how far every stage is from the recordings: errors of rows in units of noise, or of free runs as shares of the motion."""
    fit = diagnosis.fit
    heading, numbers = ("NRMSE of free runs", _percent) if fit.errors_of != "rows" else ("rms error in units of noise", _numbers)
    rows = [(name, *numbers(stages)) for name, stages in fit.channels.items()]
    rows.append(("E, training (units of noise)", *_numbers(fit.train)))
    if fit.held_out is not None:
        rows.append(("E, held-out (units of noise)", *_numbers(fit.held_out)))
    names = [STAGE_NAMES.get(stage, stage.replace("_", " ")) for stage in SHOWN]
    return Table((heading, *names), rows, frozenset(range(1, len(names) + 1)))


def _percent(stages: Stages) -> list[str]:
    return ["-" if (value := getattr(stages, stage)) is None else f"{100.0 * value:.3g} %" for stage in SHOWN]


def _numbers(stages: Stages) -> list[str]:
    return ["-" if (value := getattr(stages, stage)) is None else f"{value:.3g}" for stage in SHOWN]


def retuned_table(diagnosis: Diagnosis) -> list[Block]:
    """Return the numbers of the machine file."""
    rows = [
        (name, f"{v.nominal:.5g}", f"{v.value:.5g}", f"{v.ci95[0]:.5g} to {v.ci95[1]:.5g}", v.unit) for name, v in diagnosis.retuned.items()
    ]
    header = ("number", "machine file", "re-tuned", "95 % interval", "unit")
    shown: list[Block] = [Table(header, rows, frozenset((1, 2, 3)))] if rows else [Text("None shows in these recordings.")]
    if diagnosis.frozen:
        frozen = tuple(f"{name}: {reason}" for name, reason in diagnosis.frozen.items())
        shown.append(Bullets(frozen, "Not shown or not decided by these recordings:"))
    return shown
