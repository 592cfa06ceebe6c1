"""Sample dropout: readings that are lost, while the last one is held."""

from __future__ import annotations

import numpy as np

from virtual_bus.effects.effect import DROPOUT, Effect, Parameter
from virtual_bus.effects.law import Law, Place
from virtual_bus.effects.readings import Readings, Shown, held_readings, runs

EFFECT = Effect(
    name="sample_dropout",
    plain="Readings get lost now and then, and the last one is repeated.",
    kind=DROPOUT,
    parameters=(
        Parameter("p", unit="", low=0.0, high=1.0, description="share of the time in which samples are lost"),
        Parameter("length", unit="", low=1.0, high=1000.0, description="samples lost at once", is_strength=False),
        Parameter(
            "seed",
            unit="",
            low=0.0,
            high=1000000000.0,
            description="of the losses' own random stream: the same in every run",
            is_strength=False,
            fixed=True,
        ),
    ),
    equation="y_k = y_(k-1) with probability p per burst",
    convention=(
        "time is cut into bursts of `length` samples (rounded); in a share p of them, chosen at random by the seed, the channel "
        "repeats its last reading, noise included; never before the first whole reading"
    ),
    neighbours=("encoder_quantization",),
    source="Schenato 2009, zero-order hold on packet loss",
    family="timing",
    is_exact=True,
    left_out="which readings are lost is chance",
)


def is_lost(sample: int, p: float, length: float, seed: float) -> bool:
    """Return whether the last reading is repeated at this sample.

    A hash of burst and seed decides (splitmix64).
    """
    if p <= 0.0 or sample <= 0:
        return False
    burst = np.uint64(sample // int(length + 0.5))
    x = (burst + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(seed) * np.uint64(0xD1B54A32D192ED03)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    x = x ^ (x >> np.uint64(31))
    return float(x >> np.uint64(11)) / 9007199254740992.0 < p


def in_readings(readings: Readings) -> Shown | None:
    """Return the share of bursts in which readings are held, and their length.

    Bursts that are lost with a share p of the time follow each other with that probability: a run is length / (1 - p) rows long.
    """
    found = held_readings(readings)
    if found is None:
        return None
    p = found.count / found.rows
    on_end = runs(found.readings)
    length = max(float(np.mean(on_end)) * (1.0 - p), 1.0)
    unsure = 1.96 * float(np.sqrt(p * (1.0 - p) * length / found.rows))
    longer = 1.96 * float(np.std(on_end) / np.sqrt(len(on_end))) + 0.5  # bursts are whole samples long
    seeds = next(parameter for parameter in EFFECT.parameters if parameter.name == "seed")
    values = {
        "p": (p, max(p - unsure, 0.0), min(found.most / found.rows + unsure, 1.0)),
        "length": (length, max(length - longer, 1.0), length + longer),
        "seed": (0.0, seeds.low, seeds.high),  # readings do not show it
    }
    said = f"{found.count} of {found.rows} readings that should differ from the last are the same"
    return Shown(values, readings.step, found.readings, said)


def laws(place: Place) -> list[Law]:
    """Return no form: held samples are seen in the readings themselves."""
    return []
