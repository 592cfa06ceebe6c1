"""By how much the equations of effects may err, as shares of what they remove: of laws, of numbers alone, and of what is exact.

The weights that are fitted to the concealed benchmark's development cases stand here together, since what equations err by is fitted with
the rest of them; those of names alone (`exact`, `unknown_freedom`, `outside`) are used in ranking.

From it comes T, the temper: log evidence counts misfit in units of T, so that two names are told apart only where they differ by more than
an equation's form usually errs.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.result import EffectAt
from virtual_bus.effects.effect import SIGN
from virtual_bus.effects.registry import effects


@dataclass(frozen=True)
class Weights:
    """What confidences rest on besides the recordings: fitted to development cases by `python benchmarks/concealed calibrate`.

    Attributes
    ----------
    form_error : float
        Share of the removed energy by which a right name's equation may err before it counts against the name.
    left_weight : float
        The same for the energy the best set leaves above noise: where much is left, small differences between sets mean little.
    exact : float
        Probability, beforehand, that the right name's equation errs by nothing that these recordings show.
    unknown_freedom : float
        Parameters that something without a name is charged with: it could explain whatever is above noise.
    outside : float
        Share of answers whose recordings a wrong name explains down to the noise: physics in no catalogue that a known effect imitates.
    """

    form_error: float
    left_weight: float
    exact: float
    unknown_freedom: float
    outside: float


WEIGHTS = Weights(form_error=0.0099, left_weight=0.019, exact=0.23, unknown_freedom=7.8, outside=0.48)

NUMBERS = ("viscous_friction", "torque_constant", "payload", "joint_compliance", "imu_bandwidth", "rectified_sensor")
"""Effects that are numbers of the machine file, further off than re-tuning may go: their equation is the machine's own.
A sign is one too, where it is whole."""

EXACT = (*NUMBERS, "gear_ratio", "imu_misalignment")
"""Effects of which numbers alone are unknown: those of the machine file, a gear's ratio, where an IMU's axes point.
What they do may be of any size and leaves no room for another law. A clock's offset is read by a cubic, an IMU's scale and bias are the
same for all axes of its gyro: both equations err by more."""

WHOLE = 0.01
"""How near none or all of its sign a channel has lost it: a share between imitates what acts in one direction."""

NUMBERS_ERROR = 1e-5
"""Share of the energy removed by an effect of numbers alone by which it may err all the same: 0.3 % of its response. Beside a viscous
friction a thousand times above noise, with nothing else there, another friction gains 4e-6 of its energy."""

ERRS_AS_A_LAW = {"viscous_friction": 0.02}
"""Of the share by which laws err, that by which a number does that stands for a law: what shears is never quite proportional to speed. By
2e-4 of its energy, 1.4 % of its response, a viscous friction errs in another friction's ways. One that falls by 16 % at the highest speed
differs from an asymmetric one of equal levels and slopes by 5.5e-4 of what it removes."""

LEAST_ERROR = 3e-6
"""Share of the energy removed by which an equation errs however exact it is: 0.17 % of its response, in ways that none of its error
functions spans. With nothing else there, a clock's offset gained 41.8 beside a drive's lag of 3390 deviations, and 731 beside a clipped
current of 16 360. Beside a gear's error that was not found, of 18.7 deviations, an asymmetric friction gained 477 over the right one, a
viscous friction of 27 840."""


def numbers_of(fitted: Fitted | None) -> frozenset[EffectAt]:
    """Those of a set's effects of which numbers alone are unknown."""
    if fitted is None:
        return frozenset()
    each = zip(fitted.effects, fitted.values, strict=True)
    return frozenset(
        effect for effect, values in each if effect.effect in EXACT and (effect.effect != "rectified_sensor" or is_a_whole_sign(values))
    )


def whole_signs_of(fitted: Fitted | None) -> frozenset[EffectAt]:
    """Those of a set's effects that are right or wrong, and err by nothing."""
    return frozenset(effect for effect in numbers_of(fitted) if effects()[effect.effect].kind is SIGN)


def is_a_whole_sign(values: np.ndarray) -> bool:
    """Whether a channel has lost none or all of its sign, by the parameters of `rectified_sensor`."""
    share, sign = values
    return bool(min(abs(share), abs(1.0 - share)) < WHOLE and abs(sign) == 1.0)


def share_of_numbers(numbers: Collection[EffectAt]) -> float:
    """Of the energy that effects of numbers alone remove, as much as errs by NUMBERS_ERROR; the rest errs as laws do."""
    return 1.0 - max((ERRS_AS_A_LAW.get(effect.effect, 0.0) for effect in numbers), default=0.0)


def are_of_the_file(fitted: Fitted | None) -> bool:
    """Whether all that `numbers_of` has of a set are numbers of the machine file."""
    return all(effect.effect in NUMBERS for effect in numbers_of(fitted))


class Removing(NamedTuple):
    """What a set removes."""

    misfit: float
    by_numbers: float = 0.0  # energy that those of its effects remove which are EXACT, but for what errs as laws do
    of_the_file: bool = True  # whether these are all numbers of the machine file
    by_signs: float = 0.0  # so much of that energy those that are whole signs, which err by nothing


def temperature_of(sets: Sequence[Removing], base: float, noise: float, weights: Weights = WEIGHTS) -> float:
    """T of sets that compete.

    In what EXACT effects of the best set remove no equation erred but by NUMBERS_ERROR, and where it is a whole sign by nothing; numbers of
    the machine file count in any set that T does not tell from it, that of which T is least: a law that holds one of them as a part is a
    little closer. What else is exact has neighbours that are not.

    Parameters
    ----------
    sets : sequence of Removing
    base : float
        Misfit without effects.
    noise : float
        Expected misfit of a perfect simulation.
    weights : Weights
    """
    best = min(one.misfit for one in sets)
    return min(
        temperature(base - best - one.by_numbers, best - noise, weights) + numbers_err_by(one.by_numbers, one.by_signs)
        for one in likely_of(sets, base, noise, weights)
    )


def likely_of(sets: Sequence[Removing], base: float, noise: float, weights: Weights = WEIGHTS) -> list[Removing]:
    """The best set and those of numbers of the machine file that T is not known to tell from it; parameters as in `temperature_of`."""
    best = min(one.misfit for one in sets)
    near = best + 2.0 * temperature(base - best, best - noise, weights)
    return [one for one in sets if one.misfit == best or (one.of_the_file and one.misfit <= near)]


def erring(removed: float, by_numbers: float) -> float:
    """Energy by which a set's equations may err that removes so much, so much of it by EXACT effects. A whole sign errs as other numbers
    do where a set is not told apart from another: what it does to a simulation that is a little off is in no other law.
    """
    return WEIGHTS.form_error * max(removed - by_numbers, 0.0) + NUMBERS_ERROR * max(by_numbers, 0.0)


def numbers_err_by(by_numbers: float, by_signs: float) -> float:
    """Energy by which numbers err that remove so much, of that so much by whole signs, which err by nothing; a number that another motion
    does not want removes less there than its sign alone.
    """
    return NUMBERS_ERROR * max(by_numbers - by_signs, 0.0)


def temperature(removed: float, left: float, weights: Weights = WEIGHTS) -> float:
    """T, from the energies that the best set removes and leaves above noise."""
    return 1.0 + weights.form_error * max(removed, 0.0) + weights.left_weight * max(left, 0.0)


def form_variance(found: np.ndarray, added: np.ndarray, erring: float, left: float, elsewhere: float = math.inf) -> float:
    """Variance along a response that the equations of the effects found before may add to the noise's.

    An equation errs by a share of its own response wherever that is, with any sign: of the energy of its error no more is along another
    response than the squared cosine of both responses' absolute values. What is left above noise counts as in naming's temperature.

    Parameters
    ----------
    found, added : (M,) arrays
        Whitened responses.
    erring, left : float
        Energy of the equations' error, and what is left above noise.
    elsewhere : float
        What is left above noise beside the added response, both fitted with all other numbers. What of an error these do not take up has
        the rest of its energy there: equations that leave nothing erred by little. Beside a soft spring that removes 2·10^8 a gear's error
        may take 1090 of 1120, down to the noise. Held out, where nothing is fitted, errors are not bounded so.
    """
    sizes = float(np.sqrt((found @ found) * (added @ added)))
    alike = float(np.abs(found) @ np.abs(added)) / sizes if sizes > 0.0 else 0.0
    seen = elsewhere / max(1.0 - alike**2, 1e-3)
    return alike**2 * min(erring, seen) + temperature(0.0, left) - 1.0
