"""A set of effects fitted to the whitened recordings, its parameters and the machine's numbers together: Gauss-Newton within bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.diagnosis.candidates.columns import Column, column
from hil.diagnosis.candidates.entries import free_parameters, moved
from hil.diagnosis.model_choice.fixed_scale import Held, held_at
from hil.diagnosis.model_choice.form_error import FormError, form_columns
from hil.diagnosis.model_choice.plausibility import are_driven, on_bound, pressed_against, signals_of
from hil.diagnosis.residuals.noise_likelihood import ACCURACY
from hil.diagnosis.residuals.trajectory import Signals
from hil.diagnosis.retuning.bounded import bounded_least_squares
from hil.diagnosis.retuning.linear_model import DETERMINED, LinearModel, LinearRecord
from virtual_bus.effects.effect import PHASE, Parameter
from virtual_bus.effects.registry import effects
from virtual_bus.errors import EffectError
from virtual_bus.settings import EffectSetting

ITERATIONS = 8
HALVINGS = 4
CONVERGED = 0.3
"""Decrease of the squared innovations, in units of noise, below which a fit has ended: a tenth of what a parameter must bring."""
NOISE_MARGIN = 0.16
"""Of the noise's squares, by which repeats may miss them: two differ by chance, and sound machines leave so much."""
STRETCHES = 20
"""Stretches of all recordings: fewer would show the scatter badly, more would cut through what errs together."""
STEP = 0.02
"""Of a difference, as a share of a parameter: laws with corners need a step that is longer than a row."""
MOST_CHANGED = 0.1
"""Of an effect, by the step of one of its shapes."""
SHAPE_STEPS, STRENGTH_STEP, PHASE_STEP = 15.0, 1.0, 0.5
"""How far a shape goes at once, in its difference's steps; a strength, as a share of it; a phase [rad]: effects are linear nearby only."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A set of effects at its best parameters.

    Attributes
    ----------
    settings : tuple of EffectSetting
    offset : (P,) array
        Nuisances, as in `LinearModel`.
    squares : float
        Squared innovations, less the likeliest form errors.
    innovations : tuple of (N m,) arrays
        What is left.
    columns : tuple of (N m, P + Q) arrays
        Nuisances, then the effects' free parameters.
    parameters : tuple of (int, Parameter)
        Which effect's each free parameter is.
    is_noise_known : bool
        From repeats.
    form : FormError
        What the laws may be wrong by, where noise is known.
    form_squares : float
        Squares of the likeliest form errors, in standard deviations.
    readings : int
    is_pressed : (P,) bool array
        Which nuisances lie on a bound that the recordings press them against: no law has to be told apart from them.
    is_sensible : bool
        Whether the drives still give most of what they gave, and no parameter is pressed against a bound: else it is no finding.
    """

    settings: tuple[EffectSetting, ...]
    offset: np.ndarray
    squares: float
    innovations: tuple[np.ndarray, ...]
    columns: tuple[np.ndarray, ...]
    parameters: tuple[tuple[int, Parameter], ...]
    is_noise_known: bool
    form: FormError
    form_squares: float
    readings: int
    is_pressed: np.ndarray
    is_sensible: bool = True

    @cached_property
    def dispersion(self) -> float:
        """How many times the scatter of white noise the fitted numbers and parameters have, by what stretches of the recordings say alone.

        What no equation knows is seldom white: a law that is a little wrong errs the same way for a while. One at least. The mean over
        numbers and parameters of the variance of their scores over blocks (White 1982, the sandwich's filling). Where noise is known from
        repeats it is what is left over what noise leaves (McCullagh and Nelder 1989): gains count less until a set explains what is there.
        """
        if self.is_noise_known:
            return max(1.0, self.squares / max(self.readings, 1))
        rows = sum(len(rest) for rest in self.innovations)
        scores, squares = [], np.zeros(self.columns[0].shape[1])
        for rest, columns in zip(self.innovations, self.columns, strict=True):
            count = max(1, round(STRETCHES * len(rest) / rows))
            for inside in np.array_split(np.arange(len(rest)), count):
                scores.append(columns[inside].T @ rest[inside])
            squares += np.einsum("ij,ij->j", columns, columns)
        each = np.array(scores)
        spread = np.sum((each - each.mean(axis=0)) ** 2, axis=0) * len(each) / max(len(each) - 1, 1)
        determined = squares > DETERMINED
        return max(1.0, float(np.mean(spread[determined] / squares[determined]))) if determined.any() else 1.0

    def without_columns(self) -> Fitted:
        """Return what it costs and where it is: columns and innovations of many fits would fill the memory."""
        bare = replace(self, innovations=(), columns=(), form=self.form.without_columns())
        bare.__dict__["dispersion"] = self.dispersion
        return bare

    def cost(self, dispersion: float = 1.0) -> float:
        """Return squared innovations, in units of what scatters, and the numbers' prior."""
        known = float(self.offset @ self.offset) + self.form_squares
        return self.squares / dispersion + known + self.form.log_determinant(dispersion)

    @property
    def with_form(self) -> list[np.ndarray]:
        """Columns (N m, P + Q + K), with those of what laws may be wrong by."""
        return [np.hstack([each, form]) for each, form in zip(self.columns, self.form.columns, strict=True)]

    @property
    def prior(self) -> np.ndarray:
        """Inverse variances (P + Q + K,) of nuisances, parameters and form errors before anything was recorded."""
        return np.concatenate([np.ones(len(self.offset)), np.zeros(len(self.parameters)), np.ones(self.form.count)])

    @property
    def names(self) -> frozenset[tuple[str, str]]:
        """Effect and place of each."""
        return frozenset((setting.name, setting.at) for setting in self.settings)


def fit(
    linear: LinearModel, settings: Sequence[EffectSetting], offset: np.ndarray | None = None, dispersion: float = 1.0,
    longest: float = np.inf,
) -> Fitted | None:  # fmt: skip
    """Fit a set of effects from these parameters; None where the machine cannot take them together.

    Squared innovations count in units of `dispersion` beside the numbers' prior. `longest` is how far a nuisance may go from where the
    machine was seen, in standard deviations of its prior.
    """
    settings = tuple(settings)
    offset = linear.offset.copy() if offset is None else offset
    parameters = free_parameters(settings)
    try:
        acting, left, squares = _left(linear, settings, offset)
    except EffectError:
        return None
    columns: tuple[np.ndarray, ...] = ()
    form = _form(linear, acting, settings, dispersion)
    fastest = 0.5 / max(one.equations.trajectory.observed.period_s for one in linear.records)
    for _ in range(ITERATIONS):
        held = held_at(linear, settings, offset, parameters)
        found = [_columns(linear, one, own, held, parameters, rest) for one, own, rest in zip(linear.records, acting, left, strict=True)]
        columns = tuple(each for each, _ in found)
        shortest = zip(parameters, np.abs([steps for _, steps in found]).min(axis=0).tolist(), strict=True)  # of all recordings
        reaches = [reach(parameter, settings[k].parameters[parameter.name], least, fastest) for (k, parameter), least in shortest]
        step = _step(linear, held, offset, parameters, columns, left, 1.0 / dispersion, longest, form, reaches)
        cost = _cost(left, squares, offset, form)
        taken = _shortened(linear, settings, offset, parameters, step, cost, form)
        if taken is None:
            break
        settings, offset, acting, left, squares = taken
        gained = cost - _cost(left, squares, offset, form)
        form = _form(linear, acting, settings, dispersion)
        if gained < CONVERGED:
            break
    reduced, form_squares = form.taken_from(left)
    squares += float(sum(after @ after - before @ before for before, after in zip(left, reduced, strict=True)))
    pressed = pressed_against(linear, offset, columns, reduced, dispersion)
    sensible = are_driven(linear, settings) and not on_bound(settings, parameters, columns, reduced, dispersion)
    return Fitted(
        settings, offset, squares, reduced, columns, parameters, not linear.levels.are_assumed, form, form_squares, linear.readings,
        pressed, sensible,
    )  # fmt: skip


def _cost(left: Sequence[np.ndarray], squares: float, offset: np.ndarray, form: FormError) -> float:
    """Return the cost up to a constant, with the likeliest form errors; `squares` are those of what is left, and of what is unsure."""
    reduced, form_squares = form.taken_from(left)
    squares += float(sum(after @ after - before @ before for before, after in zip(left, reduced, strict=True)))
    return squares / form.dispersion + float(offset @ offset) + form_squares


def _form(linear: LinearModel, acting: Sequence[Acting], settings: tuple[EffectSetting, ...], dispersion: float) -> FormError:
    """Return the form errors of laws where noise is known; where it is assumed, they are part of what scatters."""
    if linear.levels.are_assumed or not settings:
        return FormError([np.zeros((len(one.innovations), 0)) for one in linear.records], dispersion)
    columns = []
    for one, its in zip(linear.records, acting, strict=True):
        own: list[Column] = []
        for setting, change in zip(settings, its.alone, strict=True):
            if not effects()[setting.name].is_exact:
                own += form_columns(change, one.motion)
        whitened = one.whiten(own) if own else np.zeros((len(one.innovations), 0))
        columns.append(_times(whitened, 1.0 / its.weaker) if own else whitened)
    return FormError(columns, dispersion)


@dataclass(frozen=True, eq=False)
class Acting:
    """What a set of effects does along one recording.

    Attributes
    ----------
    signals : Signals
        With all of them.
    together : Column
        What they change.
    alone : tuple of Column
        What each by itself does.
    moved : tuple of Column
        What each by itself changes of the machine that was seen: the same, but of effects that it was seen with.
    weaker : (m + axes,) array
        By how much less a drive's effort shows in each reading.
    """

    signals: Signals
    together: Column
    alone: tuple[Column, ...]
    moved: tuple[Column, ...]
    weaker: np.ndarray


def _acting(linear: LinearModel, settings: tuple[EffectSetting, ...]) -> list[Acting]:
    """Return what effects do along every recording."""
    found = []
    for one in linear.records:
        signals = signals_of(linear, one, settings) if settings or one.changes else one.signals
        together = column(one.signals, signals)
        if len(settings) == 1 and not one.changes:
            found.append(Acting(signals, together, (together,), (together,), weaker_by(one, signals)))
            continue
        alone, moved = [], []
        for each in settings:
            own, before = signals_of(linear, one, (each,)), one.change_alone.get((each.name, each.at))
            alone.append(column(one.plain, own))
            moved.append(alone[-1] if before is None else column(before[1], own))
        found.append(Acting(signals, together, tuple(alone), tuple(moved), weaker_by(one, signals)))
    return found


def _left(
    linear: LinearModel, settings: tuple[EffectSetting, ...], offset: np.ndarray
) -> tuple[list[Acting], tuple[np.ndarray, ...], float]:
    """Return what effects do beside nuisances, the innovations that both leave, and their squares with what is unsure of them."""
    held, left, unsure = held_at(linear, settings, offset, free_parameters(settings)), [], 0.0
    acting, away = _acting(linear, held.settings), held.offset - linear.offset
    for one, its in zip(linear.records, acting, strict=True):
        unsure += float(one.energies @ away**2)
        rest = one.innovations - one.numbers @ away
        if its.alone or linear.changes:
            columns = [its.together, *its.moved] if len(its.alone) > 1 or linear.changes else [its.together]
            whitened = one.whiten(columns)
            unsure += float(np.sum(whitened[:, min(1, len(columns) - 1) :] ** 2))
            rest = _times(rest - whitened[:, 0], 1.0 / its.weaker)
        left.append(rest)
    squares = ACCURACY**2 * unsure + float(sum(rest @ rest for rest in left))
    return acting, tuple(left), squares


def alone(linear: LinearModel, fitted: Fitted, number: int) -> list[np.ndarray]:
    """Return what (N m,) one effect of a fitted set changes of every recording's innovations beside the others."""
    others = (*fitted.settings[:number], *fitted.settings[number + 1 :])
    changes = []
    for one in linear.records:
        whole = signals_of(linear, one, fitted.settings)
        change = column(signals_of(linear, one, others), whole)
        changes.append(_times(one.whiten([change]), 1.0 / weaker_by(one, whole))[:, 0])
    return changes


def weaker_by(one: LinearRecord, acting: Signals) -> np.ndarray:
    """Return by how much weaker (m + axes,) than the file's what acts makes the drives whose joints each reading shows.

    Noise is known in the drives' units: otherwise every drive would be found weaker than it is, and every gear worse, since that makes all
    efforts smaller.
    """
    trajectory = one.equations.trajectory
    gains = acting.model[0]["effort_gain"] / one.equations.model[0]["effort_gain"]
    passed = trajectory.passed_by_friction(one.motion, acting.model) / trajectory.passed_by_friction(one.motion, one.equations.model)
    weaker = np.ones(one.equations.left.shape[1])
    joints = {sensor.channel: sensor.joints for sensor in trajectory.settings.joint_sensors}
    for drive, gain in zip(trajectory.settings.drives, gains, strict=False):
        for c, channel in enumerate(trajectory.observed.channels):
            if drive.joint in joints.get(channel, ()):
                weaker[c] = min(weaker[c], max(float(gain * passed[trajectory.joints.index(drive.joint)]), 1e-3))
    return weaker


def _times(values: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Return innovations (N m,) or columns (N m, C) times a factor (m,) of each reading."""
    by_reading = values.reshape(-1, len(factors), *values.shape[1:])
    scaled: np.ndarray = by_reading * factors.reshape(-1, *(1 for _ in values.shape[1:]))
    return scaled.reshape(values.shape)


def _columns(
    linear: LinearModel, one: LinearRecord, acting: Acting, held: Held, parameters: Sequence[tuple[int, Parameter]], rest: np.ndarray
) -> tuple[np.ndarray, list[float]]:
    """Return what (N m, P + Q) the innovations `rest` (N m,) lose per unit of nuisances and parameters, by differences, and their steps."""
    settings, here, weaker = held.settings, acting.signals, acting.weaker
    columns, rescaled, steps = [], [], []
    for k, parameter in parameters:
        try:
            step, moved, change = _change(linear, one, settings, k, parameter, here)
        except EffectError:
            steps.append(difference(settings, k, parameter))
            columns.append(column(here, here))
            rescaled.append(np.zeros_like(weaker))
            continue
        steps.append(step)
        columns.append(change)
        rescaled.append((weaker_by(one, moved) / weaker - 1.0) / step)
    whole = _times(np.hstack([one.numbers, one.whiten(columns)]), 1.0 / weaker)
    for number, gain in enumerate(rescaled, one.numbers.shape[1]):
        if gain.any():
            whole[:, number] += _times(rest, gain)
    if held.scale is not None:
        held.scale.set_constant(whole)
    return whole, steps


def _change(
    linear: LinearModel, one: LinearRecord, settings: tuple[EffectSetting, ...], number: int, parameter: Parameter, here: Signals
) -> tuple[float, Signals, Column]:
    """Return a parameter's step, what the machine does with it, and what that changes per unit of it.

    Steps of shapes are short enough that little of the effect itself changes: over a recording, a wave's frequency or order is known to a
    small part of a period. Where noise is assumed they stay long: waves then stay where the lines of a spectrum put them.
    """
    step, own = difference(settings, number, parameter), 0.0
    if not parameter.is_strength and parameter.unit != PHASE and not linear.levels.are_assumed:
        own = column(signals_of(linear, one, (*settings[:number], *settings[number + 1 :])), here).size
    while True:
        there = signals_of(linear, one, moved(settings, [(number, parameter)], [step]))
        change = column(here, there, step)
        share = abs(step) * change.size / own if own > 0.0 else 0.0
        if share <= MOST_CHANGED:
            return step, there, change
        step *= 0.5 * MOST_CHANGED / share


def difference(settings: Sequence[EffectSetting], k: int, parameter: Parameter) -> float:
    """Return the step by which a parameter of an effect is differentiated: down where there is no room above."""
    value = settings[k].parameters[parameter.name]
    step = STEP if parameter.unit == PHASE else STEP * abs(value) if abs(value) > parameter.small else parameter.small
    return -step if value + step > parameter.high else step


def _step(
    linear: LinearModel, held: Held, offset: np.ndarray, parameters: Sequence[tuple[int, Parameter]],
    columns: Sequence[np.ndarray], left: Sequence[np.ndarray], weight: float, longest: float, form: FormError,
    reaches: Sequence[tuple[float, float]],
) -> np.ndarray:  # fmt: skip
    count = len(offset)
    left, _ = form.taken_from(left)
    squares = weight * sum(each.T @ each for each in columns)
    if form.count:
        across = sum(each.T @ own for each, own in zip(columns, form.columns, strict=True))
        squares = squares - weight * across @ form.solved(across.T)
    slopes = weight * sum(each.T @ rest for each, rest in zip(columns, left, strict=True))
    squares[range(count), range(count)] += 1.0
    slopes[:count] -= offset
    energies = ACCURACY**2 * np.diag(squares).copy()
    energies[:count] -= ACCURACY**2
    begun = {key: setting.parameters for key, (setting, _) in linear.records[0].change_alone.items()}
    strengths = []
    for k, parameter in parameters:
        setting = held.settings[k]
        before = begun.get((setting.name, setting.at), {}).get(parameter.name, parameter.neutral)
        strengths.append(setting.parameters[parameter.name] - before if parameter.is_strength else 0.0)
    at = np.append(held.offset - linear.offset, strengths)
    energies[count:] *= [p.is_strength for _, p in parameters]
    taken_out = np.eye(len(slopes)) if held.scale is None else held.scale.taken_out
    squares += taken_out.T @ (energies[:, None] * taken_out)
    slopes -= taken_out.T @ (energies * at)
    free = linear.bounds
    low = list(np.maximum(free[0], -longest) + linear.offset - offset)
    high = list(np.minimum(free[1], longest) + linear.offset - offset)
    low += [below for below, _ in reaches]
    high += [above for _, above in reaches]
    return bounded_least_squares(squares, slopes, np.array(low), np.array(high))


def reach(parameter: Parameter, value: float, step: float, fastest_Hz: float = np.inf) -> tuple[float, float]:
    """Return how far down and up a parameter may go at once that was differentiated by this step: a shape by fifteen of them.

    A frequency stays below the fastest that rows show.
    """
    high = max(min(parameter.high, fastest_Hz), value) if parameter.unit == "Hz" and not parameter.is_strength else parameter.high
    if parameter.unit == PHASE:
        most = PHASE_STEP
    elif abs(value) <= parameter.small:  # a strength that has met zero may go on to the other side
        most = np.inf if parameter.is_strength else parameter.small
    else:
        most = STRENGTH_STEP * abs(value) if parameter.is_strength else SHAPE_STEPS * abs(step)
    return max(parameter.low - value, -most), min(high - value, most)


def _shortened(
    linear: LinearModel, settings: tuple[EffectSetting, ...], offset: np.ndarray, parameters: Sequence[tuple[int, Parameter]],
    step: np.ndarray, cost: float, form: FormError,
) -> tuple[tuple[EffectSetting, ...], np.ndarray, list[Acting], tuple[np.ndarray, ...], float] | None:  # fmt: skip
    """Return the first of the step and its halves that lowers the cost; None where none does."""
    for halving in range(HALVINGS):
        share = 0.5**halving
        there, further = moved(settings, parameters, share * step[len(offset) :]), offset + share * step[: len(offset)]
        try:
            acting, left, squares = _left(linear, there, further)
        except EffectError:
            continue
        if _cost(left, squares, further, form) < cost:
            return there, further, acting, left, squares
    return None
