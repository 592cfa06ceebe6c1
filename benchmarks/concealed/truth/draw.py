"""Cases from seeds: which machine, which physics, which experiment, which noise. Nothing here depends on any result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from concealed.truth.catalogue import INSIDE, OUTSIDE
from concealed.truth.disturbances import COLOURS
from concealed.truth.experiments import HELD_OUT, KINDS, LITTLE, Experiment
from concealed.truth.kinds import Kind
from concealed.truth.plant import CORNER, IMU_SENSORS, Machine

ORDER = ("null", "single", "off", "null", "single", "pair", "null", "single", "null", "single", "off", "null", "single", "pair", "null")
"""Fifteen cases in a row: six nulls, five singles, two pairs, two off the catalogue. 750 cases hold 300, 250, 100 and 100."""

CONDITIONS = {
    "null": ("plain",),
    "single": ("plain", "feedback", "plain", "noise", "plain", "uncovered", "plain", "little"),
    "pair": ("equal", "larger"),
    "off": ("plain", "plain", "feedback", "noise"),
}
STRENGTHS = (0.5, 1.0, 2.0, 4.0, 8.0)
LARGER = 10.0
"""How many times stronger the first of a pair is that hides the second."""

WEIGHTS = {"tilted_arm": 0.3, "slider": 0.2, "pan_tilt": 0.2, "spring_mass": 0.15, "carm": 0.15}
PERTURBATION = 0.1
HELD_OUT_GAINS = (1.0, 1.0, 1.0, 0.75)
"""The held-out recording of every fourth case was made under a softer controller, which its metadata say."""

UNCOVERED_TOP = 0.15
"""Where the training recordings of the stratum `uncovered` end, as a share of the range's half."""


@dataclass(frozen=True)
class Hidden:
    """One piece of physics that is hidden: its strength in detection limits."""

    kind: Kind
    place: str
    shape: dict[str, float]
    times_limit: float


@dataclass(frozen=True)
class Case:
    """What a case is made of."""

    number: int
    stratum: str
    condition: str
    machine: str
    hidden: tuple[Hidden, ...]
    factors: dict[str, float]
    colour: str
    disturbance: float
    noise: float
    repeats: int
    training: Experiment
    held_out: Experiment
    channels: tuple[str, ...]
    seed: int
    held_out_gain: float  # of the controller the held-out recording was made with


def draw(number: int, base_seed: int, machines: Mapping[str, Machine]) -> Case:
    """The case of this number."""
    rng = np.random.default_rng([base_seed, number])
    stratum = ORDER[number % len(ORDER)]
    among = number // len(ORDER) * ORDER.count(stratum) + ORDER[: number % len(ORDER)].count(stratum)  # how many of its stratum came before
    condition = CONDITIONS[stratum][among % len(CONDITIONS[stratum])]
    hidden: tuple[Hidden, ...] = ()
    name = str(rng.choice(list(WEIGHTS), p=list(WEIGHTS.values())))
    if stratum == "single":
        kinds = [kind for kind in INSIDE.values() if kind.local or condition != "uncovered"]
        kind = _turn(kinds, among // (8 if condition == "uncovered" else 1), base_seed, condition if condition == "uncovered" else "single")
        name = _machine_for(rng, machines, [kind], condition)
        hidden = (_hide(rng, machines[name], kind, _strength(rng, condition)),)
    elif stratum == "off":
        kind = _turn(list(OUTSIDE.values()), among, base_seed, "off")
        name = _machine_for(rng, machines, [kind], condition)
        hidden = (_hide(rng, machines[name], kind, float(rng.choice(STRENGTHS[2:]))),)
    elif stratum == "pair":
        first = _turn(list(INSIDE.values()), among, base_seed, "pair")
        name = _machine_for(rng, machines, [first], condition)
        others = [kind for kind in INSIDE.values() if kind.name != first.name and kind.places(machines[name]) and not kind.local]
        second = others[int(rng.integers(len(others)))]
        strength = float(rng.choice(STRENGTHS[1:4]))
        hidden = (
            _hide(rng, machines[name], first, strength * (LARGER if condition == "larger" else 1.0)),
            _hide(rng, machines[name], second, strength),
        )
    machine = machines[name]
    low, high = (-1.0, UNCOVERED_TOP) if condition == "uncovered" else (-1.0, 1.0)
    if condition == "uncovered":
        hidden = tuple(Hidden(h.kind, h.place, _upwards(machine, h.place, h.shape), h.times_limit) for h in hidden)
    kind_of_run = LITTLE if condition == "little" else str(rng.choice(KINDS, p=[0.55, 0.15, 0.15, 0.15]))
    channels = machine.channels()
    if condition == "feedback":
        channels = [channel for channel in channels if not channel.startswith(("imu", "gyro", "link"))]
    return Case(
        number, stratum, condition, name, hidden, perturbations(rng, machine), str(rng.choice(COLOURS)), float(rng.uniform(0.003, 0.02)),
        float(rng.uniform(0.7, 1.5)) * (4.0 if condition == "noise" else 1.0), int(rng.choice([3, 4])),
        Experiment(kind_of_run, int(rng.integers(1 << 31)), low, high), Experiment(HELD_OUT, int(rng.integers(1 << 31))), tuple(channels),
        int(rng.integers(1 << 31)), float(rng.choice(HELD_OUT_GAINS)),
    )  # fmt: skip


def perturbations(rng: np.random.Generator, machine: Machine) -> dict[str, float]:
    """Factors on the machine file's masses, inertias, springs, dampers and constants, within ten percent."""
    keys = []
    for body in machine.table["body"]:
        if body.get("mass_kg", 0.0) >= 0.5:
            keys.append(f"mass:{body['name']}")
            if "inertia_kg_m2" in body:
                keys.append(f"inertia:{body['name']}")
        joint = body.get("joint", {})
        for quantity in ("stiffness", "damping"):
            if any(key.startswith(quantity) for key in joint):
                keys.append(f"{quantity}:{joint['name']}")
    keys += [f"constant:{axis}" for axis in machine.axes]
    return {key: float(1.0 + rng.uniform(-PERTURBATION, PERTURBATION)) for key in keys}


def numbers(machine: Machine) -> list[str]:
    """Every number of the machine file that a refit may adjust: those that cases perturb, centres of mass, rotors, the IMU's low passes."""
    keys = list(perturbations(np.random.default_rng(0), machine))
    for body in machine.table["body"]:
        if body.get("mass_kg", 0.0) >= 0.5:
            centre = body.get("center_of_mass_m", [0.0, 0.0, 0.0])
            keys += [f"com_{axis}:{body['name']}" for axis, value in zip("xyz", centre, strict=True) if value]
    rotors = [axis for axis, drive in machine.table["drives"].items() if any(key.startswith("rotor") for key in drive)]
    corners = [f"{CORNER}:{sensor}" for sensor in IMU_SENSORS if f"{sensor}_bandwidth_Hz" in (machine.imu or {})]
    return keys + [f"armature:{machine.joint_of[axis]}" for axis in rotors] + corners


def _strength(rng: np.random.Generator, condition: str) -> float:
    return float(rng.choice(STRENGTHS[3:] if condition in ("uncovered", "little") else STRENGTHS))


def _turn(kinds: list[Kind], among: int, base_seed: int, purpose: str) -> Kind:
    """Every kind once before any comes again, in an order that the seed gives."""
    order = np.random.default_rng([base_seed, sum(map(ord, purpose)), among // len(kinds)]).permutation(len(kinds))
    return kinds[int(order[among % len(kinds)])]


def _machine_for(rng: np.random.Generator, machines: Mapping[str, Machine], kinds: list[Kind], condition: str) -> str:
    fitting = [
        name
        for name, machine in machines.items()
        if all(kind.places(machine) for kind in kinds) and (condition not in ("feedback", "uncovered") or machine.closed)
    ] or [name for name, machine in machines.items() if all(kind.places(machine) for kind in kinds)]
    weights = np.array([WEIGHTS[name] for name in fitting])
    return str(rng.choice(fitting, p=weights / weights.sum()))


def _hide(rng: np.random.Generator, machine: Machine, kind: Kind, times_limit: float) -> Hidden:
    places = kind.places(machine)
    place = places[int(rng.integers(len(places)))]
    return Hidden(kind, place, kind.draw(rng, machine, place), times_limit)


def _upwards(machine: Machine, axis: str, shape: dict[str, float]) -> dict[str, float]:
    """On the upper side alone, where the training recordings do not come."""
    return {**shape, "side": 1.0, "at": max(abs(shape["at"]), 0.25 * machine.reach(axis))}
