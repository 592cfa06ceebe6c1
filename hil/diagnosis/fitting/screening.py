"""Every effect at every place tried once, and the few that a fit is worth.

Each candidate's free run at its start values less the re-tuned one is its response; what re-tuning could imitate is projected out, and the
residual's energy along the rest is its score (a matched filter; Kay 1998, ch. 4). A strength that the filter finds far from the start's is
tried again there, because few effects are linear in it; a fit starts from the strength that the filter wants.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hil.diagnosis.fitting.coordinates import INVERSE, TURNED_BY
from hil.diagnosis.fitting.refit import bounded
from hil.diagnosis.fitting.visited import REPLACES_THE_FILES
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.free_run import FreeRuns, Trial
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.effect import PHASE
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

RESCALED_BEYOND = 1.5
"""A strength that the filter wants changed by more than this factor is tried again."""

LARGEST_RESCALE = 30.0

ROUNDS = 3
"""Times a strength is tried: what first shows a thousandth of the noise is found by two factors of LARGEST_RESCALE."""

SURE_TO_BE_SMALL = 100.0
"""Energy of a response, in units of noise, that a strength is tried with again where its response is larger and none of the residual's way.
What turns with another axis is in proportion to its strength only while that is small: a start of a tenth of its axis' own may score
nothing where an inertia over pose of a twentieth is hidden, which gains 140."""

NONLINEAR_STRENGTH = ("imax", "b", "q", "sign", "share")
"""Parameters whose effect is not in proportion to them: a factor on the response says nothing about them. What a stop does is, as long as
it is softer than the loop that pushes into it."""

AMPLITUDE_AND_PHASE = (*((a, phase) for a, phase in TURNED_BY.items() if phase != "phi2"), ("mgr", "phi"), ("J12", "phi"))
"""Amplitude A and phase p of a first harmonic A cos(x + p) or A sin(x + p)."""

SAME_STRENGTH = 1e-6
"""Share of its energy by which a response must differ from the others to be told from them."""

SOME = 32
"""Free runs whose answers are worked on at a time; as many more are under way meanwhile."""

UNLIKE = 0.9
"""Squared cosine with every better response below which a candidate is another kind of mismatch."""

MOST_UNLIKE = 2

IN_PROPORTION_TO_EACH = ("imu_scale_bias", "imu_misalignment", "asymmetric_friction")
"""Effects of several strengths that add up: every one runs alone, and then the mixture that the residual wants of them. A guess' own
mixture may be one that nothing wants: with a viscous part of one direction that is not there, an asymmetric friction scores next to nothing
where the Coulomb friction that it holds explains the recordings."""


@dataclass(frozen=True, eq=False)
class Screened:
    """The best start of one candidate, at the strength that the filter wants.

    `response` (M + F,) is what it adds to the simulation and re-tuning cannot imitate; `score` the share of the residual's energy along it,
    in units of noise: chi-squared with one degree of freedom where there is nothing.
    """

    effect: EffectAt
    values: np.ndarray
    response: np.ndarray
    score: float


def screen(
    runs: FreeRuns, tuning: Tuning, found: Sequence[Candidate], residual: np.ndarray, present: tuple[EffectSetting, ...] = ()
) -> list[Screened]:
    """Try all candidates beside the effects that are `present`; the best first.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Linearised with the present effects.
    found : sequence of Candidate
    residual : (M,) array
        Of the training groups, with the present effects.
    present : tuple of EffectSetting
    """
    projection = Projection.of(tuning)
    left = projection.left_of_residual(residual)
    tries = [(candidate, values) for candidate in found for start in candidate.starts for values in _first_tries(candidate.effect, start)]
    best: dict[EffectAt, Screened] = {}
    for number in range(ROUNDS):
        singles: dict[EffectAt, list[tuple[Candidate, np.ndarray, np.ndarray]]] = {}
        earlier: tuple[np.ndarray, np.ndarray] | None = None  # values and response of the try before
        trials = [Trial(tuning.values, (*present, candidate.setting(values))) for candidate, values in tries]
        again = []
        for (candidate, values), response in zip(tries, _responses(runs, tuning, projection, trials), strict=True):
            if response is None:
                again.append((candidate, _rescaled(candidate.effect, values, 0.2)))
                earlier = None
                continue
            energy = float(response @ response)
            amplitude = float(response @ left) / energy if energy > 0.0 else 0.0
            score = max(amplitude, 0.0) ** 2 * energy
            if amplitude < 1.0 / LARGEST_RESCALE and _rescaled(candidate.effect, values, 1.0) is None:
                score = 0.0  # far too large, and strength is no factor by which it would become smaller
            known = best.get(candidate.effect)
            if known is None or score > known.score:
                best[candidate.effect] = _wanted(candidate.effect, values, response, amplitude, score)
            if earlier is not None and _are_in_quadrature(candidate.effect, earlier[0], values):
                again.append((candidate, _turned(candidate.effect, earlier[0], earlier[1], response, left)))
            earlier = values, response
            if candidate.effect.effect in IN_PROPORTION_TO_EACH:
                singles.setdefault(candidate.effect, []).append((candidate, values, response))
                continue
            if _pair(candidate.effect) is not None:
                continue
            if amplitude > 0.0 and not 1.0 / RESCALED_BEYOND < amplitude < RESCALED_BEYOND:
                again.append((candidate, _rescaled(candidate.effect, values, amplitude)))
            elif amplitude < 0.0 and (flipped := _flipped(candidate.effect, values, -amplitude)) is not None:
                again.append((candidate, flipped))
            elif amplitude <= 0.0 and energy > SURE_TO_BE_SMALL:
                again.append((candidate, _rescaled(candidate.effect, values, float(np.sqrt(SURE_TO_BE_SMALL / energy)))))
        if number == 0:
            again += [(parts[0][0], _mixture(parts, left)) for parts in singles.values()]
        tries = [(candidate, values) for candidate, values in again if values is not None]
    return sorted(best.values(), key=lambda screened: -screened.score)


def _responses(runs: FreeRuns, tuning: Tuning, projection: Projection, trials: Sequence[Trial]) -> Iterator[np.ndarray | None]:
    """(M + F,) of every trial: what it changes in the simulation and re-tuning cannot imitate; None where it cannot be simulated.

    Some at a time: the answers of all would take a gigabyte where recordings are a minute long.
    """
    following = runs.begin(trials[:SOME])
    for first in range(0, len(trials), SOME):
        waiting, following = following, runs.begin(trials[first + SOME : first + 2 * SOME])
        answers = waiting()
        changes = [answer - tuning.predicted for answer in answers if answer is not None]
        left = iter(projection.left(np.stack(changes)) if changes else ())
        yield from (None if answer is None else next(left) for answer in answers)


def shortlist(screened: Sequence[Screened], most: int, worth: float) -> list[Screened]:
    """The best candidates, those after them whose responses are unlike all of these, and the one of the largest score.

    Where a machine turns one way only, every friction, a load and a torque constant are one response, and all of them score alike: eight of
    them would leave no fit to a wave that explains more, but not in proportion to its response at a start's phase. Their order takes off
    what a strength scatters by over the repeats, which two or three deviations know badly: by their order alone, a candidate five times as
    loud as all others might not be fitted. What is mixed of several strengths takes no other one's place, whose score is of one.

    Parameters
    ----------
    screened : sequence of Screened
        In their order.
    most : int
    worth : float
        Share of the best score that a candidate has at least.
    """
    if not screened:
        return []
    least = worth * max(candidate.score for candidate in screened)
    mixed = [candidate for candidate in screened if candidate.effect.effect in IN_PROPORTION_TO_EACH]
    first = [candidate for candidate in screened if candidate not in mixed][:most]
    last = screened.index(first[-1]) if len(first) == most else len(screened) - 1  # all of them where there are no more
    chosen = [candidate for candidate in screened[: last + 1] if candidate.score > least]
    room = most + sum(candidate in mixed for candidate in chosen) + MOST_UNLIKE
    for candidate in screened[last + 1 :]:
        if len(chosen) == room:
            break
        if candidate.score > least and all(squared_cosine(candidate.response, other.response) < UNLIKE for other in chosen):
            chosen.append(candidate)
    loudest = max(screened, key=lambda candidate: candidate.score)
    return chosen if loudest in chosen else [*chosen, loudest]


def squared_cosine(one: np.ndarray, other: np.ndarray) -> float:
    """Of two responses; 1 where one is nothing."""
    energies = float(one @ one) * float(other @ other)
    return float(one @ other) ** 2 / energies if energies > 0.0 else 1.0


def _wanted(effect: EffectAt, values: np.ndarray, response: np.ndarray, amplitude: float, score: float) -> Screened:
    """A try at the strength that the filter wants of it."""
    changed = _rescaled(effect, values, amplitude) if amplitude > 0.0 else None
    if changed is None:
        return Screened(effect, values, response.astype(np.float32), score)
    factor = float(np.clip(amplitude, 1.0 / LARGEST_RESCALE, LARGEST_RESCALE))
    return Screened(effect, changed, (factor * response).astype(np.float32), score)


def scaled(effect: EffectAt, values: np.ndarray, factor: float) -> np.ndarray | None:
    """The effect's parameters at a strength that a filter wants changed by this factor, of either sign; as they are where strength is no
    factor; None where the effect has no such sign. A wave of the other sign is half a cycle on.
    """
    if factor < 0.0:
        flipped = _flipped(effect, values, -factor)
        return _half_a_cycle_on(effect, values, -factor) if flipped is None else flipped
    changed = _rescaled(effect, values, factor)
    return values if changed is None else changed


def _half_a_cycle_on(effect: EffectAt, values: np.ndarray, factor: float) -> np.ndarray | None:
    """A wave with the opposite sign; None of what is more than a wave."""
    parameters = effects()[effect.effect].parameters
    strengths = [p for p in parameters if p.is_strength and p.name not in NONLINEAR_STRENGTH]
    phases = [k for k, p in enumerate(parameters) if p.unit == PHASE and not p.is_strength]
    changed = _rescaled(effect, values, factor)
    if changed is None or _pair(effect) is None or len(phases) != len(strengths):
        return None
    changed[phases] = [_wrapped(phase + np.pi) for phase in changed[phases]]
    return changed


def _rescaled(effect: EffectAt, values: np.ndarray, factor: float) -> np.ndarray | None:
    """All strengths that enter in proportion, by this factor; None where there is none."""
    parameters = effects()[effect.effect].parameters
    in_proportion = [p.is_strength and p.name not in NONLINEAR_STRENGTH for p in parameters]
    if any(effect.effect == name for name, _ in REPLACES_THE_FILES) or not any(in_proportion):
        return None
    factor = float(np.clip(factor, 1.0 / LARGEST_RESCALE, LARGEST_RESCALE))
    low, high = (np.array([getattr(p, end) for p in parameters]) for end in ("low", "high"))
    factors = np.array([1.0 / factor if p.name in INVERSE else factor for p in parameters])
    return np.clip(np.where(in_proportion, values * factors, values), low, high)


def _flipped(effect: EffectAt, values: np.ndarray, factor: float) -> np.ndarray | None:
    """The same effect with the opposite sign; None where no strength may have it, as a wave's, whose phase would have to turn."""
    signed = [k for k, p in enumerate(effects()[effect.effect].parameters) if p.is_strength and p.low < 0.0]
    flipped = _rescaled(effect, values, factor)
    if flipped is None or not signed:
        return None
    flipped[signed] *= -1.0
    return flipped


def _pair(effect: EffectAt) -> tuple[int, int] | None:
    """Which parameters are amplitude and phase of the effect's first harmonic, in proportion to which it acts; None where it has none."""
    names = [p.name for p in effects()[effect.effect].parameters]
    return next(((names.index(a), names.index(p)) for a, p in AMPLITUDE_AND_PHASE if a in names and p in names), None)


def _first_tries(effect: EffectAt, start: np.ndarray) -> list[np.ndarray]:
    """A start, and a quarter of a cycle further where the effect has a phase: both together show every phase. Of an effect in proportion to
    each of several strengths, one alone at a time.
    """
    if effect.effect in IN_PROPORTION_TO_EACH:
        return [np.where(np.arange(len(start)) == k, start, 0.0) for k in range(len(start)) if start[k] != 0.0]
    pair = _pair(effect)
    if pair is None:
        return [start]
    further = start.copy()
    further[pair[1]] = _wrapped(further[pair[1]] + 0.5 * np.pi)
    return [start, further]


def _mixture(parts: Sequence[tuple[Candidate, np.ndarray, np.ndarray]], left: np.ndarray) -> np.ndarray | None:
    """The strengths that the residual wants of responses that add up; None where none shows anything."""
    responses = np.stack([response for _, _, response in parts])
    gram = responses @ responses.T
    seen = np.diag(gram) > 0.0
    if not np.any(seen):
        return None
    gram = gram[np.ix_(seen, seen)]
    gram += np.diag(SAME_STRENGTH * np.diag(gram))
    alone = np.stack([values for _, values, _ in parts])[seen]
    parameters = effects()[parts[0][0].effect.effect].parameters
    ends = np.array([(p.low, p.high) for p in parameters])[np.argmax(alone != 0.0, axis=1)] / alone[alone != 0.0][:, None]
    weights = bounded(gram, responses[seen] @ left, ends.min(axis=1), ends.max(axis=1))
    return np.clip(weights @ alone, [p.low for p in parameters], [p.high for p in parameters])


def _are_in_quadrature(effect: EffectAt, one: np.ndarray, other: np.ndarray) -> bool:
    pair = _pair(effect)
    if pair is None or len(one) != len(other):
        return False
    same = np.delete(one, pair[1]), np.delete(other, pair[1])
    return np.array_equal(*same) and abs(_wrapped(other[pair[1]] - one[pair[1]] - 0.5 * np.pi)) < 1e-9


def _turned(effect: EffectAt, values: np.ndarray, one: np.ndarray, quarter: np.ndarray, left: np.ndarray) -> np.ndarray | None:
    """Amplitude and phase that two responses a quarter of a cycle apart say the residual has."""
    pair = _pair(effect)
    assert pair is not None
    gram = np.array([[one @ one, one @ quarter], [one @ quarter, quarter @ quarter]])
    if np.linalg.det(gram) <= 1e-9 * gram[0, 0] * gram[1, 1]:
        return None
    along, across = np.linalg.solve(gram, [one @ left, quarter @ left])
    size = float(np.clip(np.hypot(along, across), 1.0 / LARGEST_RESCALE, LARGEST_RESCALE))
    turned = values.copy()
    parameter = effects()[effect.effect].parameters[pair[0]]
    turned[pair[0]] = np.clip(values[pair[0]] * size, parameter.low, parameter.high)
    turned[pair[1]] = _wrapped(values[pair[1]] + np.arctan2(across, along))
    return turned


def _wrapped(phase: float) -> float:
    return float((phase + np.pi) % (2.0 * np.pi) - np.pi)
