"""Machines drawn within the ranges that a file states beside its effects (`_between`), and the machine of their root mean squares.

A size that lies between two levels is drawn evenly over the logarithm, with either sign where the effect may have one; from zero, or
from below it, evenly. Machines of one set are a Latin hypercube (McKay, Beckman, Conover 1979): each size is drawn once from every equal
part of its range, so that the root mean squares of a few machines are those of many. A file without ranges leaves nothing to draw but
the sensors' noise.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from hil.machine.machine import Machine
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting


def drawn(machine: Machine, number: int, of: int, seed: int = 0) -> Machine:
    """Return machine `number`, from 0, of a set of so many, whose effects lie somewhere in their ranges."""
    quantity = 0

    def share() -> float:
        nonlocal quantity
        quantity += 1
        strata = np.random.default_rng([seed, quantity])
        return float((strata.permutation(of) + strata.random(of))[number] / of)

    def size(low: float, high: float, signed: bool) -> float:
        part = share()
        if low <= 0.0:
            return low + part * (high - low)
        value = float(low * (high / low) ** part)
        return -value if signed and share() < 0.5 else value

    return _with(machine, size)


def typical(machine: Machine) -> Machine:
    """Return the machine whose effects are the root mean squares of those drawn, which is what is known of one before it is measured."""

    def size(low: float, high: float, signed: bool) -> float:
        square = (high**2 - low**2) / (2.0 * np.log(high / low)) if low > 0.0 else (high**3 - low**3) / (3.0 * (high - low))
        return float(np.sqrt(square))

    return _with(machine, size)


def spans(effect: EffectSetting) -> dict[str, list[tuple[float, float]]]:
    """Return in which ranges each size of an effect may lie, the least first: in two where it may have either sign."""
    both = {name: low > 0.0 and _is_signed(effect, name) for name, (low, _) in effect.between.items()}
    return {name: [(-high, -low), (low, high)] if both[name] else [(low, high)] for name, (low, high) in effect.between.items()}


def ends(effect: EffectSetting) -> Iterator[EffectSetting]:
    """Yield an effect at every combination of the least and the greatest of its sizes; itself where it has no ranges."""
    for values in itertools.product(*((each[0][0], each[-1][1]) for each in spans(effect).values())):
        yield replace(effect, parameters=effect.parameters | dict(zip(effect.between, values, strict=True)))


def _is_signed(effect: EffectSetting, name: str) -> bool:
    return next(each.low < 0.0 for each in effects()[effect.name].parameters if each.name == name)


def _with(machine: Machine, size: Callable[[float, float, bool], float]) -> Machine:
    own = []
    for effect in machine.own_effects:
        values = {name: size(*pair, _is_signed(effect, name)) for name, pair in effect.between.items()}
        own.append(replace(effect, parameters=effect.parameters | values, scatter=0.0, between={}))
    chosen = (*own, *machine.added_effects)
    return replace(machine, plant=replace(machine.plant, effects=chosen), own_effects=tuple(own))
