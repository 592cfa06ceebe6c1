"""The feedback of a bench: efforts for every tick, and targets for drives that close loops of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import nan

import numpy as np

from controllers.cascade import AxisCommand
from controllers.feedback import Feedback
from controllers.settings import AxisController
from drivers.interface import Sample

LeadTo = Callable[[int, float], None]
"""Sets the position or velocity that the drive of an axis follows from the next tick on."""


class Control:
    """Computes what is sent in each tick.

    Parameters
    ----------
    controllers : sequence of AxisController
        Laws in effort, of bench and drives together, in axis order.
    commands : sequence of AxisCommand or None
        What the bench commands of drives that close loops of their own; None, or no sequence: the effort.
    lead_to : LeadTo, optional
        Takes the targets of such drives.
    takes_effort : callable, optional
        Whether the drive of an axis takes an effort beside its own; one that does not begins to hold with nothing.

    Attributes
    ----------
    law : Feedback
        The whole law in effort, with its states; beside a drive's own loops it runs along.
    effort : (n_axes,) array
        Sent in the next tick: all of the effort, or what a drive adds to that of its own loops. Overwritten by every step.
    demand : (n_axes,) array
        The effort that the drives will give.
    command : (n_axes,) array
        What is recorded as the command: an effort, a velocity or a position.
    """

    def __init__(
        self,
        controllers: Sequence[AxisController],
        commands: Sequence[AxisCommand | None] = (),
        lead_to: LeadTo | None = None,
        takes_effort: Callable[[int], bool] = lambda axis: True,
    ) -> None:
        axes = len(controllers)
        self.law = Feedback(controllers)
        self.effort = self.demand = self.command = np.zeros(axes)
        self._led = [(axis, command.mode == "position") for axis, command in enumerate(commands) if command is not None]
        self._lead_to: LeadTo = lead_to or (lambda axis, target: None)
        self._led_axes = [axis for axis, _ in self._led]
        self._behind = [0] * axes  # SYNCs since the filters of each led axis were stepped
        self._nothing, self._at = np.zeros(axes), np.zeros(axes)
        self._pushed = [takes_effort(axis) for axis in range(axes)]
        self._holding = np.zeros(axes)  # beside the drive's own integrator, which begins with nothing
        if self._led:
            own = [law if command is None else command.controller for law, command in zip(controllers, commands, strict=True)]
            self._own = Feedback(own)
            self.demand, self.command = np.zeros(axes), np.zeros(axes)
            self._known = np.zeros(axes)  # positions, NaN where the drive of a led axis has not told its own
            self._pushed_by, self._scratch = np.zeros((2, axes)), np.zeros(axes)  # excitation and feedforward of the last step
            self._added, self._ahead = np.zeros(axes), np.zeros(axes)  # of axes that are commanded efforts
        self._compile()

    def step(self, reference: np.ndarray, position: np.ndarray, excitation: np.ndarray, feedforward: np.ndarray) -> None:
        """Compute the next tick from this sample; all arrays are (n_axes,) float64.

        An axis that is behind, see `fall_behind`, keeps its correction, as its position is not of this tick: a target velocity stays, a
        target position goes on with the reference.
        """
        if not self._led:
            self.law.step(reference, position, excitation, feedforward, self.demand)
            return
        known = self._known
        known[:] = position
        for axis, _ in self._led:
            if self._behind[axis]:
                known[axis] = nan
        self._pushed_by[0], self._pushed_by[1] = excitation, feedforward
        self.law.step(reference, known, excitation, feedforward, self.demand)
        added, ahead = self._added, self._ahead
        added[:], ahead[:] = excitation, feedforward
        for axis, _ in self._led:
            added[axis] = ahead[axis] = 0.0
        self._own.step(reference, known, added, ahead, self.command)
        self.effort[:] = self.demand
        for axis, is_position in self._led:
            if is_position:
                self.command[axis] += reference[axis]  # which the correction, within its own limit, is beside
            self.effort[axis] = self._holding[axis] + excitation[axis] + feedforward[axis]
            self._lead_to(axis, self.command[axis])

    @property
    def led(self) -> Sequence[int]:
        """Axes whose drives close loops of their own."""
        return self._led_axes

    def fall_behind(self, axis: int) -> None:
        """Take note of a SYNC whose position of a led axis has not come: its drive has closed its loops all the same."""
        self._behind[axis] += 1

    def catch_up(self, axis: int, references: np.ndarray, position_before: float, position: float) -> None:
        """Step the filters of an axis through the ticks that it is behind, along the straight line between the positions around them.

        Parameters
        ----------
        axis : int
        references : (n,) array
            Of these ticks [rad or m]; the oldest are left out where there are more ticks.
        position_before, position : float
            Of the tick before them, and of the one after.
        """
        behind, self._behind[axis] = self._behind[axis], 0
        known, scratch = self._known, self._scratch
        known.fill(nan)
        way = position - position_before
        for tick in range(1, behind + 1):
            known[axis] = position_before + way * tick / (behind + 1)
            self._at.fill(0.0)
            self._at[axis] = references[max(len(references) - behind + tick - 1, 0)]
            self._own.step(self._at, known, self._nothing, self._nothing, scratch)
            self.law.step(self._at, known, self._pushed_by[0], self._pushed_by[1], scratch)
            self.demand[axis] = scratch[axis]

    def expect(self, sample: Sample) -> None:
        """Complete what a sample says was commanded: the effort that a drive's own loops should give."""
        for axis, _ in self._led:
            if self._pushed[axis]:
                sample.commanded[axis] = self.demand[axis]

    def preload(self, holding_effort: np.ndarray, position: np.ndarray, feedforward: np.ndarray) -> None:
        """Begin with a lasting standstill at `position`, held by `holding_effort`, part of it from `feedforward`; (n_axes,) each.

        Raises
        ------
        DesignError
            See `controllers.feedback.Feedback.preload`.
        """
        self._behind = [0] * len(self._behind)
        self.law.preload(holding_effort, position, feedforward)
        self.effort[:] = self.demand[:] = holding_effort
        if not self._led:
            return
        output, ahead = holding_effort.copy(), feedforward.copy()
        for axis, _ in self._led:
            output[axis] = ahead[axis] = 0.0
            self._holding[axis] = holding_effort[axis] - feedforward[axis]
        self._pushed_by[0], self._pushed_by[1] = 0.0, feedforward
        self._own.preload(output, position, ahead)
        self.command[:] = output
        for axis, is_position in self._led:
            self.command[axis] = position[axis] if is_position else 0.0
            self._lead_to(axis, self.command[axis])

    def _compile(self) -> None:
        """Compile the feedback by a first step, so that a machine's first tick does not wait for it."""
        nothing = np.zeros(len(self.effort))
        self.law.step(nothing, nothing, nothing, nothing, nothing.copy())
        self.law.reset()
