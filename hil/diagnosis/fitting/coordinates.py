"""Coordinates of a fit: tuned numbers in units of their prior, and effects' free parameters in units of their size where the fit is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.fitting.information import Free
from hil.diagnosis.fitting.visited import RANGE_AS_DEVIATION, Visited
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.candidates import setting_of
from hil.diagnosis.starting.start_frequencies import LIGHTEST
from hil.diagnosis.tuning.free_run import Trial
from hil.diagnosis.tuning.retune import LARGEST_CHANGE, PRIOR, Tuning
from virtual_bus.effects.effect import Parameter
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

STEP_SHARE = 0.01
"""Difference for sensitivities, as a share of a parameter's size."""

FINE_SHARE = 0.003
"""The same of those that intervals are computed from, to both sides, where they move the simulation by no more than noise does."""

SMALLEST_SHARE = 1e-7
"""Of a parameter's range: the size of one that starts at zero is never taken for less."""

SMALLEST_OF_START = 0.01
"""The same for other parameters, of their start: a range made for machines of tonnes says nothing about a spring of milligrammes."""

SHAPE_FROM_ZERO = 0.1
"""Of the range of a number without a unit that decides a shape: its size where it starts at zero, from which it else could not move."""

FROM_ZERO_AT_ANY = (("imu_bandwidth", "shape"),)
"""Such numbers that have this size where they start elsewhere, too: a fit that a far machine bends to nothing of it could not come back.
The shape of a lag behind a low pass would end near zero, where hundreds in units of noise are left."""

NOT_FITTED = ("seed", "side", "sign", "length")
"""Parameters that only take some values: they stay where screening put them."""

AT_MOST = {("backlash", "flank"): ("b", 9.0)}
"""Parameters that are no more than so many times another one of their effect. Within wider flanks a spring keeps more than nine tenths of
its stiffness: that is no gap but a spring that hardens, a law of its own. Most recordings do not show how wide flanks are, and fits that
may go there do so for gains of 1 to 6 in units of noise, of 100 to 2900. Those that want it for more are no gaps (`form.WANTED`)."""

LOGARITHMIC = ("vs", "f", "fc", "sigma0", "K", "z_max", "tau", "k", "Np", "Nl")
INVERSE = ("fc",)
"""Corner frequencies: what they do is in proportion to one over them."""

ORDER_UNIT = "cycles/turn"
FREQUENCY_UNIT = "Hz"
"""Of an effect that has a phase too it turns that by as much as the recording is long: a hundredth of 10 Hz is six radians after 10 s."""

OF_A_MODE = {("structural_mode", "f"): 2.0 * LIGHTEST * RANGE_AS_DEVIATION}
"""Deviation, over itself, of a frequency beforehand whose search counts modes a bandwidth apart (`starts.shapes_of`): it is within one."""

PHASE_STEP = 0.02

TURNED_BY = {"A1": "phi1", "A2": "phi2", "e1": "phi1", "e2": "phi2", "a": "phi", "A": "phi"}
"""Phases of waves' amplitudes. An amplitude that goes through zero is the wave half a cycle on: held at zero, where its phase does nothing,
a harmonic that begins at the wrong one stays there."""

WEAKER = (0.3, 0.1, 0.03)
"""Shares of a start's strength that are tried where the start is worse than no effect."""

TUNED_REACH = 1.0
"""Of a first step in the tuned numbers, in units of their prior."""

HELD = 0.99
"""Of the largest step, from which a parameter's step was held by the region; it is at least the parameter's own size there."""


def fitted_parameters(effect: EffectAt) -> int:
    """How many of an effect's parameters are fitted."""
    return sum(parameter.name not in NOT_FITTED for parameter in effects()[effect.effect].parameters)


@dataclass(frozen=True, eq=False)
class Point:
    """Tuned coordinates and the effects' parameters."""

    offset: np.ndarray
    values: tuple[np.ndarray, ...]


class Coordinates:
    """What is fitted: tuned coordinates, and effects' free parameters in units of their size where the fit is."""

    def __init__(self, tuning: Tuning, names: tuple[EffectAt, ...], starts: tuple[np.ndarray, ...], visited: Visited) -> None:
        self._tuning, self._names, self._visited = tuning, names, visited
        self._parameters = [
            tuple(_between(p, visited.range_of_a_place(name, p)) for p in effects()[name.effect].parameters) for name in names
        ]
        self.free = tuple((e, k) for e, own in enumerate(self._parameters) for k, p in enumerate(own) if p.name not in NOT_FITTED)
        phases = [_of_a_phase(names[e], self._parameters[e][k], visited) for e, k in self.free]
        places = [visited.range_of_a_place(names[e], self._parameters[e][k]) for e, k in self.free]
        least = [_least_size(names[e], self._parameters[e][k], starts[e][k]) for e, k in self.free]
        wide = [None if place is None else RANGE_AS_DEVIATION * (place[1] - place[0]) for place in places]
        fixed = [phase if place is None else place for phase, place in zip(phases, wide, strict=True)]
        self._is_fixed = [size is not None for size in fixed]
        self._least = [own if size is None else size for own, size in zip(least, fixed, strict=True)]

    def point(self, offset: np.ndarray, values: tuple[np.ndarray, ...]) -> Point:
        """Where a fit may start: these values, all within their ranges and none more than it may be beside the others."""
        each = zip(self._names, values, self._parameters, strict=True)
        within = [(name, np.clip(np.asarray(own, dtype=float), [p.low for p in ps], [p.high for p in ps])) for name, own, ps in each]
        return Point(offset, tuple(_within(name, own) for name, own in within))

    def _phase_of(self, e: int, k: int) -> int | None:
        """Which of an effect's parameters is the phase of this amplitude; None of what is none."""
        names = [parameter.name for parameter in self._parameters[e]]
        phase = TURNED_BY.get(names[k])
        return names.index(phase) if phase in names else None

    def ranges(self) -> np.ndarray:
        """(F,) how far the bounds of the free parameters are apart."""
        return np.array([self._parameters[e][k].high - self._parameters[e][k].low for e, k in self.free])

    def settings(self, at: Point) -> tuple[EffectSetting, ...]:
        return tuple(setting_of(name, own) for name, own in zip(self._names, at.values, strict=True))

    def trial(self, at: Point) -> Trial:
        return Trial(self._tuning.at(at.offset), self.settings(at))

    def moves(self, at: Point) -> list[tuple[Point, float]]:
        """Neighbours in every free parameter, and how far they are in units of its size."""
        found = []
        for (e, k), size in zip(self.free, self._sizes(at), strict=True):
            parameter, value = self._parameters[e][k], at.values[e][k]
            step = PHASE_STEP if is_phase(parameter) else STEP_SHARE
            if _is_inverse(parameter, value):
                found.append((Point(at.offset, _with(at.values, e, k, value / (1.0 + step))), step))
                continue
            neighbour = value + step * size
            if neighbour > self._highest(e, k, at.values):
                neighbour = value - step * size
            found.append((Point(at.offset, _with(at.values, e, k, neighbour)), (neighbour - value) / size))
        return found

    def around(self, at: Point, shares: np.ndarray) -> list[tuple[Point, Point, float]]:
        """Neighbours on both sides of every free parameter, these shares (F,) of its size away, as far as its range goes, and how far they
        are apart in its unit.
        """
        found = []
        for (e, k), size, share in zip(self.free, self._sizes(at), shares, strict=True):
            parameter, value = self._parameters[e][k], at.values[e][k]
            up, down = min(value + share * size, self._highest(e, k, at.values)), max(value - share * size, parameter.low)
            found.append((Point(at.offset, _with(at.values, e, k, up)), Point(at.offset, _with(at.values, e, k, down)), up - down))
        return found

    def reach(self, at: Point, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest step of all coordinates: to their bounds, and not further than they are trusted."""
        bound = LARGEST_CHANGE / PRIOR
        low, high = list(np.maximum(-bound - at.offset, -TUNED_REACH * radius)), list(np.minimum(bound - at.offset, TUNED_REACH * radius))
        for (e, k), size in zip(self.free, self._sizes(at), strict=True):
            parameter, value = self._parameters[e][k], at.values[e][k]
            up = 1.0 if is_phase(parameter) else 3.0
            down = 0.6 if parameter.name in LOGARITHMIC else up
            if _is_inverse(parameter, value):
                low.append(max(value / parameter.high - 1.0, -0.8 * min(radius, 1.0)))
                high.append(up * radius)
            else:
                lowest = parameter.low if self._phase_of(e, k) is None else -parameter.high
                low.append(max((lowest - value) / size, -down * min(radius, 1.0) if down < 1.0 else -down * radius))
                high.append(min((self._highest(e, k, at.values) - value) / size, up * radius))
        return np.array(low), np.array(high)

    def was_held(self, step: np.ndarray, reach: tuple[np.ndarray, np.ndarray]) -> bool:
        """Whether a step of the effects' parameters was as large as it may be in the region: much weaker than it should be, an effect gains
        nothing at first.
        """
        own = step[-len(self.free) :]
        return bool(np.any((own >= HELD * reach[1][-len(own) :]) & (own >= HELD)))

    def moved(self, at: Point, step: np.ndarray) -> Point:
        """The point a step leads to."""
        offset, values = at.offset + step[: len(at.offset)], at.values
        for (e, k), size, change in zip(self.free, self._sizes(at), step[len(at.offset) :], strict=True):
            parameter, value = self._parameters[e][k], values[e][k]
            to = value / (1.0 + change) if _is_inverse(parameter, value) else value + change * size
            phase = self._phase_of(e, k)
            if phase is not None and to < 0.0:
                to, values = -to, _with(values, e, phase, values[e][phase] + np.pi)
            if is_phase(parameter) and parameter.high - parameter.low >= 2.0 * np.pi:
                to = (to + np.pi) % (2.0 * np.pi) - np.pi
            values = _with(values, e, k, float(np.clip(to, parameter.low, parameter.high)))
        return Point(offset, tuple(_within(name, own) for name, own in zip(self._names, values, strict=True)))

    def slopes(self, at: Point) -> np.ndarray:
        """(F,) factors from sensitivities per size to sensitivities per unit of the parameter."""
        found = []
        for (e, k), size in zip(self.free, self._sizes(at), strict=True):
            value = at.values[e][k]
            found.append(-1.0 / value if _is_inverse(self._parameters[e][k], value) else 1.0 / size)
        return np.array(found)

    def described(self, at: Point) -> list[Free]:
        """The free parameters."""
        found = []
        for (e, k), size in zip(self.free, self._sizes(at), strict=True):
            name, parameter = self._names[e], self._parameters[e][k]
            beforehand = OF_A_MODE.get((name.effect, parameter.name), 1.0)
            found.append(Free(e, parameter, self._visited.what_changes(name, parameter, float(at.values[e][k])), size, beforehand))
        return found

    def _highest(self, e: int, k: int, values: tuple[np.ndarray, ...]) -> float:
        return min(self._parameters[e][k].high, _most(self._names[e], self._parameters[e][k], values[e]))

    def _sizes(self, at: Point) -> list[float]:
        found = []
        for (e, k), least, is_fixed in zip(self.free, self._least, self._is_fixed, strict=True):
            found.append(least if is_fixed else max(abs(at.values[e][k]), least))
        return found


def weaker(name: EffectAt, values: tuple[np.ndarray, ...], share: float) -> tuple[np.ndarray, ...]:
    """The last effect with this share of its strengths."""
    last = values[-1].copy()
    for k, parameter in enumerate(effects()[name.effect].parameters):
        if parameter.is_strength and parameter.name not in NOT_FITTED:
            last[k] = last[k] / share if _is_inverse(parameter, last[k]) else parameter.neutral + share * (last[k] - parameter.neutral)
            last[k] = np.clip(last[k], parameter.low, parameter.high)
    return (*values[:-1], _within(name, last))


def _most(effect: EffectAt, parameter: Parameter, values: np.ndarray) -> float:
    """Of a parameter beside the effect's others."""
    if (effect.effect, parameter.name) not in AT_MOST:
        return np.inf
    other, times = AT_MOST[effect.effect, parameter.name]
    names = [one.name for one in effects()[effect.effect].parameters]
    return times * float(values[names.index(other)])


def _within(effect: EffectAt, values: np.ndarray) -> np.ndarray:
    """Values with none more than it may be beside the others."""
    most = [_most(effect, parameter, values) for parameter in effects()[effect.effect].parameters]
    return np.minimum(values, most)


def _between(parameter: Parameter, ends: tuple[float, float] | None) -> Parameter:
    return parameter if ends is None else replace(parameter, low=ends[0], high=ends[1])


def is_phase(parameter: Parameter) -> bool:
    """Whether it goes round."""
    return parameter.unit == "phase" and not parameter.is_strength


def difference(parameter: Parameter, value: float, other: float) -> float:
    """Of two values of a parameter; of phases, which go round, within half a turn of zero."""
    apart = value - other
    return float(np.remainder(apart + np.pi, 2.0 * np.pi) - np.pi) if is_phase(parameter) else float(apart)


def nearest_form(effect: EffectAt, values: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Values with a wave's amplitude turned round, and its phase half a turn on, where that is nearer to another's: the same wave."""
    parameters, found = effects()[effect.effect].parameters, np.array(values)
    names = [parameter.name for parameter in parameters]
    for a, k in ((names.index(a), names.index(phase)) for a, phase in TURNED_BY.items() if a in names and phase in names):
        turned = np.array(found)
        turned[a], turned[k] = -found[a], found[k] + np.pi
        forms = (found, turned) if is_phase(parameters[k]) else (found,)
        far = [np.hypot(form[a] - other[a], other[a] * difference(parameters[k], form[k], other[k])) for form in forms]
        found = forms[int(np.argmin(far))]
    return found


def _is_order(parameter: Parameter) -> bool:
    return parameter.unit == ORDER_UNIT and not parameter.is_strength


def _is_inverse(parameter: Parameter, value: float) -> bool:
    """Whether a parameter is fitted as one over itself, in which its effect is closer to linear."""
    return parameter.name in INVERSE and value > 0.0


def _of_a_phase(effect: EffectAt, parameter: Parameter, visited: Visited) -> float | None:
    """Size of what turns a phase, one radian of it: an order over the motor's way, a frequency over the time."""
    if is_phase(parameter):
        return 1.0
    if _is_order(parameter):
        return visited.one_over_a_radian()
    if parameter.unit == FREQUENCY_UNIT and any(map(is_phase, effects()[effect.effect].parameters)):
        return 1.0 / (2.0 * np.pi * max(visited.time_s, 1e-12))
    return None


def _least_size(effect: EffectAt, parameter: Parameter, start: float) -> float:
    """What a parameter's size, a large change of it, is never taken for less than."""
    if (effect.effect, parameter.name) in FROM_ZERO_AT_ANY:
        start = 0.0
    of_range = SMALLEST_SHARE if parameter.is_strength or parameter.unit else SHAPE_FROM_ZERO
    return max(SMALLEST_OF_START * abs(start) if start != 0.0 else of_range * (parameter.high - parameter.low), 1e-12)


def _with(values: Sequence[np.ndarray], effect: int, number: int, value: float) -> tuple[np.ndarray, ...]:
    changed = [np.array(v) for v in values]
    changed[effect][number] = value
    return tuple(changed)
