"""Efforts on joints, and errors of what the loop reads, sent through the linear closed loop to recordings in units of noise, and back.

Back is the adjoint: products of one whitened record with the responses of any number of efforts are products of the efforts with it taken
back (Kailath, Sayed, Hassibi 2000, ch. 3), so a matched filter over many laws asks for one pass and not for one each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hil.diagnosis.locating.disturbance import LOWEST_Hz, loop_response
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning
from hil.machine import Machine

DIES_OUT = 9.0
"""Logarithm by which answers fall before they go around twice the record: to 10^-4."""

RUNS_AWAY = 1.5
"""Of an effort of half the frequency, from which on a joint's answer grows without end: one that nothing holds doubles at least."""


@dataclass(frozen=True, eq=False)
class _Loop:
    """Of one group, over twice its rows.

    Signals are taken with exp(-growth t), where what runs away stays finite and what goes around the record has died out (Wilcox 1978, Int.
    J. Elect. Eng. Educ. 15).

    Attributes
    ----------
    lines : (L, C, joints + axes) complex array
        To an effort on every joint, and to what every axis' own encoder reads too much, which stands for a joint after the others.
    grown : (N,) array
        exp(growth t).
    standing : (C, joints + axes) array
        Where the channels stand under constant efforts; zero for joints that nothing holds.
    """

    lines: np.ndarray
    grown: np.ndarray
    standing: np.ndarray

    def response(self, joint: int, effort: np.ndarray) -> np.ndarray:
        """(N, C) to an effort (N,) on a joint.

        What acts on the first row has acted before: the machine stands under it, but for joints that nothing holds, which start from rest.
        """
        rows, before = len(effort), effort[0] if np.any(self.standing[:, joint]) else 0.0
        lines = self.lines[:, :, joint] * np.fft.rfft((effort - before) / self.grown, 2 * rows)[:, None]
        return self.grown[:, None] * np.fft.irfft(lines, 2 * rows, axis=0)[:rows] + self.standing[:, joint] * before

    def back(self, channels: np.ndarray) -> np.ndarray:
        """(N, joints + axes) whose product with efforts is that of their responses with `channels` (N, C)."""
        rows = len(channels)
        lines = np.fft.rfft(self.grown[:, None] * channels, 2 * rows, axis=0)
        efforts = np.fft.irfft((self.lines.conj() * lines[:, :, None]).sum(axis=1), 2 * rows, axis=0)[:rows] / self.grown[:, None]
        held = np.any(self.standing, axis=0)
        efforts[0] += np.where(held, channels.sum(axis=0) @ self.standing - efforts.sum(axis=0), 0.0)
        return efforts


@dataclass(frozen=True, eq=False)
class ThroughTheLoop:
    """The closed loop of every group of one set, with a machine's tuned numbers."""

    runs: FreeRuns
    name: str
    tuning: Tuning

    @cached_property
    def loops(self) -> tuple[_Loop, ...]:
        """When they are first asked for: one takes as long as several runs."""
        found, loops = self.runs.sets[self.name], []
        for group in found.groups:
            rows, rate_Hz = len(group.time_s), found.noise.rate_Hz
            frequencies, pose = np.fft.rfftfreq(2 * rows, 1.0 / rate_Hz), group.position.mean(axis=0)
            growth = DIES_OUT * rate_Hz / (2 * rows)
            grown = np.exp(growth * np.arange(rows) / rate_Hz)
            lines = loop_response(group.machine, pose, found.channels, frequencies, self.tuning.values, growth)
            loops.append(_Loop(lines, grown, _standing(group.machine, pose, found.channels, self.tuning.values)))
        return tuple(loops)

    def responses(self, efforts: Sequence[Sequence[tuple[int, np.ndarray]]]) -> np.ndarray:
        """(K, M) whitened, of K joints' numbers and their efforts (N,) per group."""
        loops = self.loops

        def whitened(each: tuple[tuple[int, np.ndarray], ...]) -> np.ndarray:
            return self.runs.joined([loop.response(joint, effort) for loop, (joint, effort) in zip(loops, each, strict=True)], self.name)

        return np.stack(self.runs.at_once(whitened, list(zip(*efforts, strict=True))))

    def efforts_behind(self, whitened: np.ndarray) -> list[np.ndarray]:
        """(N, joints + axes) per group, whose product with efforts is that of their whitened responses with `whitened` (M,)."""
        rows = self.runs.taken_back(whitened, self.name)
        return [loop.back(own) for loop, own in zip(self.loops, rows, strict=True)]


def number_of_encoder(machine: Machine, axis: str) -> int:
    """Stands for a joint's number where what acts is what an axis' own encoder reads too much."""
    return len(machine.plant.tree.joints) + machine.axis_index(axis)


def from_rest(effort: np.ndarray) -> np.ndarray:
    """An effort (N,) that begins with the record: on its first row it is not there yet, and the machine does not stand under it."""
    return np.concatenate([[0.0], effort[1:]])


def _standing(machine: Machine, pose: np.ndarray, channels: tuple[str, ...], values: np.ndarray) -> np.ndarray:
    """(C, joints + axes)"""
    slow, slower = loop_response(machine, pose, channels, np.array([2.0 * LOWEST_Hz, LOWEST_Hz]), values)
    held = np.linalg.norm(slower, axis=0) < RUNS_AWAY * np.linalg.norm(slow, axis=0)
    return np.where(held, slower.real, 0.0)
