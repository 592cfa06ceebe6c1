"""What a diagnosis says, as frozen values, and the JSON that carries it: docs/generated/json.md has every key."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from hil.files.frames import data_frame

if TYPE_CHECKING:
    import pandas as pd

Verdict = Literal["inconclusive", "misconfigured", "unknown_physics", "ambiguous", "explained", "retuned", "consistent"]
NoiseKind = Literal["repeats", "periods", "assumed"]
ErrorsOf = Literal["rows", "closed_loop", "efforts"]
"""Rows that are predicted from those before them, in units of noise; or free runs, of the closed loop or driven by the recorded efforts."""
Span = tuple[float, float]

STAGES = ("nominal", "retuned", "extended", "placebo", "noise_floor", "baseline")


@dataclass(frozen=True, order=True)
class EffectAt:
    """One effect of the catalogue at one place of the machine; of those that may act there several times, which one."""

    effect: str
    at: str
    number: int = 1

    def __str__(self) -> str:
        """Name the effect and its place."""
        return f"{self.effect} at {self.at}" if self.number == 1 else f"{self.effect} {self.number} at {self.at}"

    def document(self) -> dict[str, str]:
        """Return plain values for JSON."""
        return {"effect": self.effect, "at": self.at}


@dataclass(frozen=True)
class ParameterEstimate:
    """A number with its unit and its 95 % interval."""

    value: float
    unit: str
    ci95: Span
    nominal: float | None = None  # of a number of the machine file, or of the controller's side

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        said = {} if self.nominal is None else {"nominal": self.nominal}
        return {"value": self.value, "unit": self.unit, "ci95": list(self.ci95), **said}


@dataclass(frozen=True)
class RetunedValue:
    """A number of the machine file before and after re-tuning."""

    nominal: float
    value: float
    unit: str
    ci95: Span

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"nominal": self.nominal, "value": self.value, "unit": self.unit, "ci95": list(self.ci95)}


@dataclass(frozen=True)
class Finding:
    """One effect that the diagnosis holds for present, or a number that left its tolerance: its name and the place are in `effect`."""

    effect: EffectAt
    confidence: float
    parameters: Mapping[str, ParameterEstimate]
    ambiguous_with: tuple[EffectAt, ...] = ()  # what those sets have that the likeliest one has not
    ambiguous_sets: tuple[tuple[EffectAt, ...], ...] = ()  # plausible ones with another effect in its place
    separating_experiment: str | None = None  # file that `isocenter run` takes
    evidence_for: tuple[str, ...] = ()
    evidence_against: tuple[str, ...] = ()
    family: str = ""  # of effects that recordings often do not tell apart
    variants: tuple[tuple[EffectAt, float], ...] = ()  # laws of the family at this place that may be it, and how sure each is
    kind: Literal["effect", "number"] = "effect"

    @property
    def name(self) -> str:
        """What it is called in a sentence."""
        return str(self.effect) if self.kind == "effect" else self.effect.effect

    def times(self, sure: float) -> Finding:
        """Return the same, so much less sure."""
        return replace(self, confidence=sure * self.confidence, variants=tuple((at, sure * share) for at, share in self.variants))

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "kind": self.kind,
            **(self.effect.document() if self.kind == "effect" else {"number": self.effect.effect, "at": self.effect.at}),
            "confidence": self.confidence,
            "parameters": {name: estimate.document() for name, estimate in self.parameters.items()},
            "ambiguous_with": [other.document() for other in self.ambiguous_with],
            "ambiguous_sets": [[other.document() for other in one] for one in self.ambiguous_sets],
            "separating_experiment": self.separating_experiment,
            "evidence_for": list(self.evidence_for),
            "evidence_against": list(self.evidence_against),
            "family": self.family,
            "variants": [{**effect.document(), "confidence": share} for effect, share in self.variants],
        }


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects that act together, and how sure it is that it is them."""

    effects: tuple[EffectAt, ...]  # (): no effect
    confidence: float
    gained: float = 0.0  # fall of the sum of squares in units of noise, over no effect, in training
    gained_held_out: float | None = None  # the same held out; None without held-out recordings
    parameters: int = 0  # that were fitted for it
    is_confirmed: bool = False  # is the answer

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "effects": [effect.document() for effect in self.effects],
            "confidence": self.confidence,
            "gained": self.gained,
            "gained_held_out": self.gained_held_out,
            "parameters": self.parameters,
            "is_confirmed": self.is_confirmed,
        }


@dataclass(frozen=True)
class Location:
    """Where the explainable mismatch is. A dimension in which it is not localised is left out (an empty mapping)."""

    channels: Mapping[str, float] = field(default_factory=dict)  # shares, summing to 1
    time_s: Mapping[str, tuple[Span, ...]] = field(default_factory=dict)  # by recording
    frequency_hz: tuple[Span, ...] = ()
    position: Mapping[str, tuple[Span, ...]] = field(default_factory=dict)  # by axis
    speed: Mapping[str, tuple[Span, ...]] = field(default_factory=dict)
    effort: Mapping[str, tuple[Span, ...]] = field(default_factory=dict)
    direction: Mapping[str, str] = field(default_factory=dict)  # "both", "positive" or "negative"
    shares: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # of the power that the dimension's spans hold

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        document: dict[str, Any] = {"channels": dict(self.channels)}
        if self.frequency_hz:
            document["frequency_hz"] = [list(span) for span in self.frequency_hz]
        for name in ("time_s", "position", "speed", "effort"):
            spans: Mapping[str, tuple[Span, ...]] = getattr(self, name)
            if spans:
                document[name] = {key: [list(span) for span in value] for key, value in spans.items()}
        if self.direction:
            document["direction"] = dict(self.direction)
        if self.shares:
            document["shares"] = {dimension: dict(shares) for dimension, shares in self.shares.items()}
        return document


@dataclass(frozen=True)
class PredictedSeparation:
    """Of the likeliest set from another one by the next experiment, in standard deviations of one recording's noise."""

    rival: tuple[EffectAt, ...]
    if_likeliest: float  # where the likeliest set is right
    if_rival: float

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "rival": [effect.document() for effect in self.rival],
            "if_likeliest": self.if_likeliest,
            "if_rival": self.if_rival,
        }


@dataclass(frozen=True)
class Stages:
    """One misfit measure at the stages of a diagnosis; None where there is nothing to compute it from."""

    nominal: float | None = None
    retuned: float | None = None
    extended: float | None = None
    placebo: float | None = None  # always None: no effect is tried backwards in time
    noise_floor: float | None = None
    baseline: float | None = None  # of the engineer's fit: everyday effects and numbers

    def document(self) -> dict[str, float | None]:
        """Return plain values for JSON."""
        return {stage: getattr(self, stage) for stage in STAGES}


@dataclass(frozen=True)
class Fit:
    """How far every stage is from the recordings.

    `channels` (held-out where there is one) are NRMSE of free runs: rms error over the rms of the recording about its mean. With
    `errors_of` rows they are rms errors of rows that are predicted from those before them, in units of noise: 1 is noise alone.
    `train` and `held_out` are root mean squares over channels of the same errors in units of that channel's noise.
    """

    channels: Mapping[str, Stages] = field(default_factory=dict)
    train: Stages = Stages()
    held_out: Stages | None = None
    removed_share: float | None = None
    removed_share_from_nominal: float | None = None
    errors_of: ErrorsOf = "efforts"
    horizon_s: float | None = None  # of predictions: a row's period, or the length of free runs; None: whole recordings

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "channels": {name: stages.document() for name, stages in self.channels.items()},
            "train": self.train.document(),
            "held_out": None if self.held_out is None else self.held_out.document(),
            "removed_share": self.removed_share,
            "removed_share_from_nominal": self.removed_share_from_nominal,
            "horizon_s": self.horizon_s,
            "errors_of": self.errors_of,
        }


@dataclass(frozen=True)
class DetectionLimit:
    """The least strength of an effect that the recordings would have shown; None where no strength would."""

    effect: EffectAt
    parameter: str
    strength: float | None
    unit: str

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {**self.effect.document(), "parameter": self.parameter, "strength": self.strength, "unit": self.unit}


@dataclass(frozen=True)
class KnownEffect:
    """An effect that was given: every simulation has it, with these numbers, and it was not sought at its place."""

    effect: EffectAt
    parameters: Mapping[str, tuple[float, str]]  # value and unit

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {**self.effect.document(), "parameters": {name: {"value": v, "unit": unit} for name, (v, unit) in self.parameters.items()}}


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The whole answer."""

    verdict: Verdict
    reason: str  # the verdict in one sentence; for `inconclusive` what is missing
    findings: tuple[Finding, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()
    retuned: Mapping[str, RetunedValue] = field(default_factory=dict)
    frozen: Mapping[str, str] = field(default_factory=dict)  # numbers the recordings do not show or decide, and what became of them
    noise: NoiseKind
    location: Location = field(default_factory=Location)
    fit: Fit = field(default_factory=Fit)
    unexplained_share: float = 1.0
    seconds: float
    lacking: Mapping[str, float] = field(default_factory=dict)  # driven joints' shares of the effort that the file's equations lack
    separations: tuple[PredictedSeparation, ...] = ()  # by the next experiment
    audit: Mapping[str, Any] = field(default_factory=dict)  # of controllers and sensors
    detection_limits: tuple[DetectionLimit, ...] = ()
    baseline: tuple[Finding, ...] = ()  # the engineer's fit: everyday effects at every driven joint
    provisional: bool = False
    known: tuple[KnownEffect, ...] = ()

    def frame(self) -> pd.DataFrame:
        """Return one row per finding and parameter, with value, unit, 95 % interval and confidence; needs pandas, an extra."""
        rows = [(finding, name, number) for finding in self.findings for name, number in finding.parameters.items()]
        return data_frame(
            {
                "effect": [finding.effect.effect for finding, _, _ in rows],
                "at": [finding.effect.at for finding, _, _ in rows],
                "parameter": [name for _, name, _ in rows],
                "value": [number.value for _, _, number in rows],
                "unit": [number.unit for _, _, number in rows],
                "low": [number.ci95[0] for _, _, number in rows],
                "high": [number.ci95[1] for _, _, number in rows],
                "confidence": [finding.confidence for finding, _, _ in rows],
            }
        )

    def document(self) -> dict[str, Any]:
        """Return the whole answer as plain values, laid out in docs/generated/json.md."""
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "findings": [finding.document() for finding in self.findings],
            "hypotheses": [hypothesis.document() for hypothesis in self.hypotheses],
            "retuned": {name: value.document() for name, value in self.retuned.items()},
            "frozen": dict(self.frozen),
            "noise": self.noise,
            "location": self.location.document(),
            "fit": self.fit.document(),
            "predicted_separations": [each.document() for each in self.separations],
            "disturbance": {"joints": dict(self.lacking), "sensors": {}},
            "suspicions": [],
            "audit": dict(self.audit),
            "detection_limits": [limit.document() for limit in self.detection_limits],
            "baseline": [
                {**one.effect.document(), "parameters": {name: value.document() for name, value in one.parameters.items()}}
                for one in self.baseline
            ],
            "provisional": self.provisional,
            "known": [one.document() for one in self.known],
            "unexplained_share": self.unexplained_share,
            "seconds": self.seconds,
        }
