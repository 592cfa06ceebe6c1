"""Errors of free runs over several horizons: each horizon and channel counts by the logarithm of its mean square.

No weight between channels is needed, and none between horizons: a factor in any of them counts alike. What each window begins from is
known only as well as sensors tell it; what that makes of a window is no error of the machine.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.diagnosis.simulation.windows import Errors, Simulated, Starts, Windows
from hil.diagnosis.unknowns.unknowns import Machine

PARTS = 4
"""Of the recordings that are left out in turn: stretches of time, and then places, windows whose readings are near each other.

A law that is bent to what was seen predicts a stretch that passes where others did; a place that none of them came to tells."""
MOST_ROWS = 20_000
"""Of the windows of one length, and of those that errors are computed at: more would say the same again."""
CELLS = PARTS**2
FOLDS = np.array([[cell // PARTS == block for cell in range(CELLS)] for block in range(PARTS)]
                 + [[cell % PARTS == block for cell in range(CELLS)] for block in range(PARTS)])  # fmt: skip
"""(2 PARTS, CELLS): which cells, of a stretch and a place each, are left out."""


@dataclass(frozen=True, eq=False)
class Block:
    """One recording over one horizon: W windows of L rows, of which some are looked at.

    Attributes
    ----------
    run : Simulated
    horizon : int
        Which one.
    windows : Windows
        W of L rows.
    picked : (l,) int array
        Rows of a window that errors are computed at.
    cell : (W,) int array
        Which cell each window is in.
    """

    run: Simulated
    horizon: int
    windows: Windows
    picked: np.ndarray
    cell: np.ndarray

    @property
    def recorded(self) -> np.ndarray:
        """What was read (W, l, C)."""
        return self.shaped(self.run.recorded[self.windows.at])

    def shaped(self, errors: np.ndarray) -> np.ndarray:
        """Return errors (W, l, C) of those (W L, C) of the windows, one after the other."""
        return errors.reshape(len(self.windows.first), self.windows.rows, -1)[:, self.picked]


@dataclass(frozen=True, eq=False)
class Left:
    """What one machine leaves: errors (W, l, C) of every block, zero where nothing was read."""

    errors: tuple[np.ndarray, ...]


class Judge:
    """Free runs of machines beside recordings, over some horizons.

    Parameters
    ----------
    runs : sequence of Simulated
    horizons : sequence of float or None
        [s]; None: whole recordings.
    jobs : int or None
        Processors that simulations take at most.
    """

    def __init__(self, runs: Sequence[Simulated], horizons: Sequence[float | None], jobs: int | None = None) -> None:
        self.runs, self.horizons, self.jobs = tuple(runs), tuple(horizons), jobs
        blocks: list[Block] = []
        every = sum(run.rows for run in runs)
        for h, horizon in enumerate(horizons):
            passed = 0
            own = []
            for run in runs:
                begin = run.first_row
                there = run.rows - begin
                whole = there if run.starts else max(run.rows // CELLS, 2)  # stretches of one run, where it does not begin anew
                rows = whole if horizon is None else min(there, max(2, round(horizon / run.period_s)))
                first = begin + np.arange(there // rows) * rows
                if run.starts:  # each window costs
                    first = first[:: max(1, min(len(first) // CELLS, every // MOST_ROWS))]
                windows = Windows(first, rows)
                stride = max(1, len(first) * rows * every // (run.rows * MOST_ROWS))
                picked = np.arange(min(stride, rows - 1), rows, stride)
                stretch = np.minimum(((passed + first + 0.5 * rows) * PARTS / every).astype(np.int64), PARTS - 1)
                own.append(Block(run, h, windows, picked, stretch))
                passed += run.rows
            ends = np.cumsum([len(block.cell) for block in own])[:-1]
            blocks += [
                replace(block, cell=PARTS * block.cell + place) for block, place in zip(own, np.split(_places(own), ends), strict=True)
            ]
        self.blocks = tuple(blocks)
        self.present = tuple(np.isfinite(block.recorded) for block in self.blocks)
        self.noise = np.sqrt(np.mean([run.noise**2 for run in runs], axis=0))

    @property
    def shape(self) -> tuple[int, int]:
        """Horizons and channels."""
        return len(self.horizons), len(self.runs[0].channels)

    @cached_property
    def counts(self) -> np.ndarray:
        """Readings (H, C) that errors are computed at."""
        found = np.zeros(self.shape)
        for block, present in zip(self.blocks, self.present, strict=True):
            found[block.horizon] += present.sum(axis=(0, 1))
        return np.maximum(found, 1.0)

    @cached_property
    def counts_of_folds(self) -> np.ndarray:
        """The same (folds, H, C) of the windows that each fold leaves out."""
        found = np.zeros((CELLS, *self.shape))
        for block, present in zip(self.blocks, self.present, strict=True):
            np.add.at(found[:, block.horizon], block.cell, present.sum(axis=1).astype(float))
        left_out: np.ndarray = np.tensordot(FOLDS.astype(float), found, 1)
        return left_out

    @cached_property
    def moved(self) -> np.ndarray:
        """Mean square (H, C) of what was read, about the first reading of its window."""
        found = np.zeros(self.shape)
        for block, present in zip(self.blocks, self.present, strict=True):
            values = block.recorded
            filled = np.where(present, values, np.nan)
            first = np.nanmean(np.where(np.cumsum(present, axis=1) == 1, filled, np.nan), axis=1, keepdims=True) if len(values) else values
            found[block.horizon] += np.nansum((filled - first) ** 2, axis=(0, 1))
        mean: np.ndarray = np.maximum(found / self.counts, 1e-300)
        return mean

    def left(self, machines: Sequence[Machine], starts: Sequence[Starts | None] | None = None) -> list[Left | None]:
        """Return what machines leave; None where a simulation ended early."""
        begun: list[Callable[[], list[Errors]]] = []
        from_there = [None] * len(machines) if starts is None else starts
        with ThreadPoolExecutor(self.jobs or os.cpu_count()) as threads:
            for k, run in enumerate(self.runs):
                windows = [block.windows for block in self.blocks[k :: len(self.runs)]]
                begun.append(run.begin(machines, from_there, windows, threads))
            every = [ended() for ended in begun]
        found: list[Left | None] = []
        for k in range(len(machines)):
            own = [errors[k] for errors in every]
            if any(one is None for one in own):
                found.append(None)
                continue
            parts = [one[h] for h in range(len(self.horizons)) for one in own if one is not None]
            shaped = [
                np.where(present, block.shaped(part), 0.0) for block, part, present in zip(self.blocks, parts, self.present, strict=True)
            ]
            found.append(Left(tuple(shaped)) if all(np.isfinite(one).all() for one in shaped) else None)
        return found

    def squares(self, errors: Sequence[np.ndarray], fold: int | None = None) -> np.ndarray:
        """Return sums of squares (H, C), of the windows that one fold leaves out where one is given."""
        found = np.zeros(self.shape)
        for block, own in zip(self.blocks, errors, strict=True):
            used = own if fold is None else own[FOLDS[fold, block.cell]]
            found[block.horizon] += np.einsum("wlc,wlc->c", used, used)
        return found

    def mean_squares(self, errors: Sequence[np.ndarray]) -> np.ndarray:
        """Return mean squares (H, C) of errors, and of what sensors are known to err by."""
        mean: np.ndarray = self.squares(errors) / self.counts + self.noise**2
        return mean

    def mean_squares_of_folds(self, errors: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
        """Return those (folds, H, C) of the windows that each fold leaves out, of errors of its own."""
        squares = np.array([self.squares(own, fold) for fold, own in enumerate(errors)])
        mean: np.ndarray = squares / np.maximum(self.counts_of_folds, 1.0) + self.noise**2
        return mean

    def weights_of(self, errors: Sequence[np.ndarray]) -> np.ndarray:
        """Return how many independent readings (H, C) errors count as: horizons alike, so that none outweighs the others.

        Errors that keep their sign for long say one thing for long. Windows of several lengths show the same rows.
        """
        found = np.zeros(self.shape)
        for block, own, present in zip(self.blocks, errors, self.present, strict=True):
            centred = own - own.sum(axis=1, keepdims=True) / np.maximum(present.sum(axis=1, keepdims=True), 1)
            crossed = (centred[:, 1:] * centred[:, :-1] < 0.0).sum(axis=(0, 1))
            found[block.horizon] += np.minimum(crossed + len(block.cell), present.sum(axis=(0, 1)))
        alike: np.ndarray = np.exp(np.mean(np.log(np.maximum(found, 1.0)), axis=0)) / len(self.horizons)
        every: np.ndarray = np.tile(np.maximum(alike, 1.0), (len(self.horizons), 1))
        return every


def _places(blocks: Sequence[Block]) -> np.ndarray:
    """Return which place (W,) each window of some blocks is at: windows in order of what was read most differently in them."""
    means = []
    for block in blocks:
        values = block.recorded
        there = np.isfinite(values)
        means.append(np.where(there, values, 0.0).sum(axis=1) / np.maximum(there.sum(axis=1), 1))
    every = np.concatenate(means)
    spread = every.std(axis=0)
    scaled = (every - every.mean(axis=0)) / np.where(spread > 0.0, spread, np.inf)
    projected = scaled @ np.linalg.svd(scaled, full_matrices=False)[2][0]
    places = np.empty(len(projected), dtype=np.int64)
    places[np.argsort(projected, kind="stable")] = np.arange(len(projected)) * PARTS // len(projected)
    return places
