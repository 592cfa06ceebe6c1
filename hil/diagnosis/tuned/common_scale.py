"""What no motion shows: a scale that all efforts, inertias and drives' constants have in common (Gautier 1991, base parameters)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hil.diagnosis.tuned.numbers import Numbers
from virtual_bus.effects.effect import Parameter, power_of_force
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

CONSTANT, BRAKE = "constant", "brake_effort"


def common_scale(
    numbers: Numbers,
    offset: np.ndarray,
    settings: Sequence[EffectSetting],
    parameters: Sequence[tuple[int, Parameter]],
    known: Iterable[EffectSetting],
) -> np.ndarray | None:
    """Return how nuisances and parameters (P + Q,) change where all efforts and inertias are larger by one share; None where some are held.

    The machine then moves as before, and everything that is measured but efforts in Nm or N stays.

    Parameters
    ----------
    numbers : Numbers
    offset : (P,) array
        Nuisances: numbers, then sensors' zeros.
    settings, parameters : sequence of EffectSetting; of (int, Parameter)
        Effects, and which one's each free parameter is.
    known : iterable of EffectSetting
        Effects that act besides, and are not fitted.
    """
    values = numbers.values(offset[: len(numbers.indices)])
    is_free = numbers.low < numbers.high
    own = {int(index): k for k, index in enumerate(numbers.indices) if is_free[k]}
    found = np.zeros(len(offset) + len(parameters))
    for index, parameter in enumerate(numbers.plant.parameters):
        power = 1.0 if parameter.quantity == CONSTANT else power_of_force(parameter.unit)
        if power == 0.0 or values[index] == 0.0 or parameter.quantity == BRAKE:
            continue
        if index not in own:
            return None
        found[own[index]] = power * values[index] / numbers.scale[own[index]]
    held = [(setting, {one.name for k, one in parameters if settings[k] is setting}) for setting in settings]
    held += [(setting, set()) for setting in known]
    for setting, names in held:
        every = effects()[setting.name].parameters
        if any(one.name not in names and power_of_force(one.unit) and setting.parameters[one.name] for one in every):
            return None
    for column_of, (number, sought) in enumerate(parameters, len(offset)):
        found[column_of] = power_of_force(sought.unit) * settings[number].parameters[sought.name]
    return found if first_constant(numbers, found) is not None else None


def first_constant(numbers: Numbers, scale: np.ndarray) -> int | None:
    """Return the nuisance that is the first drive's constant, where the common scale changes it."""
    return next((k for k, name in enumerate(numbers.names) if name.endswith(f".{CONSTANT}") and scale[k]), None)


def set_constant(numbers: Numbers, scale: np.ndarray, columns: np.ndarray) -> None:
    """Set the first drive's constant among columns (N, P + Q) of nuisances and parameters to what the others have it: in sum nothing shows.

    Its own difference, of rounded or linear equations, does not cancel them as far as what motions show.
    """
    constant = first_constant(numbers, scale)
    rest = scale.copy()
    rest[constant] = 0.0
    columns[:, constant] = -(columns @ rest) / scale[constant]
