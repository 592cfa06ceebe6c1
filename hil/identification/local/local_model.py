"""Orders and windows of a local model, and what they require of the data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.errors import IdentificationError

Border = Literal["asymmetric", "periodic"]


@dataclass(frozen=True)
class LocalModel:
    """Orders and windows of the local polynomial or rational method; the defaults are those of Sec. 3.5.3.

    Attributes
    ----------
    numerator : N_n, order of the response's numerator over frequency (fast methods).
    transient : N_m, order of the transient's numerator.
    denominator : N_d, order of both denominators; 0 gives the local polynomial method.
    transient_window : unexcited bins to either side in the transient's fit; None takes the 2 (P - 1) of (3.29), or what leaves n_z
        degrees of freedom where that is more.
    plant_window : excited lines to either side in the response's fit; None takes what leaves n_z + 2 degrees of freedom.
    border : "asymmetric" shifts the response's window at the ends of the band; "periodic" goes on with the spectrum's mirror images, which
        a sampled system allows and which pays only where lines are excited down to 0 or up to half the sample rate.
    skip_periods : leading periods left out although the transient is estimated, e.g. those of a brake's release.
    """

    numerator: int = 2
    transient: int = 2
    denominator: int = 1
    transient_window: int | None = None
    plant_window: int | None = None
    border: Border = "asymmetric"
    skip_periods: int = 0

    def __post_init__(self) -> None:
        """Check the orders."""
        for name in ("numerator", "transient", "denominator", "skip_periods"):
            if getattr(self, name) < 0:
                raise IdentificationError(f"{name} = {getattr(self, name)}: orders are 0 or more")

    @property
    def name(self) -> str:
        """The method's short name."""
        return "lpm" if self.denominator == 0 else "lrm"

    @property
    def settings(self) -> dict[str, float | int | str]:
        """Return the settings that a result records."""
        return {"N_n": self.numerator, "N_m": self.transient, "N_d": self.denominator, "border": self.border}


def transient_offsets(model: LocalModel, periods: int, n_y: int, n_z: int) -> np.ndarray:
    """Return the bins r of (3.29) round an excited bin.

    They are the nearest bins that no harmonic of the period occupies, strictly more than there are unknowns.

    Raises
    ------
    IdentificationError
        One period only; a window that leaves no degree of freedom, with the one that would do.
    """
    if periods < 2:
        raise IdentificationError(
            "one period has no bins between its lines to estimate a transient from: record two or more, or use an arbitrary method"
        )
    unknowns = model.transient + 1 + n_y * model.denominator
    enough = unknowns // 2 + 1
    wanted = model.transient_window
    if wanted is None:
        wanted = max(periods - 1, (unknowns + n_z + 1) // 2)
    elif 2 * wanted <= unknowns:
        raise IdentificationError(
            f"transient_window = {wanted}: {2 * wanted} bins for {unknowns} unknowns (N_m + 1 + n_y N_d, n_y = {n_y})"
            f" leave no degree of freedom; transient_window = {enough} or more would do"
        )
    candidates = np.arange(1, 2 * wanted + 2)
    positive = candidates[candidates % periods != 0][:wanted]
    return np.concatenate((-positive[::-1], positive))


def half_width(model: LocalModel, unknowns: int, rows_per_line: int, n_z: int, lines: int) -> int:
    """Return how many excited lines to either side of the centre the response's fit uses.

    Raises
    ------
    IdentificationError
        No degree of freedom left, with the window that would do; more lines asked for than are excited.
    """
    enough = smallest_half_width(unknowns + 1, rows_per_line)
    wanted = model.plant_window
    if wanted is None:
        wanted = smallest_half_width(unknowns + n_z + 2, rows_per_line)
    elif (2 * wanted + 1) * rows_per_line <= unknowns:
        raise IdentificationError(
            f"plant_window = {wanted}: {(2 * wanted + 1) * rows_per_line} equations for {unknowns} unknowns leave no degree of freedom;"
            f" plant_window = {enough} or more would do"
        )
    if 2 * wanted + 1 > lines:
        raise IdentificationError(
            f"the window of {2 * wanted + 1} excited lines ({unknowns} unknowns) is wider than the {lines} lines that are excited;"
            " excite more lines or lower the orders"
        )
    return wanted


def smallest_half_width(equations: int, rows_per_line: int) -> int:
    """Return the smallest n for which 2 n + 1 lines give at least this many equations."""
    lines = -(-equations // rows_per_line)
    return max(lines // 2, 0) if lines % 2 else lines // 2


def powers(x: np.ndarray, order: int) -> np.ndarray:
    """Return x, x^2, ... without the constant: (..., order)."""
    return x[..., None] ** np.arange(1, order + 1)
