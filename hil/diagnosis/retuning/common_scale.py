"""What no motion shows: a scale that all efforts, inertias and drives' constants have in common."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hil.diagnosis.retuning.numbers import Numbers
from virtual_bus.effects.effect import Parameter, power_of_force
from virtual_bus.plant.forces import CONSTANT, force_power, holds_force
from virtual_bus.settings import EffectSetting


@dataclass(frozen=True, eq=False)
class CommonScale:
    """How nuisances and parameters (P + Q,) change where the scale is larger by one share, and the constant among them that shows most."""

    changes: np.ndarray
    constant: int

    @property
    def taken_out(self) -> np.ndarray:
        """How nuisances and parameters of a machine whose constant stays change (P + Q, P + Q) with those of one on the same scale."""
        found = np.eye(len(self.changes))
        found[:, self.constant] -= self.changes / self.changes[self.constant]
        return found

    def set_constant(self, columns: np.ndarray) -> None:
        """Set the constant's column among all (N, P + Q) to what the others have it: in sum nothing shows.

        Its own difference, of rounded or linear equations, does not cancel them as far as what motions show.
        """
        rest = self.changes.copy()
        rest[self.constant] = 0.0
        columns[:, self.constant] = -(columns @ rest) / self.changes[self.constant]


def common_scale(
    numbers: Numbers, offset: np.ndarray, settings: Sequence[EffectSetting], parameters: Sequence[tuple[int, Parameter]],
    known: Iterable[EffectSetting], energies: np.ndarray,
) -> CommonScale | None:  # fmt: skip
    """Return the scale at nuisances (P,), with their columns' squares, and effects; None where a force is held, as a known one's is."""
    values = numbers.values(offset[: len(numbers.indices)])
    own = {int(index): k for k, index in enumerate(numbers.indices) if numbers.low[k] < numbers.high[k]}
    found, constants = np.zeros(len(offset) + len(parameters)), []
    for index, parameter in enumerate(numbers.plant.parameters):
        if (power := force_power(parameter)) != 0.0 and values[index] != 0.0:
            if index not in own:
                return None
            found[own[index]] = power * values[index] / numbers.scale[own[index]]
            constants += [own[index]] if parameter.quantity == CONSTANT else []
    free = [{one.name for k, one in parameters if k == number} for number in range(len(settings))]
    if any(map(holds_force, known)) or any(map(holds_force, settings, free)):
        return None
    for column, (k, sought) in enumerate(parameters, len(offset)):
        found[column] = power_of_force(sought.unit) * settings[k].parameters[sought.name]
    return CommonScale(found, max(constants, key=lambda k: float(energies[k] * found[k] ** 2))) if constants else None
