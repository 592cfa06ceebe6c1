"""How a set of effects stands to another one that it is told apart from."""

from __future__ import annotations

from typing import NamedTuple


class Compared(NamedTuple):
    """How a set stands to another one of as many effects: in pairs, training and held out.

    What chance gains is taken off neither. Where noise varies more along what tells them apart than the noise model says, so much more of
    it counts there beside what equations err by. What sets that were added to the same ones have in common errs alike in both: where it is
    known how (`form_error.py`), they differ beside such errors, and what it removed does not count. Where equations are exact they have no
    errors.
    """

    reference: tuple[float, float]  # misfits of the other one
    apart: tuple[float, float]  # what this one leaves more with training's parameters
    beyond: tuple[float, float]  # the same beside errors of what both have
    by_moving: tuple[float, float] = (0.0, 0.0)  # and so much more since both were moved to what both motions want
    scatter: float = 1.0  # variance of the noise along their difference, in units of the noise model's
    known: tuple[float, float] = (0.0, 0.0)  # energies that effects removed which both have, and of which it is known how they err

    def in_units(self, part: int, level: float, form_error: float) -> float:
        """Misfit in training (0) or held out (1)."""
        apart = self.beside_errors(part) if form_error else self.apart[part] + self.by_moving[part]
        return self.reference[part] / level + apart / self.unit(part, level, form_error)

    def unit(self, part: int, level: float, form_error: float) -> float:
        """What the difference counts in."""
        return max(level - form_error * self.known[part], 1.0) + self.scatter - 1.0

    def beside_errors(self, part: int) -> float:
        """What it leaves more where both motions want both sets, beside errors of what both have: of that these explain the share that they
        explain with training's parameters.
        """
        apart, left = self.apart[part], self.apart[part] + self.by_moving[part]
        share = min(max(left / apart, 0.0), 1.0) if apart else 1.0
        return left - share * (apart - self.beyond[part])
