"""One case: its strengths set by the detection limit, its recordings written, its truth worked out."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from concealed.truth.catalogue import INSIDE, KINDS
from concealed.truth.disturbances import disturbance, with_noise
from concealed.truth.draw import Case, Hidden, numbers
from concealed.truth.experiments import plan
from concealed.truth.kinds import Kind, Shape
from concealed.truth.oracle import NoiseUnits, coefficients, left_over, location
from concealed.truth.plant import COARSE, IMU_CHANNELS, STEP_S, Answer, Drive, Machine, Plant, Setup
from concealed.truth.sensor_kinds import loses, read, with_losses
from concealed.truth.writing import write_recording

DETECTION_LIMIT = 5.0
"""Standard deviations: found among forty candidates with nine chances in ten while one null in twenty alarms (3.3 + 1.3, rounded up)."""

SEPARABLE = 5.0
"""Standard deviations between the truth and the nearest other name from which on a name is asked for."""

LOSSES = 1
"""The stream of draws that recordings lose samples by."""

SEARCH_STEPS = 4
DERIVATIVE_STEP = 0.01
NEIGHBOUR_VARIANTS = 4
SHARED_SHAPE = ("Np", "k", "cycles", "at", "f")
"""Shape entries that a neighbour takes over from the truth where both have them: it gets the best chance to look alike."""

LIKENESS_STEPS, ALIKE, NOTHING = 4, 0.05, 1e-9
"""Times at most that a neighbour's strength is scaled to what imitates the truth best, how near to that it ends, and what counts as none of
its signal, in deviations."""


@dataclass(frozen=True)
class Chosen:
    """Hidden physics with its strength."""

    hidden: Hidden
    strength: float


@dataclass(frozen=True)
class Recorded:
    """One recording: what drove it, what the plant did, and every channel of the machine as its sensors read it (N,)."""

    drive: Drive
    answer: Answer
    channels: dict[str, np.ndarray]


class Workshop:
    """Runs of one case's plant."""

    def __init__(self, case: Case, machine: Machine) -> None:
        self.case, self.machine = case, machine
        self.training, self.held_out = plan(machine, case.training), plan(machine, case.held_out)
        self._softer = machine.with_gain(case.held_out_gain)
        self._derivatives: dict[int, list[np.ndarray]] = {}

    def under(self, drive: Drive) -> Machine:
        """The machine with the controller that a run was made under."""
        return self._softer if drive.reference is self.held_out.reference else self.machine

    def setup(self, chosen: tuple[Chosen, ...], factors: Mapping[str, float] | None = None) -> Setup:
        """The case's plant with this physics."""
        setup = Setup(dict(self.case.factors if factors is None else factors))
        for each in chosen:
            each.hidden.kind.add(setup, self.machine, each.hidden.place, each.hidden.shape, each.strength)
        return setup

    def answer(self, setup: Setup, drive: Drive, lattices: bool = False, longest_step_s: float = STEP_S) -> Answer:
        """One run."""
        return Plant(self.under(drive), setup).run(drive, lattices, longest_step_s)

    def matrix(self, setup: Setup, drive: Drive, longest_step_s: float = STEP_S) -> np.ndarray | None:
        """Noise-free readings (N, C) of the case's channels, the mean of its recordings where these lose samples each at its own times;
        None where the machine ran away.
        """
        answer = self.answer(setup, drive, longest_step_s=longest_step_s)
        if answer.failed:
            return None
        case = self.case
        if not loses(setup):
            return self.readings(setup, answer, 0)
        repeats = range(case.repeats) if drive.reference is not self.held_out.reference else (case.repeats,)
        return np.mean([self.readings(setup, answer, repeat) for repeat in repeats], axis=0)

    def readings(self, setup: Setup, answer: Answer, repeat: int) -> np.ndarray:
        """The case's channels as the sensors of one recording read them, without noise."""
        read_out = with_losses(setup, read(setup, answer.channels, self.machine.rate_Hz), self._losses(repeat))
        return np.column_stack([read_out[name] for name in self.case.channels])

    def by_numbers(self, drive: Drive) -> list[np.ndarray]:
        """Derivatives (N, C) of the plant without effects by every number of the machine file, per share of it."""
        if id(drive) not in self._derivatives:
            base = self.matrix(self.setup(()), drive)
            signals = []
            for key in numbers(self.machine):
                factors = self.case.factors | {key: self.case.factors.get(key, 1.0) * (1.0 + DERIVATIVE_STEP)}
                answer = self.matrix(self.setup((), factors), drive)
                if answer is not None and base is not None:
                    signals.append((answer - base) / DERIVATIVE_STEP)
            self._derivatives[id(drive)] = signals
        return self._derivatives[id(drive)]

    def recorded(self, setup: Setup, drive: Drive, repeat: int) -> Recorded:
        """A run with its own disturbances and noise, every channel of the machine; draws do not depend on the hidden physics."""
        case = self.case
        rng = np.random.default_rng([case.seed, repeat])
        efforts, calm = disturbance(rng, self.machine, len(drive.reference), case.colour, case.disturbance)
        answer = self.answer(setup, replace(drive, disturbance=efforts, calm_speed=calm), lattices=True)
        assert not answer.failed, f"case {case.number}: the plant runs away"
        channels = with_noise(rng, self.machine, read(setup, answer.channels, self.machine.rate_Hz), case.noise)
        return Recorded(drive, answer, with_losses(setup, channels, self._losses(repeat)))

    def _losses(self, repeat: int) -> np.random.Generator:
        """What a recording's samples are lost by: the same in its noise-free readings."""
        return np.random.default_rng([self.case.seed, repeat, LOSSES])

    def noise(self, recordings: Sequence[Recorded], clean: np.ndarray) -> np.ndarray:
        """What repeats differ by (R, N, C): recordings minus the noise-free answer."""
        return np.array([np.column_stack([recording.channels[name] for name in self.case.channels]) - clean for recording in recordings])


def make_case(case: Case, machine: Machine, folder: Path, truth_path: Path) -> None:
    """Write the case's recordings and machine file to `folder` and its truth to `truth_path`.

    Strengths come from the detection limit under the case's own experiment; a case with too little excitation takes it from a rich one.
    """
    shop = Workshop(case, machine)
    rich = shop.training
    if case.condition == "little":
        rich = plan(machine, replace(case.training, kind="mixed"))
    if case.condition == "uncovered":
        rich = shop.held_out
    chosen = _strengths(shop, rich)
    setup = shop.setup(chosen)
    repeats = [shop.recorded(setup, shop.training, repeat) for repeat in range(case.repeats)]
    held_out = shop.recorded(setup, shop.held_out, case.repeats)
    truth = _describe(case, machine, chosen) | _oracle(shop, chosen, setup, repeats, held_out)
    _write(shop, repeats, held_out, folder)
    truth_path.parent.mkdir(parents=True, exist_ok=True)
    truth_path.write_text(json.dumps(truth, indent=1), encoding="utf-8")


# ---- strengths --------------------------------------------------------------------------------------


def _strengths(shop: Workshop, drive: Drive) -> tuple[Chosen, ...]:
    """Each effect's strength, found alone: as many detection limits as the case says."""
    if not shop.case.hidden:
        return ()
    nothing = shop.setup(())
    base = shop.matrix(nothing, drive)
    assert base is not None, f"case {shop.case.number}: the plant without effects runs away"
    units = NoiseUnits(shop.noise([shop.recorded(nothing, drive, repeat) for repeat in range(100, 103)], base))
    nominal = [units(signal) for signal in shop.by_numbers(drive)]
    return tuple(Chosen(hidden, _strength(shop, hidden, drive, base, units, nominal)) for hidden in shop.case.hidden)


def _strength(shop: Workshop, hidden: Hidden, drive: Drive, base: np.ndarray, units: NoiseUnits, nominal: list[np.ndarray]) -> float:
    kind = hidden.kind
    largest = kind.largest(shop.machine, hidden.place)
    strength = min(kind.typical(shop.machine, hidden.place), largest)
    if kind.fixed:
        return largest
    if kind.tuned:  # a refit of the machine file's numbers takes it up by definition: there is no limit to count in
        return min(0.5 * hidden.times_limit * strength, largest)
    wanted = hidden.times_limit * DETECTION_LIMIT * np.sqrt(units.repeats / shop.case.repeats)
    safe = largest
    for _ in range(SEARCH_STEPS):
        answer = shop.matrix(shop.setup((Chosen(hidden, strength),)), drive)
        if answer is None:
            safe = 0.5 * strength
            strength = safe
            continue
        found = left_over(units(answer - base), nominal)
        if found < NOTHING:  # nothing yet: a gap, a stop or a limit that is not reached
            strength = min(4.0 * strength, safe)
            continue
        strength = min(strength * float(np.clip(wanted / found, 0.02, 30.0)), safe)
    while shop.matrix(shop.setup((Chosen(hidden, strength),)), drive) is None:
        strength *= 0.5
    return max(strength, hidden.shape.get("least", 0.0))


# ---- the oracle -------------------------------------------------------------------------------------


def _oracle(shop: Workshop, chosen: tuple[Chosen, ...], setup: Setup, repeats: list[Recorded], held_out: Recorded) -> dict[str, object]:
    """Detectability, separability, what could be removed, where it shows."""
    case, machine = shop.case, shop.machine
    clean = {"train": shop.matrix(setup, shop.training), "held_out": shop.matrix(setup, shop.held_out)}
    assert clean["train"] is not None and clean["held_out"] is not None, f"case {case.number}: the plant runs away"
    units = NoiseUnits(shop.noise(repeats, clean["train"]))
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
    columns = [units(signal) for signal in shop.by_numbers(shop.training)]
    effect = clean["train"] - base["train"]
    answer["detectability"] = left_over(units(effect), columns)
    answer["raw_detectability"] = float(np.linalg.norm(units(effect)))
    answer["held_out_raw_detectability"] = float(np.linalg.norm(NoiseUnits(held_noise[None])(clean["held_out"] - base["held_out"])))
    positions = shop.answer(setup, shop.training).q[:, [Plant(machine, setup).dof(machine.joint_of[axis]) for axis in machine.axes]]
    answer["location"] = location(effect, units, machine.rate_Hz, positions, list(case.channels), machine.axes)
    answer["each"] = [_apart(shop, chosen, index, units, columns) for index in range(len(chosen))]
    return answer


def _apart(shop: Workshop, chosen: tuple[Chosen, ...], index: int, units: NoiseUnits, columns: list[np.ndarray]) -> dict[str, object]:
    """How far one of the effects, beside the others, stands from nothing, and from each neighbour, with everything else refitted."""
    one, others = chosen[index], (*chosen[:index], *chosen[index + 1 :])
    base = shop.matrix(shop.setup(others), shop.training)
    if base is None:  # the others run away by themselves: it is judged alone
        others, chosen, base = (), (one,), shop.matrix(shop.setup(()), shop.training)
    whole = shop.matrix(shop.setup(chosen), shop.training)
    assert base is not None and whole is not None, f"case {shop.case.number}: the plant runs away"
    effect = units(whole - base)
    step_s = COARSE * STEP_S
    beside = shop.matrix(shop.setup(others), shop.training, step_s)
    if beside is None:  # in coarse steps alone
        step_s, beside = STEP_S, base
    columns = columns + [units(change) for other in others if (change := _by_strength(shop, chosen, other, whole)) is not None]
    kind, distances = one.hidden.kind, {}
    names = kind.neighbours if kind.accepted else tuple(INSIDE)
    for name in names:
        neighbour = KINDS[name.split(":")[0]]
        places = neighbour.places(shop.machine)
        place = one.hidden.place if one.hidden.place in places else next(iter(places), None)
        if ":" in name:
            place = name.split(":")[1]
        if place is None or set(neighbour.accepted) & set(kind.accepted):
            continue
        shapes = _shapes(shop, one, neighbour, place)
        hidden = [Hidden(neighbour, place, shape, 1.0) for shape in shapes]
        alike = [_most_alike(shop, others, like, beside, step_s, effect, units, columns) for like in hidden]
        distances[name] = min(left_over(effect, columns if signal is None else [*columns, signal]) for signal in alike)
    return {
        "detectability": left_over(effect, columns),
        "distances": distances,
        "separable": bool(left_over(effect, columns) >= SEPARABLE and min(distances.values(), default=np.inf) >= SEPARABLE),
    }


def _by_strength(shop: Workshop, chosen: tuple[Chosen, ...], other: Chosen, whole: np.ndarray) -> np.ndarray | None:
    """Derivative (N, C) by one effect's strength, beside all of them, per share of it: towards none, some are as strong as can be."""
    weaker = tuple(replace(each, strength=each.strength * (1.0 - DERIVATIVE_STEP)) if each is other else each for each in chosen)
    answer = shop.matrix(shop.setup(weaker), shop.training)
    return None if answer is None else (whole - answer) / DERIVATIVE_STEP


def _shapes(shop: Workshop, one: Chosen, neighbour: Kind, place: str) -> list[Shape]:
    """A few shapes of a neighbour, with what it can have of the truth's."""
    rng = np.random.default_rng([shop.case.seed, 7])
    variants = NEIGHBOUR_VARIANTS if one.hidden.kind.accepted and neighbour.draw(rng, shop.machine, place) else 1
    shapes = []
    for variant in range(variants):
        shape = neighbour.draw(rng, shop.machine, place)
        shape |= {key: one.hidden.shape[key] for key in SHARED_SHAPE if key in shape and key in one.hidden.shape}
        if "k" in one.hidden.shape and "Np" in shape:
            shape["Np"] = one.hidden.shape["k"]
        if "Np" in one.hidden.shape and "k" in shape:
            shape["k"] = one.hidden.shape["Np"]
        shapes.append(shape | {key: 0.5 * np.pi * variant for key in ("phi", "phi1") if key in shape})
    return shapes


def _most_alike(
    shop: Workshop,
    others: tuple[Chosen, ...],
    like: Hidden,
    base: np.ndarray,
    step_s: float,
    effect: np.ndarray,
    units: NoiseUnits,
    columns: list[np.ndarray],
) -> np.ndarray | None:
    """Whitened signal of a neighbour beside the others, as strong as imitates the truth best; `base` is without it.

    A stronger friction is no multiple of a weaker one: a joint sticks longer under it. What imitates the truth turned round counts as well,
    at the same strength: springs and loads may pull the other way.
    """
    largest = like.kind.largest(shop.machine, like.place)
    strength = largest if like.kind.fixed else min(like.kind.typical(shop.machine, like.place), largest)
    tried: list[tuple[float, np.ndarray]] = []
    for _ in range(1 if like.kind.fixed else LIKENESS_STEPS):
        answer = shop.matrix(shop.setup((*others, Chosen(like, strength))), shop.training, step_s)
        if answer is None:
            strength *= 0.1
            continue
        signal = units(answer - base)
        tried.append((left_over(effect, [*columns, signal]), signal))
        share = abs(float(coefficients(effect, [*columns, signal])[-1]))
        if abs(share - 1.0) < ALIKE:
            break
        does_nothing = float(np.linalg.norm(signal)) < NOTHING  # a gap, a stop or a limit that is not reached
        strength = min(strength * (4.0 if does_nothing else float(np.clip(share, 0.02, 30.0))), largest)
    return min(tried, key=lambda each: each[0])[1] if tried else None


# ---- what is written --------------------------------------------------------------------------------


def _names_of(machine: Machine, place: str) -> list[str]:
    """How a finding may say where this is: an axis is also its joint's body, its encoder, and the body on the spring behind it."""
    if place not in machine.axes:
        return [place, *(IMU_CHANNELS if place == "imu" else ())]
    spring = machine.spring_behind(place)
    names = [place, machine.joint_of[place], machine.body_of[machine.joint_of[place]], f"position_{place}"]
    return names + ([spring, machine.body_of[spring]] if spring else [])


def _describe(case: Case, machine: Machine, chosen: tuple[Chosen, ...]) -> dict[str, object]:
    """The truth in words and numbers."""
    effects = []
    for each in chosen:
        kind = each.hidden.kind
        effects.append({
            "kind": kind.name, "at": each.hidden.place, "accepted_at": _names_of(machine, each.hidden.place),
            "accepted": list(kind.accepted), "tuned": kind.tuned, "sensor": kind.sensor,
            "strength": each.strength, "shape": each.hidden.shape, "times_limit": each.hidden.times_limit,
            "compare": kind.compare(each.hidden.shape, each.strength),
        })  # fmt: skip
    return {
        "number": case.number, "stratum": case.stratum, "condition": case.condition, "machine": case.machine, "colour": case.colour,
        "disturbance": case.disturbance, "noise": case.noise, "repeats": case.repeats, "training": case.training.kind,
        "factors": case.factors, "effects": effects,
    }  # fmt: skip


def _write(shop: Workshop, repeats: list[Recorded], held_out: Recorded, folder: Path) -> None:
    """Recordings and the nominal machine file: all that the tool sees."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(shop.machine.path, folder / "machine.toml")
    names = [*(f"run_{repeat + 1}.csv" for repeat in range(len(repeats))), "held_out.csv"]
    for name, recorded in zip(names, [*repeats, held_out], strict=True):
        drive = recorded.drive
        columns = {"time": np.arange(len(drive.reference)) / shop.machine.rate_Hz}
        for i, axis in enumerate(shop.machine.axes):
            if shop.machine.closed:
                columns[f"reference_{axis}"], columns[f"excitation_{axis}"] = drive.reference[:, i], drive.excitation[:, i]
            columns[f"command_{axis}"] = recorded.answer.command[:, i]
        columns |= {channel: recorded.channels[channel] for channel in shop.case.channels}
        experiment = {"kind": "run", "start_pose": drive.start.tolist()}
        write_recording(folder / name, shop.under(drive), columns, experiment, recorded.answer.controller_states)
