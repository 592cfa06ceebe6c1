"""Many free runs of one machine, whitened: over plant parameters and effects, on one or more processors.

Most of a run is machine code or NumPy's, and neither holds the interpreter's lock: threads share the recordings and hand over answers of a
megabyte as they are.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, cached_property, partial
from itertools import islice, pairwise
from types import TracebackType
from typing import TypeVar

import numpy as np

from hil.diagnosis.residuals.mismatch import Mismatch
from hil.diagnosis.residuals.noise import NoiseModel
from hil.diagnosis.residuals.own_lines import weighted
from hil.machine import Machine
from hil.simulation import Simulator
from hil.simulation.smooth import simulated_matrix, smooth
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.lanes import LANES
from virtual_bus.plant.parameters import PlantParameter
from virtual_bus.settings import EffectSetting

TRAIN, HELD_OUT = "train", "held_out"

FINE_STEPS = 4
"""By how much finer the plant's steps are whose difference corrects all runs (see `FreeRuns.correct`): the second-order error of a 20 Hz
mode stands out of the noise of four repeats at 1.6 kHz still."""

TO_NO_STEP = FINE_STEPS**2 / (FINE_STEPS**2 - 1.0)
"""Of that difference, what steps without end would change: a second-order error is a sixteenth in the finer steps (Richardson's
extrapolation). Left there, it makes IMUs late by 4 microseconds."""

WORTH_A_BATCH = 4
"""Trials that are begun with before anybody waits, and from which on another thread takes some of them: LANES of them take hardly longer
than one, but whoever asks works meanwhile."""

SIDE_BY_SIDE_FROM = 2000
"""Rows from which machines run side by side: compiling that for a plant takes half a minute once, which shorter recordings do not bring
in. By the recording and not by what is compiled already, since answers differ by rounding."""

Part = TypeVar("Part")
Said = TypeVar("Said")

SWITCH_AFTER_s = 2e-4
"""How long who comes back from machine code waits for the interpreter's lock at most. A run does so some fifty times: with Python's own 5
ms a thread whitens six tenths as many records beside one that works on answers."""

RUN_AWAY = 1e12
"""A number beyond this, in units of its channel's noise or whitened, is a simulation that runs away."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One machine to try: plant parameters (in the order of `FreeRuns.parameters`), and effects besides the machine file's."""

    values: np.ndarray
    effects: tuple[EffectSetting, ...] = ()


class _Runner:
    """Runs trials in one thread."""

    def __init__(self, sets: Mapping[str, Mismatch], noise: NoiseModel) -> None:
        self._sets = sets
        self._noise = noise
        self.finer = 1  # plant steps than LARGEST_STEP_s asks for

    @cached_property
    def _simulators(self) -> dict[tuple[int, int], Simulator]:
        """By machine and how much finer its steps are: groups of one machine share its simulator."""
        return {}

    def _simulator(self, machine: Machine, finer: int) -> Simulator:
        key = id(machine), finer
        if key not in self._simulators:
            self._simulators[key] = Simulator(smooth(machine, finer))
        return self._simulators[key]

    def rows(self, name: str, trial: Trial, *, fine: bool = False, settled: bool = False) -> list[np.ndarray] | None:
        """(N, C) simulated channels per group; None where the machine cannot stand or the simulation diverges."""
        return self.rows_of_all(name, [trial], fine=fine, settled=settled)[0]

    def rows_of_all(
        self, name: str, trials: Sequence[Trial], *, fine: bool = False, settled: bool = False
    ) -> list[list[np.ndarray] | None]:
        """The same of several trials."""
        found = self._sets[name]
        folded: list[list[np.ndarray] | None] = [[] for _ in trials]
        for group in found.groups:
            alive = [k for k, rows in enumerate(folded) if rows is not None]
            machines = [(trials[k].values, (*found.machine.plant.effects, *trials[k].effects)) for k in alive]
            simulator = self._simulator(group.machine, self.finer * (FINE_STEPS if fine else 1))
            inputs = group.inputs.settled if settled else group.inputs
            if len(trials) > 1 and len(group.time_s) >= SIDE_BY_SIDE_FROM:
                answers = simulator.run_all(inputs, machines)
            else:  # as one machine, cheaper: by how many were asked for, not by how many have not diverged yet
                answers = [simulator.run_or_error(inputs, *each) for each in machines]
            for k, outputs in zip(alive, answers, strict=True):
                own = folded[k]
                assert own is not None
                rows = None if isinstance(outputs, Exception) else group.fold(simulated_matrix(group.machine, outputs, found.channels))
                if rows is None or not np.isfinite(_largest(rows)):
                    folded[k] = None
                else:
                    own.append(rows)
        return folded

    def whitened(self, name: str, trials: Sequence[Trial]) -> list[np.ndarray | None]:
        return [self._whitened(name, rows) for rows in self.rows_of_all(name, trials)]

    def _whitened(self, name: str, rows: list[np.ndarray] | None) -> np.ndarray | None:
        if rows is None or any(self._runs_away(one) for one in rows):  # whitening would overflow
            return None
        joined = self.join(name, rows)
        return joined if _largest(joined) < RUN_AWAY else None

    def _runs_away(self, rows: np.ndarray) -> bool:
        most = RUN_AWAY * self._noise.std
        return _largest(rows) > most.min() and bool(np.any(np.abs(rows).max(axis=0) > most))

    def join(self, name: str, rows: Sequence[np.ndarray]) -> np.ndarray:
        """(M,) rows of all groups in units of the noise of the repeats' mean."""
        parts = []
        for group, values in zip(self._sets[name].groups, rows, strict=True):
            parts.append(self._noise.of_mean(group.repeats).whiten(values, group.imu))
            parts[-1] *= np.sqrt(group.repeats)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _largest(values: np.ndarray) -> float:
    """Magnitude, NaN where one is among them."""
    return float(np.maximum(values.max(), -values.min()))


@dataclass(eq=False)
class _Asked:
    """Trials that answers are wanted of, and where these will be: batches under way, and places in them."""

    name: str
    trials: Sequence[Trial]
    answers: list[tuple[Callable[[], list[np.ndarray | None]], int]] | None = None


class FreeRuns:
    """Free runs over the training and the held-out groups, in units of the noise of the repeats' mean.

    Parameters
    ----------
    sets : mapping of str to Mismatch
        `TRAIN` and, where there is one, `HELD_OUT`.
    noise : NoiseModel
    jobs : int
        Threads besides the caller's. 1: all in that one.
    """

    def __init__(self, sets: Mapping[str, Mismatch], noise: NoiseModel, jobs: int = 1) -> None:
        self.sets = dict(sets)
        self.noise = noise
        self.machine = sets[TRAIN].machine
        self.parameters: tuple[PlantParameter, ...] = compile_plant(self.machine.plant).parameters
        self.count = 0
        self._correction: dict[str, list[np.ndarray]] = {}
        self._whitened_correction: dict[str, np.ndarray] = {}
        self._line_weights: dict[str, list[np.ndarray | None]] = {}
        self._local = _Runner(self.sets, noise)
        self._asked: list[_Asked] = []
        self._jobs = jobs
        self._of_thread = threading.local()
        self._pool = ThreadPoolExecutor(jobs, initializer=self._begin_thread) if jobs > 1 else None

    def __enter__(self) -> FreeRuns:
        self._switched_after_s = sys.getswitchinterval()
        if self._pool is not None:
            sys.setswitchinterval(SWITCH_AFTER_s)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        sys.setswitchinterval(self._switched_after_s)
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    @property
    def nominal(self) -> np.ndarray:
        return np.array([parameter.value for parameter in self.parameters])

    @property
    def has_held_out(self) -> bool:
        return HELD_OUT in self.sets

    def measured(self, name: str = TRAIN) -> np.ndarray:
        """(M,) mean of the repeats."""
        return self.joined([group.mean for group in self.sets[name].groups], name)

    def repeats(self, name: str = TRAIN) -> list[list[np.ndarray]]:
        """Whitened repeats per group, each in units of one repeat's noise."""
        groups = self.sets[name].groups
        return [[self.noise.of_mean(group.repeats).whiten(rows, group.imu) for rows in group.complete] for group in groups]

    def run(self, trials: Sequence[Trial], name: str = TRAIN) -> list[np.ndarray | None]:
        """(M,) simulated channels of every trial; None where it cannot be simulated."""
        return self.begin(trials, name)()

    def begin(self, trials: Sequence[Trial], name: str = TRAIN) -> Callable[[], list[np.ndarray | None]]:
        """Ask for trials, and return what waits for their answers: see `run`.

        What is asked for before anybody waits is worked together, LANES at a time, on other threads where there are any.
        """
        self.count += len(trials)
        asked = _Asked(name, trials)
        self._asked.append(asked)
        if sum(len(each.trials) for each in self._asked) >= WORTH_A_BATCH:
            self._send()
        return lambda: self._answers(asked)

    def _send(self) -> None:
        """Begin with all that was asked for."""
        for name in dict.fromkeys(each.name for each in self._asked):
            alike = [each for each in self._asked if each.name == name]
            trials = [trial for each in alike for trial in each.trials]
            places = iter([(batch, k) for batch, count in self._batches(name, trials) for k in range(count)])
            for each in alike:
                each.answers = list(islice(places, len(each.trials)))
        self._asked.clear()

    def _batches(self, name: str, trials: Sequence[Trial]) -> Iterator[tuple[Callable[[], list[np.ndarray | None]], int]]:
        """What waits for each batch, and its size: about equal ones, as many as leave no thread without work."""
        work = partial(self._worked, name, self._whitened_correction.get(name), self._line_weights.get(name))
        count = max(-(-len(trials) // LANES), min(self._jobs, len(trials) // WORTH_A_BATCH))
        ends = [len(trials) * k // count for k in range(count + 1)] if count else []
        for first, end in pairwise(ends):
            batch = trials[first:end]
            if self._pool is None:
                yield cache(partial(work, batch)), len(batch)
            else:
                yield self._pool.submit(work, batch).result, len(batch)

    def _begin_thread(self) -> None:
        self._of_thread.runner = _Runner(self.sets, self.noise)

    def _worked(
        self, name: str, correction: np.ndarray | None, weights: Sequence[np.ndarray | None] | None, batch: Sequence[Trial]
    ) -> list[np.ndarray | None]:
        """A batch's answers, corrected and weighted as was due when it was sent."""
        runner: _Runner = getattr(self._of_thread, "runner", self._local)
        runner.finer = self._local.finer
        answers = runner.whitened(name, batch)
        for answer in answers:
            if answer is not None and correction is not None:
                answer += correction
        return [None if answer is None else self._weighted_by(weights, answer, name) for answer in answers]

    def _answers(self, asked: _Asked) -> list[np.ndarray | None]:
        if asked.answers is None:
            self._send()
        assert asked.answers is not None
        return [batch()[k] for batch, k in asked.answers]

    def at_once(self, work: Callable[[Part], Said], parts: Sequence[Part]) -> list[Said]:
        """What work says of every part, on other threads where there are any. It asks for no runs, and says of one part the same whatever
        is done of the others.
        """
        if self._pool is None or hasattr(self._of_thread, "runner"):  # who is on another thread already would wait for itself
            return [work(part) for part in parts]
        return list(self._pool.map(work, parts))

    def run_one(self, trial: Trial, name: str = TRAIN) -> np.ndarray | None:
        return self.run([trial], name)[0]

    def joined(self, rows: Sequence[np.ndarray], name: str = TRAIN) -> np.ndarray:
        """(M,) of rows (N, C) per group."""
        return self._weighted(self._local.join(name, rows), name)

    def by_group(self, whitened: np.ndarray, name: str = TRAIN) -> list[np.ndarray]:
        """(N, C) whitened rows of every group, from (M,)."""
        groups = self.sets[name].groups
        ends = np.cumsum([self.noise.size(len(group.time_s)) for group in groups])[:-1]
        return [part.reshape(-1, len(self.noise.std)) for part in np.split(whitened, ends)]

    def weigh_lines(self, name: str, weights: Sequence[np.ndarray | None] | None) -> None:
        """From now on count lines of these recordings by these weights (K,), one a group, besides their noise model's (`own_lines.py`);
        None: by that alone.
        """
        self._line_weights.pop(name, None)
        if weights is not None:
            self._line_weights[name] = list(weights)

    def _weighted(self, whitened: np.ndarray, name: str) -> np.ndarray:
        return self._weighted_by(self._line_weights.get(name), whitened, name)

    def _weighted_by(self, weights: Sequence[np.ndarray | None] | None, whitened: np.ndarray, name: str) -> np.ndarray:
        if weights is None:
            return whitened
        pairs = zip(self.by_group(whitened, name), weights, strict=True)
        return np.concatenate([(rows if own is None else weighted(rows, own)).ravel() for rows, own in pairs])

    def taken_back(self, whitened: np.ndarray, name: str = TRAIN) -> list[np.ndarray]:
        """(N, C) per group, the adjoint of `joined`."""
        found, rows, start, whitened = self.sets[name], [], 0, self._weighted(whitened, name)
        for group in found.groups:
            noise, count = self.noise.of_mean(group.repeats), len(group.time_s)
            own = np.sqrt(group.repeats) * whitened[start : start + noise.size(count)]
            start += len(own)
            rows.append(noise.taken_back(own, count, group.imu))
        return rows

    def rows(self, trial: Trial, name: str = TRAIN, *, settled: bool = False) -> list[np.ndarray] | None:
        """(N, C) per group in the channels' units; settled: begun by controllers that hold this very machine, see `Inputs.settled`."""
        rows = self._local.rows(name, trial, settled=settled)
        correction = self._correction.get(name)
        return rows if rows is None or correction is None else [one + other for one, other in zip(rows, correction, strict=True)]

    def correct(self, trial: Trial) -> None:
        """From now on add to every run what ever finer plant steps would change in this one.

        The error of the steps hardly depends on what is tried: one fine run near the end of a search stands for all. Where it does depend
        on it, see `refine`.
        """
        for name in self.sets:
            rows = self._step_error(name, trial)
            if rows is not None:
                self._correction[name] = rows
                self._whitened_correction[name] = self._local.join(name, rows)

    def miscorrected(self, trial: Trial) -> float:
        """Energy, in units of noise, by which what is added to every run is not what finer plant steps change in this one: the larger of
        training's and held-out recordings'. 0 where that is not known.
        """
        energies = [0.0]
        for name, correction in self._whitened_correction.items():
            rows = self._step_error(name, trial)
            if rows is not None:
                energies.append(float(np.sum((self._local.join(name, rows) - correction) ** 2)))
        return max(energies)

    def refine(self, factor: int) -> None:
        """Take plant steps so many times finer from now on; what was added to every run until now is to be taken anew."""
        self._local.finer *= factor

    def _step_error(self, name: str, trial: Trial) -> list[np.ndarray] | None:
        """(N, C) per group that ever finer plant steps would change."""
        coarse, fine = self._local.rows(name, trial), self._local.rows(name, trial, fine=True)
        return None if coarse is None or fine is None else [TO_NO_STEP * (f - c) for f, c in zip(fine, coarse, strict=True)]
