"""Runs of one case's plant: what its channels read, without noise and recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from concealed.truth.disturbances import disturbance, with_noise
from concealed.truth.draw import Case, Hidden, numbers
from concealed.truth.experiments import plan
from concealed.truth.plant import COARSE, STEP_S, Answer, Drive, Machine, Plant, Setup
from concealed.truth.sensor_kinds import loses, read, with_losses

LOSSES = 1
"""The stream of draws that recordings lose samples by."""

DERIVATIVE_STEP = 0.01


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
        self._derivatives: dict[int, dict[str, np.ndarray]] = {}
        self._without: dict[int, tuple[np.ndarray, float]] = {}

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

    def without_effects(self, drive: Drive) -> tuple[np.ndarray, float]:
        """Noise-free readings (N, C) of the plant without effects, and the longest step [s] that they were simulated in: a coarse one, but
        where it runs away in coarse ones alone.
        """
        if id(drive) not in self._without:
            for step_s in (COARSE * STEP_S, STEP_S):
                readings = self.matrix(self.setup(()), drive, step_s)
                if readings is not None:
                    self._without[id(drive)] = readings, step_s
                    break
        assert id(drive) in self._without, f"case {self.case.number}: the plant without effects runs away"
        return self._without[id(drive)]

    def by_numbers(self, drive: Drive) -> dict[str, np.ndarray]:
        """Derivatives (N, C) of the plant without effects, in those steps, by every number of the machine file, per share of it."""
        if id(drive) not in self._derivatives:
            base, step_s = self.without_effects(drive)
            signals = {}
            for key in numbers(self.machine):
                factors = self.case.factors | {key: self.case.factors.get(key, 1.0) * (1.0 + DERIVATIVE_STEP)}
                answer = self.matrix(self.setup((), factors), drive, step_s)
                if answer is not None:
                    signals[key] = (answer - base) / DERIVATIVE_STEP
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
