"""What the demo's emulated machine hides: drawn by a seed, sealed before anything is recorded, opened after the answer."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hil.machine import Machine
from hil.machine.effects_file import read_effects_file
from virtual_bus.effects.registry import effects
from virtual_bus.errors import EffectError
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import EffectSetting

LIMITS = Path(__file__).parent / "limits.toml"
"""Every effect that the demo's recordings could show, at its detection limit; written by `benchmarks/demo_seeds.py limits`."""

TIMES = 2.0, 5.0
"""Strengths are drawn between these multiples of the detection limit."""

MOST = 2
"""Effects at most."""

SEEN = ("stribeck_friction", "roll"), 30.0
"""What is hidden where no seed is given, and how many detection limits it is strong: an axis that sticks, which the eye finds."""


@dataclass(frozen=True)
class Envelope:
    """What a seed hides.

    Attributes
    ----------
    seed : int or None
        None where the demo's own effect is hidden.
    effects : tuple of EffectSetting
    times : tuple of float
        How many detection limits each is strong.
    """

    seed: int | None
    effects: tuple[EffectSetting, ...]
    times: tuple[float, ...]

    @property
    def text(self) -> str:
        """What is in the envelope, as JSON."""
        hidden = [
            {"effect": one.name, "at": one.at, "parameters": one.parameters, "times_detection_limit": times}
            for one, times in zip(self.effects, self.times, strict=True)
        ]
        return json.dumps({"seed": self.seed, "hidden": hidden}, indent=2) + "\n"

    @property
    def seal(self) -> str:
        """SHA-256 of the text: what `sha256sum envelope.json` prints of the opened one."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def to_be_seen(machine: Machine) -> Envelope:
    """Return what the demo hides where no seed is given."""
    which, times = SEEN
    (least,) = (one for one in read_effects_file(LIMITS, machine) if (one.name, one.at) == which)
    strong = stronger(least, times)
    assert strong is not None
    return Envelope(None, (strong,), (times,))


def drawn(machine: Machine, seed: int) -> Envelope:
    """Return what a seed hides: one effect or two, over every effect and place that the recordings could show.

    Evenly, but for those that the catalogue bounds below five limits, which are drawn anew where they would be stronger.
    """
    able = read_effects_file(LIMITS, machine)
    rng = np.random.default_rng(seed)
    count = 1 + int(rng.integers(MOST))
    while True:
        times = tuple(float(round(each, 3)) for each in rng.uniform(*TIMES, count))
        hidden = [stronger(able[k], by) for k, by in zip(rng.choice(len(able), count, replace=False), times, strict=True)]
        whole = tuple(one for one in hidden if one is not None)
        if len(whole) == count and _can_run(machine, whole):
            return Envelope(seed, whole, times)


def stronger(setting: EffectSetting, by: float) -> EffectSetting | None:
    """Return an effect that is `by` times as strong; None where the catalogue does not go so far."""
    values = dict(setting.parameters)
    for parameter in effects()[setting.name].parameters:
        if parameter.is_strength:
            values[parameter.name] = parameter.neutral + by * (values[parameter.name] - parameter.neutral)
            if not parameter.low <= values[parameter.name] <= parameter.high:
                return None
    return replace(setting, parameters=values)


def _can_run(machine: Machine, hidden: Sequence[EffectSetting]) -> bool:
    try:
        compile_plant(machine.plant).model(effects=hidden)
    except EffectError:
        return False
    return True
