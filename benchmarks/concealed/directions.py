"""Whether the oracle's unit is right along a direction: how noise drawn anew scatters along what each hidden effect does.

In the oracle's deviations that is one where its unit is the noise's own. It takes them from three or four repeats, by an average over
neighbouring frequencies of a taper's lines, as somebody could who has the recordings alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from concealed.making import Places, case_of, machines
from concealed.truth.build import hidden_in
from concealed.truth.oracle import NoiseUnits, coefficients
from concealed.truth.workshop import Workshop

DRAWN_ANEW = range(1000, 1040)
"""Repeats that nobody records: their deviation is known to a ninth."""

LEAST = 0.5
"""Deviations by which an effect stands out of what re-tuning does, at least: of less there is no direction to speak of."""


def directions_of(places: Places, number: int) -> dict[str, Any]:
    """A case's directions: machine, colour of the noise, and of every hidden effect its distance and how noise scatters along it."""
    case = case_of(places, number)
    machine = machines(places.models)[case.machine]
    shop = Workshop(case, machine)
    chosen, drive = hidden_in(shop), shop.training
    setup = shop.setup(chosen)
    clean = shop.matrix(setup, drive)
    row: dict[str, Any] = {"number": number, "machine": case.machine, "colour": case.colour, "directions": []}
    if clean is None or not chosen:
        return row
    own, anew = (shop.noise([shop.recorded(setup, drive, k) for k in some], clean) for some in (range(case.repeats), DRAWN_ANEW))
    units = NoiseUnits(own)
    numbers = [units(signal) for signal in shop.by_numbers(drive).values()]
    for k, one in enumerate(chosen):
        without = shop.matrix(shop.setup((*chosen[:k], *chosen[k + 1 :])), drive)
        if without is None:
            continue
        effect = units(clean - without)
        effect = effect - np.column_stack(numbers) @ coefficients(effect, numbers)
        distance = float(np.linalg.norm(effect))
        if distance < LEAST:
            continue
        along = [float(effect @ units(noise)) / distance / np.sqrt(case.repeats) for noise in anew]
        row["directions"].append({"kind": one.hidden.kind.name, "distance": round(distance, 2), "scatter": round(float(np.std(along)), 3)})
    return row


def said_of(rows: list[dict[str, Any]]) -> str:
    """Scatter per colour of noise: how many directions, median, and the middle nine tenths."""
    lines = []
    for colour in (*sorted({row["colour"] for row in rows}), "all"):
        found = [one["scatter"] for row in rows if colour in (row["colour"], "all") for one in row["directions"]]
        if found:
            low, middle, high = np.quantile(found, [0.05, 0.5, 0.95])
            lines.append(f"{colour}: {len(found)} directions, median {middle:.2f}, nine in ten {low:.2f} to {high:.2f}")
    return "\n".join(lines)
