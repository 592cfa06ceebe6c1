"""Many free runs of one machine, whitened: over plant parameters and effects, on one or more processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from types import TracebackType

import numpy as np

from controllers.errors import ControlError
from hil.diagnosis.mismatch import Mismatch
from hil.diagnosis.noise import NoiseModel
from hil.diagnosis.own_lines import weighted
from hil.diagnosis.simulated import simulated_matrix, smooth
from hil.errors import BenchError
from hil.machine import Machine
from hil.simulation import Simulator
from virtual_bus.errors import EmulatorError
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.parameters import PlantParameter
from virtual_bus.settings import EffectSetting

TRAIN, HELD_OUT = "train", "held_out"

FINE_STEPS = 4
"""By how much finer the plant's steps are whose difference corrects all runs (see `FreeRuns.correct`): the second-order error of a 20 Hz
mode stands out of the noise of four repeats at 1.6 kHz still."""

RUN_AWAY = 1e12
"""A number beyond this, in units of its channel's noise or whitened, is a simulation that runs away."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One machine to try: plant parameters (in the order of `FreeRuns.parameters`), and effects besides the machine file's."""

    values: np.ndarray
    effects: tuple[EffectSetting, ...] = ()


class _Runner:
    """Runs trials in this process."""

    def __init__(self, sets: Mapping[str, Mismatch], noise: NoiseModel) -> None:
        self._sets = sets
        self._noise = noise

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
        found = self._sets[name]
        effects = (*found.machine.plant.effects, *trial.effects)
        folded = []
        for group in found.groups:
            simulator = self._simulator(group.machine, FINE_STEPS if fine else 1)
            try:
                outputs = simulator.run(group.inputs.settled if settled else group.inputs, trial.values, effects)
            except (BenchError, EmulatorError, ControlError):
                return None
            rows = group.fold(simulated_matrix(group.machine, outputs, found.channels))
            if not np.isfinite(rows).all():
                return None
            folded.append(rows)
        return folded

    def whitened(self, name: str, trial: Trial) -> np.ndarray | None:
        rows = self.rows(name, trial)
        if rows is None or any(np.any(np.abs(one) > RUN_AWAY * self._noise.std) for one in rows):  # whitening would overflow
            return None
        joined = self.join(name, rows)
        return joined if float(np.abs(joined).max()) < RUN_AWAY else None

    def join(self, name: str, rows: Sequence[np.ndarray]) -> np.ndarray:
        """(M,) rows of all groups in units of the noise of the repeats' mean."""
        pairs = zip(self._sets[name].groups, rows, strict=True)
        return np.concatenate(
            [np.sqrt(group.repeats) * self._noise.of_mean(group.repeats).whiten(values, group.imu) for group, values in pairs]
        )


_runner: _Runner | None = None  # of a worker process


def _start_worker(runner: _Runner) -> None:
    global _runner
    _runner = runner


def _run_in_worker(task: tuple[str, Trial]) -> np.ndarray | None:
    assert _runner is not None
    return _runner.whitened(*task)


class FreeRuns:
    """Free runs over the training and the held-out groups, in units of the noise of the repeats' mean.

    Parameters
    ----------
    sets : mapping of str to Mismatch
        `TRAIN` and, where there is one, `HELD_OUT`.
    noise : NoiseModel
    jobs : int
        Processes. 1: all in this one.
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
        self._jobs = jobs
        self._pool: ProcessPoolExecutor | None = None
        if jobs > 1:
            how = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
            context = multiprocessing.get_context(how)
            self._pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_start_worker, initargs=(self._local,))

    def __enter__(self) -> FreeRuns:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
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
        """Start these trials on the other processes, where there are any, and return what waits for their answers: see `run`."""
        self.count += len(trials)
        if self._pool is None:
            return lambda: self._corrected((self._local.whitened(name, trial) for trial in trials), name)
        chunk = max(1, len(trials) // (4 * self._jobs))
        answers = self._pool.map(_run_in_worker, [(name, trial) for trial in trials], chunksize=chunk)
        return lambda: self._corrected(answers, name)

    def _corrected(self, answers: Iterable[np.ndarray | None], name: str) -> list[np.ndarray | None]:
        correction = self._whitened_correction.get(name, 0.0)
        return [None if answer is None else self._weighted(answer + correction, name) for answer in answers]

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
        if name not in self._line_weights:
            return whitened
        pairs = zip(self.by_group(whitened, name), self._line_weights[name], strict=True)
        return np.concatenate([(rows if weights is None else weighted(rows, weights)).ravel() for rows, weights in pairs])

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
        """From now on add to every run what finer plant steps change in this one.

        The error of the steps hardly depends on what is tried: one fine run near the end of a search stands for all.
        """
        for name in self.sets:
            coarse, fine = self._local.rows(name, trial), self._local.rows(name, trial, fine=True)
            if coarse is not None and fine is not None:
                self._correction[name] = [f - c for f, c in zip(fine, coarse, strict=True)]
                self._whitened_correction[name] = self._local.join(name, self._correction[name])
