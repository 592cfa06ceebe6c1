"""What a fit narrows its parameters by: the part of its price (`naming.py`) that depends on how large they may be beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from virtual_bus.effects.effect import Parameter


@dataclass(frozen=True)
class Free:
    """A parameter that was fitted."""

    effect: int  # which of the set
    parameter: Parameter
    value: float
    size: float  # which the Hessian counts it in
    beforehand: float = 1.0  # deviation that it may have beforehand, in units of its size


def information_of(hessian: np.ndarray, tuned: int, free: Sequence[Free]) -> np.ndarray:
    """(F,) energies that recordings lose by changes of parameters as large as they may be beforehand, in independent directions.

    A strength may be as large as it is, so an amplitude's phase 1 rad: cosine and sine part have one deviation, and the joint density of
    amplitude and phase at it is that of two such parts. A place may be anywhere in its range (`visited.py`), an order and a frequency so
    far off as one of those is that the search counted (`starts.shapes_of`). Of a law with several strengths each may be so large that it
    alone does what all of them do: one that was fitted to nothing might have been as large, and a law that holds a simpler one pays for
    what it found to be zero. How finely a strength near zero is counted says nothing about how large it may be.

    Parameters
    ----------
    hessian : (tuned + F, tuned + F) array
        Of |residual|^2 + |offset|^2 over two, the first `tuned` rows those of the machine's numbers, which are free.
    tuned : int
    free : sequence of Free
    """
    across = hessian[:tuned, tuned:]
    own = hessian[tuned:, tuned:] - across.T @ np.linalg.solve(hessian[:tuned, :tuned], across)
    scales = np.array([one.beforehand for one in free])
    for effect in {one.effect for one in free}:
        strengths = [n for n, one in enumerate(free) if one.effect == effect and one.parameter.is_strength]
        shares = np.array([(free[n].value - free[n].parameter.neutral) / free[n].size for n in strengths])
        energy = max(float(shares @ own[np.ix_(strengths, strengths)] @ shares), 0.0)
        for n, share in zip(strengths, shares, strict=True):
            alone = np.sqrt(energy / own[n, n]) if own[n, n] > 0.0 else np.inf
            scales[n] = min(max(abs(share), alone), (free[n].parameter.high - free[n].parameter.low) / free[n].size)
    return np.maximum(np.linalg.eigvalsh(own * scales * scales[:, None]), 0.0)
