"""Fitted sets of effects before the gate, with what they are judged against: nothing, or the effects that were found before them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from hil.diagnosis.fitting.information import Narrowed
from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.turned import tuning_at
from hil.diagnosis.judging.errors_of_laws import (
    LEAST_ERROR,
    NUMBERS_ERROR,
    WEIGHTS,
    form_variance,
    numbers_of,
    share_of_numbers,
    whole_signs_of,
)
from hil.diagnosis.judging.form import lost_form
from hil.diagnosis.judging.form_error import NO_ERROR, FormError
from hil.diagnosis.judging.gate import SIMULATOR_ERROR, Gate, Scatter, chance_held_out, expected_by_chance, needed_gain
from hil.diagnosis.judging.held_out import Followed, HeldOut
from hil.diagnosis.judging.placebos import NO_PLACEBOS, Placebos, Rivals
from hil.diagnosis.judging.structure_left import StructureLeft
from hil.diagnosis.judging.tried import Tried
from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN, FreeRuns
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import Tuning

NOISE_KNOWN = 0.04
"""Share of the noise by which what repeats say of it is off, one standard deviation: beside the truth's own noise-free answers |residual|^2
of 114 benchmark cases came out at 0.89 to 1.16 of it."""

Equations = Callable[[str, Tuning, Fitted], FormError]
"""Errors of fitted effects in the recordings of a set, beside this tuning."""


@dataclass(frozen=True, eq=False)
class Contender:
    """A fitted set that competes for the name."""

    fitted: Fitted
    gained: float  # fall of the training misfit from no effect at all, less what chance gains in it
    gained_held_out: float
    left_held_out: float  # the held-out misfit
    gates: tuple[Gate, ...]  # of the step that added each of its effects
    searched: float = 0.0  # what its search costs in log evidence, see `Tried`
    moved: Fitted | None = None  # to the parameters that both motions want, see `both_motions`
    narrowed: Narrowed | None = None  # what that costs
    by_moving: tuple[float, float] = (0.0, 0.0)  # of what it gained, what that changed
    known: tuple[float, float] = (0.0, 0.0)  # energies removed before its last step by effects that it is known of how their equations err
    before: Stand | None = None  # what its last step was added to
    placebos: Placebos = NO_PLACEBOS  # of that step

    @property
    def gate(self) -> Gate:
        """Of its last step."""
        return self.gates[-1]

    @property
    def passed(self) -> bool:
        return self.gate.passed  # those before did, or there were no further step

    @property
    def uncharged(self) -> tuple[float, float]:
        """What it gained with training's parameters, of its last step with what chance gains."""
        return self.gained - self.by_moving[0] + self.gate.gain - self.gate.certain_gain, self.gained_held_out - self.by_moving[1]

    @property
    def uncharged_at_all(self) -> tuple[float, float]:
        """The same with what chance gains of all of its steps."""
        earlier = {id(gate): gate for gate in self.gates if gate is not self.gate}.values()
        return self.uncharged[0] + sum(gate.gain - gate.certain_gain for gate in earlier), self.uncharged[1]

    @property
    def beyond_errors(self) -> tuple[float, float]:
        """`uncharged` without what errors of equations found before explain of its last step."""
        explained = self.gate.explained
        return self.uncharged[0] - explained[0], self.uncharged[1] - explained[1]

    @property
    def by_numbers(self) -> tuple[float, float]:
        """Energies that those of its effects remove of which numbers alone are unknown, in training and held out, as far as these do not
        err as laws do."""
        return _energies(steps_of(self.fitted.effects, self.gates, numbers_of(self.fitted)), share_of_numbers)

    @property
    def by_signs(self) -> tuple[float, float]:
        """The same of its whole signs."""
        return _energies(steps_of(self.fitted.effects, self.gates, whole_signs_of(self.fitted)))


def are_added_to_the_same(one: Contender, other: Contender) -> bool:
    """Whether two sets were added to the same one, whose equations err alike in both."""
    before = [[id(gate) for gate in each.gates if gate is not each.gate] for each in (one, other)]
    return before[0] == before[1]


@dataclass(frozen=True, eq=False)
class Stand:
    """What sets are judged against.

    Attributes
    ----------
    fitted : Fitted or None
        The effects that were found; None where there are none.
    tuning : Tuning
        The machine's numbers beside them.
    cost : float
        |residual|^2 + |offset|^2 on the training groups.
    response : (M,) array
        Whitened change of the free run that the effects make, the part that no re-tuning imitates.
    held_out : Followed or None
        Held-out free run.
    gates : tuple of Gate
        Of every effect.
    errors, held_out_errors : FormError
        Of its equations, as far as it is known which functions they err by, and of what noise begins with (`onset.py`); in training with
        what re-tuning imitates taken out.
    """

    fitted: Fitted | None
    tuning: Tuning
    cost: float
    response: np.ndarray
    held_out: Followed | None
    gates: tuple[Gate, ...]
    errors: FormError = NO_ERROR
    held_out_errors: FormError = NO_ERROR
    known: bool = False  # whether errors hold what they can of its effects

    @property
    def effects(self) -> tuple[EffectAt, ...]:
        return () if self.fitted is None else self.fitted.effects

    @property
    def certain_gain(self) -> float:
        """Of all its steps: what chance gains is taken off every one, as it is off a set that is judged at once."""
        return sum(gate.certain_gain for gate in {id(gate): gate for gate in self.gates}.values())

    def steps(self, known: frozenset[EffectAt]) -> list[Gate]:
        """Gates of the steps that added nothing but known effects."""
        return list(steps_of(self.effects, self.gates, known).values())

    @property
    def known_energy(self) -> tuple[float, float]:
        """Energies that effects removed in training and held out of which it is known how they err, as far as they err as laws do."""
        numbers = numbers_of(self.fitted)

        def as_law(effect: EffectAt, energy: float) -> float:
            return energy * (1.0 - share_of_numbers((effect,))) if effect in numbers else energy

        each = [(self.errors, lambda gate: gate.gain), (self.held_out_errors, lambda gate: gate.held_out_gain or 0.0)]
        here, there = (
            sum(as_law(effect, energy) for effect, energy in _each(self.effects, self.gates, of) if effect in errors.effects)
            for errors, of in each
        )
        return here, there

    def erring(self, energy_of: Callable[[Gate], float], errors: FormError) -> float:
        """Energy by which the equations of its effects may err beyond these errors, of what they removed in training or held out; of which
        numbers alone are unknown and it is known how they err, they do so by that alone.
        """
        each = _each(self.effects, self.gates, energy_of)
        beyond = [(effect, energy) for effect, energy in each if effect not in errors.effects]
        known = numbers_of(self.fitted)
        numbers = sum(energy * share_of_numbers((effect,)) for effect, energy in beyond if effect in known)
        unknown = sum(energy for _, energy in beyond) - numbers
        within = sum(energy for effect, energy in each if effect in errors.effects and effect not in known)
        return WEIGHTS.form_error * unknown + NUMBERS_ERROR * numbers + LEAST_ERROR * within


def _each(effects: Sequence[EffectAt], gates: Sequence[Gate], energy_of: Callable[[Gate], float]) -> list[tuple[EffectAt, float]]:
    """Every effect's energy: those that one step added share it."""
    steps = [id(gate) for gate in gates]
    return [(effect, max(energy_of(gate), 0.0) / steps.count(id(gate))) for effect, gate in zip(effects, gates, strict=True)]


def steps_of(effects: Sequence[EffectAt], gates: Sequence[Gate], known: frozenset[EffectAt]) -> dict[frozenset[EffectAt], Gate]:
    """The gates of steps that added nothing but known effects, by these."""
    added: dict[int, set[EffectAt]] = {}
    for effect, gate in zip(effects, gates, strict=True):
        added.setdefault(id(gate), set()).add(effect)
    each = {id(gate): gate for gate in gates}
    return {frozenset(own): each[step] for step, own in added.items() if own <= known}


def _energies(
    steps: dict[frozenset[EffectAt], Gate], share_of: Callable[[frozenset[EffectAt]], float] = lambda _: 1.0
) -> tuple[float, float]:
    """In training and held out."""
    each = [(share_of(effects), gate) for effects, gate in steps.items()]
    return sum(share * gate.gain for share, gate in each), sum(share * (gate.held_out_gain or 0.0) for share, gate in each)


@dataclass(frozen=True)
class _Trained:
    """What a gate has of the training recordings; see `Gate`."""

    gain: float
    beyond: float
    needed: float
    scatter: float
    level: float  # of what the fit leaves, in units of the noise model's
    by_chance: float
    change: np.ndarray  # (M + F,) of the simulation, the part that no re-tuning imitates


class Judgement:
    """Asks the gate about sets.

    Parameters
    ----------
    runs : FreeRuns
    tuning : Tuning
        Without effects.
    held_out : HeldOut or None
    noise_energy : float
        Expected |residual|^2 of a perfect simulation.
    equations : callable, optional
        What equations may err by (`form_error.form_error`). Without it they err in any way, by a share of their own response.
    begins : callable, optional
        What the noise of a set may have begun with (`onset.onset`).
    """

    def __init__(
        self,
        runs: FreeRuns,
        tuning: Tuning,
        held_out: HeldOut | None,
        noise_energy: float,
        equations: Equations | None = None,
        begins: Callable[[str], FormError] = lambda name: NO_ERROR,
    ) -> None:
        self.scatter = Scatter(runs)
        self._equations = equations
        self._structure = {} if equations is None else {name: StructureLeft(runs, name) for name in runs.sets}
        self._runs, self._measured = runs, runs.measured()
        self._tuning, self._judge, self._noise = tuning, held_out, noise_energy
        self._projection = Projection.of(tuning)
        self._begins = cache(begins)
        self.nothing = self._stand(None, ())

    def without_own_lines(self, fits: Sequence[Fitted]) -> Stand:
        """What first effects are judged against, lines that only the held-out recordings have counting by their own power."""
        if self._judge is not None and self._judge.leave_out_own_lines(fits):
            self._begins.cache_clear()  # they count in these units
            self.nothing = self._stand(None, ())
        return self.nothing

    def after(self, found: Contender) -> Stand:
        """What further effects are judged against."""
        return self._stand(found.fitted, found.gates)

    def _stand(self, fitted: Fitted | None, gates: tuple[Gate, ...]) -> Stand:
        tuning = self._tuning
        if fitted is not None:
            tuning = tuning_at(self._runs, tuning, fitted)
        residual = self._measured - tuning.predicted
        response = self._projection.left(tuning.predicted - self._tuning.predicted)[: len(residual)]
        held_out = None
        if self._judge is not None:
            held_out = self._judge.follow(tuning.offset, () if fitted is None else fitted.settings)
        stand = Stand(fitted, tuning, float(residual @ residual + tuning.offset @ tuning.offset), response, held_out, gates)
        errors = self._begins(TRAIN)
        there = NO_ERROR if self._judge is None else self._begins(HELD_OUT)
        if fitted is not None and self._equations is not None:
            errors = errors.beside(self._equations(TRAIN, tuning, fitted))
            there = there if self._judge is None else there.beside(self._equations(HELD_OUT, tuning, fitted))
            stand = replace(stand, known=True)
        if len(errors.responses):
            errors = FormError(Projection.of(tuning).left(errors.responses), errors.effects)
        return replace(stand, errors=errors, held_out_errors=there)

    def contenders(
        self,
        stand: Stand,
        fits: Sequence[Fitted],
        tried: Tried,
        placebos: tuple[Placebos, Placebos],
        limits: Mapping[EffectAt, tuple[float, float]],
        earlier: int = 0,
    ) -> list[Contender]:
        """Every set with its gate: against the stand where it holds the stand's effects, against nothing where it does not.

        Parameters
        ----------
        stand : Stand
        fits : sequence of Fitted
        tried : Tried
        placebos : pair of Placebos
            Beside the stand and beside nothing.
        limits : mapping
            See `form.lost_form`.
        earlier : int
            Sets that the held-out recordings have been asked about before these, in the same step.
        """
        found, rivals = [], cache(lambda one, placebos: placebos.at(one.tuning, self._measured - one.tuning.predicted))
        for fitted in fits:
            before = stand if set(stand.effects) <= set(fitted.effects) else self.nothing
            after = None if self._judge is None else self._judge.follow(fitted.offset, fitted.settings)
            form = lost_form(fitted, limits, self._measured - fitted.predicted)
            placebo = placebos[0 if before is stand else 1]
            gate = replace(self._gate(before, fitted, after, tried, rivals(before, placebo), earlier + len(fits)), lost_form=form)
            left = 0.0 if self._judge is None else self._judge.misfit(after)
            found.append(
                Contender(
                    fitted,
                    before.certain_gain + gate.certain_gain,
                    self._left(self.nothing) - left,
                    left,
                    (*before.gates, *[gate] * (len(fitted.effects) - len(before.effects))),
                    tried.searched_for(fitted),
                    known=before.known_energy,
                    before=before,
                    placebos=placebo,
                )
            )
        return found

    def closer(self, found: Contender, fitted: Fitted, tried: Tried, limits: Mapping[EffectAt, tuple[float, float]]) -> Contender | None:
        """What passed, with a closer fit of the same effects, asked as it was: None where that does not pass, or leaves more of the
        held-out recordings than chance lets it.
        """
        if found.before is None:
            return None
        placebos, earlier = found.placebos, max(found.gate.asked - 1, 0)
        (closer,) = self.contenders(found.before, [fitted], tried, (placebos, placebos), limits, earlier)
        loses = closer.left_held_out - found.left_held_out
        return closer if closer.passed and loses <= found.gate.needed else None

    def by_chance(self, stand: Stand, fitted: Fitted, tried: Tried) -> float:
        """Expected number of all that were tried that gain as much as a set in training by chance: its gate's first answer. Without one of
        the stand's effects a set gains what these do, too, and no chance of it compares with those of others: infinite.
        """
        return self._trained(stand, fitted, tried).by_chance if set(stand.effects) <= set(fitted.effects) else math.inf

    def _trained(self, before: Stand, fitted: Fitted, tried: Tried) -> _Trained:
        entries = len(self._measured)
        added = [effect for effect in fitted.effects if effect not in before.effects]
        freedom = fitted.freedom - (0 if before.fitted is None else before.fitted.freedom)
        gain = beyond = before.cost - fitted.cost
        projection = Projection.of(before.tuning)
        change = projection.left(fitted.predicted - before.tuning.predicted)
        response = change[:entries]
        scatter, known = self.scatter.known_along(response)
        level = max(1.0, fitted.cost / max(entries, 1))
        variance, of_equations = level * scatter, 0.0
        if before.fitted is not None:
            erring = before.erring(lambda gate: gate.gain, before.errors)
            if before.known:
                variance = max(scatter, self._structure[TRAIN].along(response, self._measured - fitted.predicted))
                of_equations = form_variance(before.response, response, erring, 0.0, elsewhere=_left_at_most(fitted.cost, self._noise))
            else:
                variance += form_variance(before.response, response, erring, fitted.cost - self._noise)
        if len(before.errors.responses):
            beyond = min(gain, before.errors.gain(projection.left_of_residual(self._measured - before.tuning.predicted), change))
        trials = tried.sets(added)
        needed = needed_gain(trials, freedom, fitted.cost, entries)
        by_chance = expected_by_chance(trials, beyond, freedom, variance, of_equations, known)
        return _Trained(gain, beyond, needed, scatter, level, by_chance, change)

    def _gate(self, before: Stand, fitted: Fitted, after: Followed | None, tried: Tried, rivals: Rivals, asked: int) -> Gate:
        entries = len(self._measured)
        trained = self._trained(before, fitted, tried)
        gain, scatter, level = trained.gain, trained.scatter, trained.level
        over_simulator = gain / (level * SIMULATOR_ERROR * entries)
        deviations = fall = followed = there = None
        predicted = seen = None
        if self._judge is not None:
            deviations, fall = self._judge.deviations(before.held_out, after), self._left(before) - self._judge.misfit(after)
            held_out_variance, of_simulator = self._held_out_variance(before, after, scatter)
            there = self._beyond_held_out(before, after, fall)
            followed = chance_held_out(there, held_out_variance) if before.held_out is not None else 1.0  # what diverged shows no fall
            predicted, seen = self._agreement(before, after, there, held_out_variance)
            over_simulator = max(over_simulator, fall / of_simulator)
        return Gate(
            gain=gain,
            needed=trained.needed,
            scatter=scatter,
            trained=trained.by_chance,
            beyond=trained.beyond if len(before.errors.responses) else None,
            over_simulator=over_simulator,
            asked=asked,
            held_out_deviations=deviations,
            held_out_gain=fall,
            held_out_beyond=there,
            followed=followed,
            predicted=predicted,
            seen=seen,
            placebo_gain=rivals.largest,
            beside=rivals.beside(trained.change, gain),
            share=gain / max(self.nothing.cost - self._noise, gain, 1e-9),
            is_first=before.fitted is None,
        )

    def _held_out_variance(self, before: Stand, after: Followed | None, scatter: float) -> tuple[float, float]:
        """Along the change from a stand to a held-out free run, and the fall there that the simulator's own error may be."""
        assert self._judge is not None
        left, count = self._judge.misfit(after), max(float(len(self._judge.measured)), 1.0)
        level = max(1.0, left / count)
        variance, of_simulator = level * scatter, level * SIMULATOR_ERROR * count
        if before.held_out is None or after is None or before.fitted is None or self.nothing.held_out is None:
            return variance, of_simulator
        found, added = before.held_out.predicted - self.nothing.held_out.predicted, after.predicted - before.held_out.predicted
        erring = before.erring(lambda gate: gate.held_out_gain or 0.0, before.held_out_errors)
        if not before.known:
            return variance + form_variance(found, added, erring, left - count), of_simulator
        seen = self._structure[HELD_OUT].along(added, self._judge.measured - after.predicted)
        return max(scatter, seen) + form_variance(found, added, erring, 0.0), of_simulator

    def _beyond_held_out(self, before: Stand, after: Followed | None, fall: float) -> float:
        """Of a held-out fall, what errors of the equations found before do not explain: more, where what is added works against them."""
        if self._judge is None or before.held_out is None or after is None or not len(before.held_out_errors.responses):
            return fall
        taken = [before.held_out_errors.taken_by(self._judge.measured - run.predicted) for run in (before.held_out, after)]
        return fall - taken[0] + taken[1]

    def _agreement(self, before: Stand, after: Followed | None, fall: float, variance: float) -> tuple[float | None, float | None]:
        """Length of a held-out change and how far the recordings go along it, in standard deviations of the noise along it.

        `fall` is the misfit's, beyond what errors of the equations found before explain; of a length L, z deviations lower it by
        2 L z - L^2.
        """
        if self._judge is None or before.held_out is None or after is None:
            return None, None
        squared = self._judge.squared_change(before.held_out, after)
        squared -= before.held_out_errors.taken_by(after.predicted - before.held_out.predicted)
        if squared <= 0.0:
            return 0.0, 0.0
        length, deviation = float(np.sqrt(squared)), float(np.sqrt(variance))
        return length / deviation, 0.5 * (fall + squared) / length / deviation

    def _left(self, stand: Stand) -> float:
        """Held-out misfit."""
        return 0.0 if self._judge is None else self._judge.misfit(stand.held_out)


def _left_at_most(left: float, noise: float) -> float:
    """Above the noise, by a standard deviation of it and of how well it is known."""
    return max(left - noise, 0.0) + math.hypot(math.sqrt(2.0 * noise), NOISE_KNOWN * noise)
