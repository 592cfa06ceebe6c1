"""What could be told by somebody who knows the true structure: whether an effect is there, and which other name could be meant.

What imitates an effect is simulated in the truth's own simulator. First the machine file's numbers, and the strengths and shapes of what
else is hidden, are refitted by their derivatives, without bounds. Where an effect then stands apart from nothing they are refitted by
simulations, within the bounds that a machine file's numbers have; where it stands apart from every other name, together with the strength
and shape of what imitates it. The shorter distance counts; one below SEPARABLE is an upper bound, nobody looks further.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from concealed.truth.catalogue import INSIDE, KINDS
from concealed.truth.draw import Hidden
from concealed.truth.kinds import Kind, Shape
from concealed.truth.oracle import NOTHING, NoiseUnits, coefficients, left_over, location
from concealed.truth.plant import COARSE, CORNER, STEP_S, Plant, Setup
from concealed.truth.refitted import nearest
from concealed.truth.workshop import DERIVATIVE_STEP, Chosen, Recorded, Workshop

SEPARABLE = 5.0
"""Standard deviations between the truth and the nearest other name from which on a name is asked for."""

NEIGHBOUR_VARIANTS = 4
SHARED_SHAPE = ("Np", "k", "cycles", "at", "f")
"""Shape entries that a neighbour takes over from the truth where both have them: it gets the best chance to look alike."""

LIKENESS_STEPS, ALIKE = 4, 0.05
"""Times at most that a neighbour's strength is scaled to what imitates the truth best, and how near to that it ends."""

DAMPINGS = (0.03, 0.08, 0.16, 0.32)
"""Ratios of a mode that imitates a mass with a drag."""

MORE_SHAPES = 3
"""Names that are nearest to a law off the catalogue in one shape, of which others are tried."""

REFITTED = 2
"""Names that are nearest by derivatives, whose refit is simulated."""

FROM_NOMINAL, NUMBERS_SIZE = 0.15, 0.05
"""How far a number of the machine file may be from what the file says, as a share, and how far it usually is: what cases draw is
within 0.1."""

CORNERS_MOST, CORNERS_DEVIATION = 0.03, 0.02
"""Low passes of the IMU, which a clock makes: how far one may be off, and the standard deviation of that (data sheets: 1 to 3 %)."""

TURN, SHAPES_MOST, PLACES_MOST = 0.5 * np.pi, 0.25, 0.1
"""How far a phase is refitted, to each side [rad], a position, as a share of the axis's reach, and another entry of a shape, of itself."""


@dataclass(frozen=True)
class Like:
    """Something else hidden in place of the truth, as strong as imitates it best, and its whitened signal.

    `turned`: it imitates turned round, as nothing that was simulated does.
    """

    chosen: Chosen
    signal: np.ndarray
    turned: bool


@dataclass(frozen=True)
class Unknown:
    """One unknown of a refit: a number of the machine file (`key`), or of the `index`-th of what is hidden its strength or a shape's entry.

    It counts from 0, in shares but for phases [rad] and positions (shares of the axis's reach); `scale` is one of them in its entry's unit.
    """

    key: str
    index: int | None
    low: float
    high: float
    size: float
    scale: float = 1.0

    def changed(self, hidden: Sequence[Chosen], change: float) -> tuple[Chosen, ...]:
        """What is hidden, with this unknown elsewhere."""
        if self.index is None:
            return tuple(hidden)
        one = hidden[self.index]
        if not self.key:
            one = replace(one, strength=one.strength * (1.0 + change))
        else:
            value = one.hidden.shape[self.key] + change * self.scale
            one = replace(one, hidden=replace(one.hidden, shape=one.hidden.shape | {self.key: value}))
        return (*hidden[: self.index], one, *hidden[self.index + 1 :])


class Measure:
    """Whitened signals, with a row besides for every number that is known beforehand."""

    def __init__(self, shop: Workshop, units: NoiseUnits) -> None:
        self._units = units
        numbers = shop.by_numbers(shop.training)
        self._known = [key for key in numbers if key.startswith(CORNER)]
        self.numbers = {key: self(signal) for key, signal in numbers.items()}
        """Derivatives by the machine file's numbers."""
        for row, key in enumerate(self._known):
            self.numbers[key][row - len(self._known)] = 1.0 / CORNERS_DEVIATION

    def __call__(self, signal: np.ndarray, changes: Mapping[str, float] | None = None) -> np.ndarray:
        """(N, C) signal, and what is known of numbers that were changed for it, as one vector."""
        known = [(changes or {}).get(key, 0.0) / CORNERS_DEVIATION for key in self._known]
        return np.concatenate([self._units(signal), known])


def oracle(shop: Workshop, chosen: tuple[Chosen, ...], setup: Setup, repeats: list[Recorded], held_out: Recorded) -> dict[str, object]:
    """Detectability, separability, what could be removed, where it shows."""
    case, machine = shop.case, shop.machine
    clean = {"train": shop.matrix(setup, shop.training), "held_out": shop.matrix(setup, shop.held_out)}
    assert clean["train"] is not None and clean["held_out"] is not None, f"case {case.number}: the plant runs away"
    smooth = without_lattices(chosen)
    beside = shop.matrix(shop.setup(smooth), shop.training)
    assert beside is not None, f"case {case.number}: the plant runs away"
    units = NoiseUnits(shop.noise(repeats, beside))
    held_noise = shop.noise([held_out], clean["held_out"])[0]
    answer: dict[str, object] = {
        "noise_rms": dict(zip(case.channels, units.std.tolist(), strict=True)),
        "held_out_noise_rms": dict(zip(case.channels, held_noise.std(axis=0).tolist(), strict=True)),
    }
    if not chosen:
        return answer
    without = shop.setup(())
    base = {name: shop.matrix(without, drive) for name, drive in (("train", shop.training), ("held_out", shop.held_out))}
    assert base["train"] is not None and base["held_out"] is not None
    effect = clean["train"] - base["train"]
    measure = Measure(shop, units)
    lattices = Measure(shop, NoiseUnits(shop.noise(repeats, clean["train"]))) if len(smooth) < len(chosen) else measure
    each = [apart(shop, chosen, index, lattices if one.hidden.kind.lattice else measure) for index, one in enumerate(chosen)]
    together = Beside.of(shop, (), chosen, measure)
    assert together is not None, f"case {case.number}: the plant runs away"
    both = left_over(together.effect, list(measure.numbers.values()))
    answer["detectability"] = both if len(chosen) > 1 else each[0]["detectability"]
    answer["raw_detectability"] = float(np.linalg.norm(units(effect)))
    answer["held_out_raw_detectability"] = float(np.linalg.norm(NoiseUnits(held_noise[None])(clean["held_out"] - base["held_out"])))
    positions = shop.answer(setup, shop.training).q[:, [Plant(machine, setup).dof(machine.joint_of[axis]) for axis in machine.axes]]
    answer["location"] = location(effect, units, machine.rate_Hz, positions, list(case.channels), machine.axes)
    answer["each"] = each
    return answer


def apart(shop: Workshop, chosen: tuple[Chosen, ...], index: int, measure: Measure) -> dict[str, object]:
    """How far one of the effects, beside the others, stands from nothing, and from each neighbour, with everything else refitted."""
    one, others = chosen[index], without_lattices((*chosen[:index], *chosen[index + 1 :]))
    beside = Beside.of(shop, others, (one,), measure) or Beside.of(shop, (), (one,), measure)  # the others may run away by themselves
    assert beside is not None, f"case {shop.case.number}: the plant runs away"
    others = beside.others
    columns = [*measure.numbers.values(), *derivatives(beside, (*others, one), range(len(others))).values()]
    found = left_over(beside.effect, columns)
    nearby = {}
    for name, place in _neighbours(shop, one):
        shapes = _shapes(shop, one, KINDS[name.split(":")[0]], place)
        nearby[name] = _nearest_of(beside, name, place, shapes if one.hidden.kind.accepted else shapes[:1], columns, found)
    if not one.hidden.kind.accepted:  # everything is tried: the nearest in other shapes too
        places = dict(_neighbours(shop, one))
        for name in sorted(nearby, key=lambda name: nearby[name][0])[:MORE_SHAPES]:
            shapes = _shapes(shop, one, KINDS[name], places[name])[1:]
            nearby[name] = min(nearby[name], _nearest_of(beside, name, places[name], shapes, columns, found), key=lambda each: each[0])
    distances = {name: min(distance, found) for name, (distance, _) in nearby.items()}
    if found >= SEPARABLE:
        found = min(found, refitted(beside, None))
        distances = {name: min(distance, found) for name, distance in distances.items()}
    straight = {name: like for name, (_, like) in nearby.items() if like is not None and not like.turned}
    promising = [name for name, like in straight.items() if np.linalg.norm(like.signal) > NOTHING]
    for name in sorted(promising, key=lambda name: distances[name])[:REFITTED]:
        if min([found, *distances.values()]) >= SEPARABLE:
            distances[name] = min(distances[name], refitted(beside, straight[name]))
    separable = min([found, *distances.values()]) >= SEPARABLE
    return {"detectability": found, "distances": distances, "separable": bool(separable)}


def without_lattices(chosen: Sequence[Chosen]) -> tuple[Chosen, ...]:
    """What is hidden but for an encoder's own lattice. In a loop its errors depend on where within a count the motion is: two simulations
    that differ by anything have others, as two recordings do. They are noise to what else is hidden, as those of the file's lattices are.
    """
    return tuple(one for one in chosen if not one.hidden.kind.lattice)


@dataclass(frozen=True)
class Beside:
    """One effect beside the others: its whitened signal, and the simulation without it that imitators are compared with, in their steps."""

    shop: Workshop
    others: tuple[Chosen, ...]
    effect: np.ndarray
    without: np.ndarray
    step_s: float
    measure: Measure

    @classmethod
    def of(cls, shop: Workshop, others: tuple[Chosen, ...], effect: tuple[Chosen, ...], measure: Measure) -> Beside | None:
        """In coarse steps, but for what runs away in coarse ones alone; None where it runs away in any."""
        for step_s in (COARSE * STEP_S, STEP_S):
            without, whole = (shop.matrix(shop.setup(hidden), shop.training, step_s) for hidden in (others, (*others, *effect)))
            if without is not None and whole is not None:
                return cls(shop, others, measure(whole - without), without, step_s, measure)
        return None

    def signal(self, hidden: tuple[Chosen, ...], changes: Mapping[str, float] | None = None) -> np.ndarray | None:
        """What this, with numbers changed by these shares, differs by from the simulation without the effect."""
        factors = dict(self.shop.case.factors)
        for key, change in (changes or {}).items():
            factors[key] = factors.get(key, 1.0) * (1.0 + change)
        answer = self.shop.matrix(self.shop.setup(hidden, factors), self.shop.training, self.step_s)
        return None if answer is None else self.measure(answer - self.without, changes)


def refitted(beside: Beside, like: Like | None) -> float:
    """Distance of the nearest simulation with this hidden in the effect's place."""
    hidden = (*beside.others, *(() if like is None else (like.chosen,)))
    columns = {_number(key, beside.shop.case.factors.get(key, 1.0)): column for key, column in beside.measure.numbers.items()}
    columns |= derivatives(beside, hidden, range(len(hidden)))

    def leaves(at: np.ndarray) -> np.ndarray | None:
        moved, changes = hidden, {}
        for unknown, change in zip(columns, at.tolist(), strict=True):
            moved = unknown.changed(moved, change)
            if unknown.index is None:
                changes[unknown.key] = change
        signal = beside.signal(moved, changes)
        return None if signal is None else beside.effect - signal

    bounds = np.array([unknown.low for unknown in columns]), np.array([unknown.high for unknown in columns])
    begun = beside.effect if like is None else beside.effect - like.signal
    return nearest(leaves, begun, list(columns.values()), bounds, np.array([unknown.size for unknown in columns]), SEPARABLE)


def derivatives(beside: Beside, hidden: tuple[Chosen, ...], which: Iterable[int]) -> dict[Unknown, np.ndarray]:
    """Whitened signals by the strengths and shapes of some of what is hidden: of strengths towards none, some are as strong as can be."""
    shop = beside.shop
    at = shop.matrix(shop.setup(hidden), shop.training, beside.step_s)
    found = {}
    for unknown in [unknown for index in which for unknown in _of_hidden(shop, hidden[index], index)]:
        change = -DERIVATIVE_STEP if not unknown.key else DERIVATIVE_STEP
        answer = shop.matrix(shop.setup(unknown.changed(hidden, change)), shop.training, beside.step_s)
        if at is not None and answer is not None:
            found[unknown] = beside.measure((answer - at) / change)
    return found


def _of_hidden(shop: Workshop, one: Chosen, index: int) -> list[Unknown]:
    """Its strength, unless it is there or not, and the entries of its shape that a fit adjusts."""
    kind, place, shape = one.hidden.kind, one.hidden.place, one.hidden.shape
    unknowns = []
    if not kind.fixed:
        most = kind.largest(shop.machine, place) / abs(one.strength) - 1.0
        unknowns.append(Unknown("", index, -1.0, max(most, 0.0), 0.2))
    for key in kind.refit:
        if key not in shape:
            continue
        if key.startswith("phi"):
            unknowns.append(Unknown(key, index, -TURN, TURN, 0.2))
        elif key == "at" and place in shop.machine.axes:
            unknowns.append(Unknown(key, index, -PLACES_MOST, PLACES_MOST, 0.02, shop.machine.reach(place)))
        else:
            unknowns.append(Unknown(key, index, -SHAPES_MOST, SHAPES_MOST, 0.1, shape[key]))
    return unknowns


def _number(key: str, factor: float) -> Unknown:
    """A number of the machine file, which a case has changed by this factor."""
    if key.startswith(CORNER):
        return Unknown(key, None, -CORNERS_MOST, CORNERS_MOST, CORNERS_DEVIATION)
    return Unknown(key, None, (1.0 - FROM_NOMINAL) / factor - 1.0, (1.0 + FROM_NOMINAL) / factor - 1.0, NUMBERS_SIZE)


def _neighbours(shop: Workshop, one: Chosen) -> list[tuple[str, str]]:
    """Names it may be mistaken for, and where."""
    kind, found = one.hidden.kind, []
    for name in kind.neighbours if kind.accepted else tuple(INSIDE):
        neighbour = KINDS[name.split(":")[0]]
        places = neighbour.places(shop.machine)
        place = one.hidden.place if one.hidden.place in places else next(iter(places), None)
        if ":" in name:
            place = name.split(":")[1]
        if place == "own_current":
            place = shop.machine.current_of(one.hidden.place)
        if place is not None and not set(neighbour.accepted) & set(kind.accepted):
            found.append((name, place))
    return found


def _nearest_of(
    beside: Beside, name: str, place: str, shapes: Sequence[Shape], columns: list[np.ndarray], found: float
) -> tuple[float, Like | None]:
    """Distance of a neighbour in the shape that comes nearest, and what it does; `found` where none can be simulated."""
    likes = [_most_alike(beside, Hidden(KINDS[name.split(":")[0]], place, shape, 1.0), columns) for shape in shapes]
    near = [(left_over(beside.effect, [*columns, like.signal]), like) for like in likes if like is not None]
    return min(near, key=lambda each: each[0]) if near else (found, None)


def _shapes(shop: Workshop, one: Chosen, neighbour: Kind, place: str) -> list[Shape]:
    """A few shapes of a neighbour, with what it can have of the truth's."""
    rng = np.random.default_rng([shop.case.seed, 7])
    variants = NEIGHBOUR_VARIANTS if neighbour.draw(rng, shop.machine, place) else 1
    shapes = []
    for variant in range(variants):
        shape = neighbour.draw(rng, shop.machine, place)
        shape |= {key: one.hidden.shape[key] for key in SHARED_SHAPE if key in shape and key in one.hidden.shape}
        if "k" in one.hidden.shape and "Np" in shape:
            shape["Np"] = one.hidden.shape["k"]
        if "Np" in one.hidden.shape and "k" in shape:
            shape["k"] = one.hidden.shape["Np"]
        if "w" in one.hidden.shape and "f" in shape:  # a mass that swings, with a drag that grows with how far
            shape |= {"f": one.hidden.shape["w"] / (2.0 * np.pi)} | ({"zeta": DAMPINGS[variant]} if "zeta" in shape else {})
        shapes.append(shape | {key: 0.5 * np.pi * variant for key in ("phi", "phi1") if key in shape})
    return shapes


def _most_alike(beside: Beside, like: Hidden, columns: list[np.ndarray]) -> Like | None:
    """A neighbour beside the others, as strong as imitates the truth best.

    A stronger friction is no multiple of a weaker one: a joint sticks longer under it. What imitates the truth turned round counts as well:
    springs and loads may pull the other way, and are simulated so.
    """
    machine = beside.shop.machine
    largest = like.kind.largest(machine, like.place)
    strength = largest if like.kind.fixed else min(like.kind.typical(machine, like.place), largest)
    tried: list[tuple[float, Like]] = []
    for _ in range(1 if like.kind.fixed else LIKENESS_STEPS):
        one = Chosen(like, strength)
        signal = beside.signal((*beside.others, one))
        if signal is None:
            strength *= 0.1
            continue
        share = float(coefficients(beside.effect, [*columns, signal])[-1])
        tried.append((left_over(beside.effect, [*columns, signal]), Like(one, signal, share < 0.0)))
        if abs(share - 1.0) < ALIKE:
            break
        does_nothing = float(np.linalg.norm(signal)) < NOTHING  # a gap, a stop or a limit that is not reached
        factor = 4.0 if does_nothing else float(np.copysign(np.clip(abs(share), 0.02, 30.0), share))
        strength = float(np.clip(strength * factor, -largest, largest))
    return min(tried, key=lambda each: each[0])[1] if tried else None
