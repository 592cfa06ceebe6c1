"""What a fit narrows its parameters by: the part of its price (`naming.py`) that depends on how large they may be beforehand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from virtual_bus.effects.effect import Parameter


@dataclass(frozen=True)
class Free:
    """A parameter that was fitted."""

    effect: int  # which of the set
    parameter: Parameter
    value: float  # of one that takes the place of a number in the machine file, what changes (`visited.what_changes`)
    size: float  # which the Hessian counts it in
    beforehand: float = 1.0  # deviation that it may have beforehand, in units of its size


class Form(NamedTuple):
    """A set whose laws are without some of their terms: the energy that recordings lose, (F',) information on what is left, and which free
    parameters are absent.
    """

    loss: float
    information: np.ndarray
    absent: tuple[int, ...]


def information_of(hessian: np.ndarray, tuned: int, free: Sequence[Free]) -> np.ndarray:
    """(F,) energies that recordings lose by changes of parameters as large as they may be beforehand, in independent directions.

    A strength may be as large as it is, so an amplitude's phase 1 rad: cosine and sine part have one deviation, and the joint density of
    amplitude and phase at it is that of two such parts. A place may be anywhere in its range (`visited.py`), an order and a frequency so
    far off as one of those is that the search counted (`starts.shapes_of`). Of a law with several strengths each may be so large that it
    alone does what all of them do: one that was fitted to nothing might have been as large, and a law that holds a simpler one pays for
    what it found to be zero; it may also be without that term (`simpler_forms`). A limit, whose response is not in proportion to it, may be
    off by as much as it is. How finely a strength near zero is counted says nothing about how large it may be.

    Parameters
    ----------
    hessian : (tuned + F, tuned + F) array
        Of |residual|^2 + |offset|^2 over two, the first `tuned` rows those of the machine's numbers, which are free.
    tuned : int
    free : sequence of Free
    """
    return _narrowed(_own(hessian, tuned), free)


def simpler_forms(hessian: np.ndarray, tuned: int, free: Sequence[Free]) -> tuple[Form, ...]:
    """Every set whose laws are without some of their terms, everything else fitted again; arguments as of `information_of`.

    The strengths of a law that have one unit are one term: a friction that differs with direction may have a level, a viscous coefficient
    or both. A law that keeps none of its terms is none.
    """
    own = _own(hessian, tuned)
    values = np.array([one.value / one.size if is_in_proportion(one.parameter) else 0.0 for one in free])
    found = []
    for absent in _absent_terms(free):
        kept = [n for n in range(len(free)) if n not in absent]
        across = own[np.ix_(kept, absent)]
        diagonal = np.diag(own)[kept]
        units = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))  # sizes are of any magnitude; what is not seen may be rounded below zero
        moved = np.linalg.lstsq(own[np.ix_(kept, kept)] / np.outer(units, units), across / units[:, None], rcond=None)[0] / units[:, None]
        rest = own[np.ix_(absent, absent)] - across.T @ moved
        loss = max(float(values[absent] @ rest @ values[absent]), 0.0)
        there = values[kept] + moved @ values[absent]
        parts = []
        for n, value in zip(kept, there, strict=True):
            one = free[n]
            if is_in_proportion(one.parameter):
                one = replace(one, value=value * one.size)
            parts.append(one)
        found.append(Form(loss, _narrowed(own[np.ix_(kept, kept)], parts), tuple(absent)))
    return tuple(found)


def is_in_proportion(parameter: Parameter) -> bool:
    """Whether an effect's response grows from nothing as this strength does: not that of a limit, which does nothing where it is large."""
    return parameter.is_strength and parameter.neutral == 0.0


def _absent_terms(free: Sequence[Free]) -> Iterator[list[int]]:
    """Which parameters a set is without, of every choice of terms in which each of its laws keeps one at least and some are missing."""
    choices = []
    for effect in sorted({one.effect for one in free}):
        terms: dict[str, list[int]] = {}
        keeps_one = False
        for n, one in enumerate(free):
            if one.effect == effect and is_in_proportion(one.parameter):
                terms.setdefault(one.parameter.unit, []).append(n)
            elif one.effect == effect and one.parameter.is_strength:
                keeps_one = True
        most = len(terms) if keeps_one else max(len(terms) - 1, 0)
        missing = [some for count in range(most + 1) for some in combinations(terms.values(), count)]
        choices.append([[n for term in some for n in term] for some in missing])
    for some in product(*choices):
        absent = [n for each in some for n in each]
        if absent:
            yield absent


def _own(hessian: np.ndarray, tuned: int) -> np.ndarray:
    """(F, F) of the effects' parameters with the machine's numbers free."""
    across = hessian[:tuned, tuned:]
    return np.asarray(hessian[tuned:, tuned:] - across.T @ np.linalg.solve(hessian[:tuned, :tuned], across))


@dataclass(frozen=True, eq=False)
class Narrowed:
    """By what held-out recordings narrow a set's parameters, of which training knows something already.

    Attributes
    ----------
    trained, held_out : (F, F) array
        Information of both on the parameters, in units of how far these may be off beforehand.
    """

    trained: np.ndarray
    held_out: np.ndarray

    @classmethod
    def of(cls, trained: np.ndarray, held_out: np.ndarray, free: Sequence[Free]) -> Narrowed:
        """From information in the units of `free`."""
        scales = _scales(trained + held_out, free)
        within = scales * scales[:, None]
        return cls(trained * within, held_out * within)

    def cost(self, train: float = 1.0, held_out: float = 1.0) -> float:
        """In log evidence, where misfits of training and held-out recordings count in units of these levels."""
        known = np.eye(len(self.trained)) + self.trained / train
        return 0.5 * float(np.linalg.slogdet(known + self.held_out / held_out)[1] - np.linalg.slogdet(known)[1])

    def in_units(self, train: float, held_out: float) -> Narrowed:
        return Narrowed(self.trained / train, self.held_out / held_out)


def _narrowed(own: np.ndarray, free: Sequence[Free]) -> np.ndarray:
    scales = _scales(own, free)
    return np.maximum(np.linalg.eigvalsh(own * scales * scales[:, None]), 0.0)


def _scales(own: np.ndarray, free: Sequence[Free]) -> np.ndarray:
    """(F,) how far parameters may be off beforehand, in their units."""
    scales = np.array([one.beforehand for one in free])
    for effect in {one.effect for one in free}:
        strengths = [n for n, one in enumerate(free) if one.effect == effect and is_in_proportion(one.parameter)]
        shares = np.array([free[n].value / free[n].size for n in strengths])
        energy = max(float(shares @ own[np.ix_(strengths, strengths)] @ shares), 0.0)
        for n, share in zip(strengths, shares, strict=True):
            alone = np.sqrt(energy / own[n, n]) if own[n, n] > 0.0 else np.inf
            scales[n] = min(max(abs(share), alone), (free[n].parameter.high - free[n].parameter.low) / free[n].size)
    return scales
