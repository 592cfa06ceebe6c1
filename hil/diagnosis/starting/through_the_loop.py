"""Efforts on joints, and errors of what the loop reads, sent through the linear closed loop to recordings in units of noise, and back.

Back is the adjoint: products of one whitened record with the responses of any number of efforts are products of the efforts with it taken
back (Kailath, Sayed, Hassibi 2000, ch. 3), so a matched filter over many laws asks for one pass and not for one each.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft

from hil.diagnosis.locating.disturbance import LOWEST_Hz, loop_response
from hil.diagnosis.tuning.free_run import FreeRuns
from hil.diagnosis.tuning.retune import Tuning
from hil.machine import Machine
from virtual_bus.effects.places import is_prismatic

DIES_OUT = 9.0
"""Logarithm by which answers fall before they go around twice the record: to 10^-4."""

REACH = 0.4
"""Way from a pose, in rad over all axes that turn, along which its linear loop stands for the machine's."""

MOST_POSES = 6
"""At which the loop is linear. What a vibrating floor does to a C-arm's propeller while it turns by 1.6 rad has a cosine of 0.47 with what
the loop at the mean pose does, 0.88 at two poses, 0.97 at four and 0.994 at six; to a pan and tilt head 0.88, 0.88, 0.97 and 0.987."""

RUNS_AWAY = 1.5
"""Of an effort of half the frequency, from which on a joint's answer grows without end: one that nothing holds doubles at least."""


@dataclass(frozen=True, eq=False)
class _AtOnePose:
    """Of one group at one pose, over twice its rows.

    Signals are taken with exp(-growth t), where what runs away stays finite and what goes around the record has died out (Wilcox 1978, Int.
    J. Elect. Eng. Educ. 15).

    Attributes
    ----------
    lines : (joints + axes, C, L) complex array
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
        """(C, N) to an effort (N,) on a joint.

        What acts on the first row has acted before: the machine stands under it, but for joints that nothing holds, which start from rest.
        """
        rows, before = len(effort), effort[0] if np.any(self.standing[:, joint]) else 0.0
        lines = self.lines[joint] * scipy.fft.rfft((effort - before) / self.grown, 2 * rows)
        answer = np.asarray(scipy.fft.irfft(lines, 2 * rows, overwrite_x=True))[:, :rows]
        answer *= self.grown
        answer += self.standing[:, joint, None] * before
        return answer

    def back(self, channels: np.ndarray) -> np.ndarray:
        """(joints + axes, N) whose product with efforts is that of their responses with `channels` (C, N)."""
        rows = channels.shape[1]
        lines = np.conj(self.lines) * scipy.fft.rfft(self.grown * channels, 2 * rows)
        efforts = np.asarray(scipy.fft.irfft(lines.sum(axis=1), 2 * rows))[:, :rows] / self.grown
        held = np.any(self.standing, axis=0)
        efforts[:, 0] += np.where(held, channels.sum(axis=1) @ self.standing - efforts.sum(axis=1), 0.0)
        return efforts


@dataclass(frozen=True, eq=False)
class _Loop:
    """Of one group along its motion: at every time a mixture of the loops at the poses that are near.

    A loop that holds its joints answers to an effort within a few of its periods, in which a pose hardly changes: answers of each pose's
    loop to all of an effort are mixed. IMUs turn with what carries them: what the loop at one pose says of them does not hold far from it.

    Attributes
    ----------
    poses : tuple of _AtOnePose
    near : (P, N) array
        Shares of every pose, over time.
    """

    poses: tuple[_AtOnePose, ...]
    near: np.ndarray

    def response(self, joint: int, effort: np.ndarray) -> np.ndarray:
        """(N, C) to an effort (N,) on a joint."""
        each = zip(self.poses, self.near, strict=True)
        return functools.reduce(np.add, (share * pose.response(joint, effort) for pose, share in each)).T

    def back(self, channels: np.ndarray) -> np.ndarray:
        """(N, joints + axes) whose product with efforts is that of their responses with `channels` (N, C)."""
        each = zip(self.poses, self.near, strict=True)
        return functools.reduce(np.add, (pose.back(share * channels.T) for pose, share in each)).T


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
            frequencies, growth = np.fft.rfftfreq(2 * rows, 1.0 / rate_Hz), DIES_OUT * rate_Hz / (2 * rows)
            grown = np.exp(growth * np.arange(rows) / rate_Hz)
            poses, near = poses_along(group.position, self._turning(group.machine, group.position.mean(axis=0)))
            each = [
                _AtOnePose(
                    np.ascontiguousarray(loop_response(group.machine, pose, found.channels, frequencies, self.tuning.values, growth).T),
                    grown,
                    _standing(group.machine, pose, found.channels, self.tuning.values),
                )
                for pose in poses
            ]
            loops.append(_Loop(tuple(each), near))
        return tuple(loops)

    def _turning(self, machine: Machine, mean: np.ndarray) -> np.ndarray:
        """(axes,) of which axes the position tells loops apart: none where a joint that nothing holds would carry all of its past from pose
        to pose, nor where one axis alone turns and no IMU with it.
        """
        joints = len(machine.plant.tree.joints)
        standing = _standing(machine, mean, self.runs.sets[self.name].channels, self.tuning.values)[:, :joints]
        if not np.all(np.any(standing, axis=0)) or (len(machine.axes) == 1 and not machine.plant.imus):
            return np.zeros(len(machine.axes), dtype=bool)
        return np.array([not is_prismatic(axis, machine.plant) for axis in machine.axes])

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


def poses_along(position: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses that stand for a motion, and how near it is to each over time.

    Parameters
    ----------
    position : (N, axes) array
        rad or m.
    turns : (axes,) bool array
        Of which axes the position tells poses apart: one that slides turns no sensor.

    Returns
    -------
    poses : (P, axes) array
        The mean where all of the motion is within REACH of it, else the pose farthest from it and then, one after another, those farthest
        from all chosen ones, until all of the motion is within REACH of one or there are MOST_POSES. A turn on is the same pose.
    near : (P, N) array
        Shares, at every time of sum 1: of a normal law over the distance, half the least distance between two poses wide.
    """
    mean = position.mean(axis=0)

    def away(pose: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm(_within_a_turn((position - pose)[:, turns]), axis=1))

    if away(mean).max() <= REACH:
        return mean[None], np.ones((1, len(position)))
    poses = [position[np.argmax(away(mean))]]
    while True:
        distances = np.array([away(pose) for pose in poses])
        nearest = distances.min(axis=0)
        if len(poses) == MOST_POSES or nearest.max() <= REACH:
            break
        poses.append(position[np.argmax(nearest)])
    found = np.array(poses)
    between = np.linalg.norm(_within_a_turn((found[:, None] - found[None])[:, :, turns]), axis=2)[np.triu_indices(len(found), 1)].min()
    exponents = -0.5 * (distances / (0.5 * between)) ** 2
    near = np.exp(exponents - exponents.max(axis=0))
    return found, near / near.sum(axis=0)


def _within_a_turn(angles: np.ndarray) -> np.ndarray:
    return (angles + np.pi) % (2.0 * np.pi) - np.pi


def _standing(machine: Machine, pose: np.ndarray, channels: tuple[str, ...], values: np.ndarray) -> np.ndarray:
    """(C, joints + axes)"""
    slow, slower = loop_response(machine, pose, channels, np.array([2.0 * LOWEST_Hz, LOWEST_Hz]), values)
    held = np.linalg.norm(slower, axis=0) < RUNS_AWAY * np.linalg.norm(slow, axis=0)
    return np.where(held, slower.real, 0.0)
