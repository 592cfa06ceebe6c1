"""How much more rarely one law of no catalogue does what several known effects do together than what one of them does."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hil.diagnosis.result import EffectAt
from virtual_bus.effects.places import part_at
from virtual_bus.settings import PlantSettings

UNLIKE_ONE = float(np.log(45.0 / 9.0))
"""Logarithm of how much oftener one law of no catalogue is best imitated by one known effect than by several at one part of a machine: of
52 answers of the concealed benchmark to such laws in which an effect was named or came closest, the likeliest set had one effect in 44 and
several in 8 (and one of each beforehand, Laplace's rule). The benchmark hides no effect, one, a pair, or exactly one law of no catalogue:
never three, never two without names. So this is known of one such law at one place, and says nothing of how often a machine has more of
them."""

UNLIKE_ONE_PART = UNLIKE_ONE + float(np.log(2.0))
"""The same for several effects at several parts, which imitate a law at one place more seldom still: in none of the 42 such answers on
machines that have several parts. That none was seen says little where no law that acts at several parts was hidden (a link that bends,
say): half as often as several at one part, set by hand, and not the one in 37 that Laplace's rule makes of them."""


def rarity_of(effects: Sequence[EffectAt], settings: PlantSettings) -> float:
    """Logarithm of how much more rarely one law without a name does what these do than what one effect does.

    Effects of one kind at one place are one law in a wave form of its own, and count as one.
    """
    return rarity_at({(effect.effect, effect.at): part_at(effect.at, settings) for effect in effects}.values())


def rarity_at(parts: Iterable[str]) -> float:
    """The same by the part at which each law acts."""
    parts = list(parts)
    if len(parts) < 2:
        return 0.0
    return UNLIKE_ONE if len(set(parts)) == 1 else UNLIKE_ONE_PART
