"""Prediction of a plan's effect on the machine before it runs, checked against the limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from controllers.edge_units import at_the_edge
from hil.errors import ExperimentError
from hil.experiments.plan import Plan
from hil.experiments.prediction import ClosedLoop, Response
from hil.machine import Machine
from hil.simulation import Inputs, Simulator
from virtual_bus.physics import Physics

COMMAND_SHARE = 0.9
"""Share of the drive's limit that a prediction may use; the rest is for the initial transient, noise and unmodelled effects."""

REFERENCE_SLACK = 1e-5
"""Relative tolerance, above the rounding in the third differences of a reference at rates up to 1 kHz."""


@dataclass(frozen=True)
class Bound:
    """A bound: offset(t) + a slope(t) must stay within lower and upper for the share a of the requested excitation."""

    what: str
    unit: str
    lower: float
    upper: float
    offset: np.ndarray
    slope: np.ndarray

    @property
    def extreme(self) -> float:
        """Value at a = 1 that is nearest to its bound, or furthest beyond it."""
        values = self.offset + self.slope
        middle = 0.5 * (self.lower + self.upper) if math.isfinite(self.lower + self.upper) else 0.0
        return float(values[np.argmax(np.abs(values - middle))])

    @property
    def broken(self) -> str:
        """What is wrong, in words."""
        extreme, lower, upper = (at_the_edge(value, self.unit, 4) for value in (self.extreme, self.lower, self.upper))
        return f"{self.what} would reach {extreme}; allowed is {lower} to {upper}"

    @property
    def largest_share(self) -> float:
        """Return the largest a >= 0 that keeps the bound; negative where even a = 0 breaks it."""
        if (self.offset > self.upper).any() or (self.offset < self.lower).any():
            return -1.0
        room = np.where(self.slope > 0.0, self.upper - self.offset, self.offset - self.lower)
        size = np.abs(self.slope)
        moving = size > 0.0
        return float((room[moving] / size[moving]).min()) if moving.any() else math.inf


class Safety:
    """Safety checks for one machine at one start pose.

    Raises
    ------
    ExperimentError
        The machine has no controller, cannot hold the pose, or is not stable there.
    """

    def __init__(self, machine: Machine, start_pose: np.ndarray) -> None:
        if not machine.controllers:
            raise ExperimentError(f"{machine.name} has no controller: it can be simulated, not run")
        self._machine = machine
        self._pose = start_pose
        self._effort_units = [units.effort for units in machine.units]
        self.check_holding()

    @cached_property
    def _physics(self) -> Physics:
        return Physics(self._machine.plant, noise=False)

    @cached_property
    def _holding(self) -> np.ndarray:
        return np.asarray(self._physics.holding_effort(self._pose))

    @cached_property
    def _loop(self) -> ClosedLoop:
        return ClosedLoop(self._machine, self._physics, self._pose)

    def check_holding(self) -> None:
        """Check that gravity at the start pose leaves a margin below the drives' limits."""
        for effort, unit, controller in zip(self._holding, self._effort_units, self._machine.controllers, strict=True):
            if abs(effort) > COMMAND_SHARE * controller.limit:
                raise ExperimentError(
                    f"start pose: holding {controller.axis} at {self._pose.round(4).tolist()} takes {effort:.3g} {unit}; "
                    f"{COMMAND_SHARE:.0%} of its {controller.limit:g} {unit} limit may be used"
                )

    def check_stability(self) -> None:
        """Check that the linearised closed loop is stable at the start pose.

        Raises
        ------
        ExperimentError
            It is not stable.
        """
        _ = self._loop

    def check_motion(self, kind: str, reference: np.ndarray) -> str:
        """Simulate the machine without noise along a reference (N, n_axes); check command, position and tracking error against limits.

        Returns
        -------
        str
            Predicted peak command of each axis, for the operator.

        Raises
        ------
        ExperimentError
            A limit would be broken.
        """
        still = np.zeros_like(reference)
        feedforward = gravity_feedforward(self._machine, self._physics, reference)
        inputs = Inputs(reference, still, still if feedforward is None else feedforward, None, self._pose)
        simulated = Simulator(self._machine).run(inputs)
        # not the speed: whole encoder counts per sample tell little about it, and the reference's is checked
        motion = Response(simulated.command - self._holding, simulated.position - self._pose, still)
        bounds = self._bounds(reference - self._pose, motion, Response(still, still, still))
        for bound in bounds:
            if bound.largest_share < 1.0:
                raise ExperimentError(f"{kind}: {bound.broken}; lower speed or acceleration asks less")
        return self._peaks(bounds)

    def check_reference(self, kind: str, reference: np.ndarray, hint: str = "") -> None:
        """Check range, speed, acceleration and jerk of a reference (N, n_axes) that starts from standstill at the start pose."""
        rate = self._machine.sample_rate_Hz
        from_rest = np.vstack([np.tile(self._pose, (3, 1)), reference])
        for axis, limit in enumerate(self._machine.limits):
            position = from_rest[:, axis]
            if position.min() < limit.lower - REFERENCE_SLACK or position.max() > limit.upper + REFERENCE_SLACK:
                worst = position.min() if position.min() < limit.lower else position.max()
                allowed = f"{at_the_edge(limit.lower, limit.unit)} to {at_the_edge(limit.upper, limit.unit)}"
                goes = f"the reference of {limit.axis} goes to {at_the_edge(worst, limit.unit)}"
                raise ExperimentError(f"{kind}: {goes}; its range is {allowed}")
            for order, name in enumerate(("speed", "acceleration", "jerk"), 1):
                most = getattr(limit, name)
                reached = float(np.abs(np.diff(position, order)).max() * rate**order)
                if reached > most * (1.0 + REFERENCE_SLACK):
                    value, allowed = (at_the_edge(each, f"{limit.unit}/s{'' if order == 1 else order}", 4) for each in (reached, most))
                    raise ExperimentError(f"{kind}: the reference of {limit.axis} reaches {name} {value}, the limit is {allowed}{hint}")

    def check_periodic(
        self, kind: str, deviation: np.ndarray, excitations: Sequence[np.ndarray], amplitude: float | None = None
    ) -> list[str]:
        """Check the steady periodic response of the linearised closed loop against every limit.

        Parameters
        ----------
        deviation : (N, n_axes) array
            One period of the reference about the start pose.
        excitations : sequence of (N, n_axes) arrays
            One period of each recording's excitation.
        amplitude : float, optional
            Requested amplitude of all axes, to name the largest that would be possible.

        Returns
        -------
        list of str
            Per excitation the predicted peak command of each axis, for the operator.

        Raises
        ------
        ExperimentError
            One of them would break a limit; the message names the quantity, the limit and the largest possible amplitude for all.
        """
        moved = self._loop.steady(deviation, self._feedforward(deviation))
        found = [self._bounds(deviation, moved, self._loop.steady(np.zeros_like(deviation), each)) for each in excitations]
        tightest = min((bound for bounds in found for bound in bounds), key=lambda bound: bound.largest_share)
        if tightest.largest_share < 1.0:
            raise ExperimentError(f"{kind}: {self._complaint(tightest, amplitude)}")
        return [self._peaks(bounds) for bounds in found]

    def _bounds(self, deviation: np.ndarray, moved: Response, driven: Response) -> list[Bound]:
        """Return every limit that one excitation could break.

        Acceleration and jerk are limits of references: the effect of an excitation on them is bounded by the drives' effort.
        """
        bounds = []
        for axis, (limit, controller) in enumerate(zip(self._machine.limits, self._machine.controllers, strict=True)):
            most, error = COMMAND_SHARE * controller.limit, limit.tracking_error
            rows = (
                ("command", self._effort_units[axis], -most, most, self._holding[axis] + moved.command, driven.command),
                ("position", limit.unit, limit.lower, limit.upper, self._pose[axis] + moved.position, driven.position),
                ("speed", f"{limit.unit}/s", -limit.speed, limit.speed, moved.speed, driven.speed),
                ("tracking error", limit.unit, -error, error, deviation - moved.position, -driven.position),
            )
            bounds += [
                Bound(f"{what} of {limit.axis}", unit, low, high, at_rest[:, axis], by[:, axis])
                for what, unit, low, high, at_rest, by in rows
            ]
        return bounds

    def _feedforward(self, deviation: np.ndarray) -> np.ndarray:
        """Return what gravity feedforward adds to the command during the motion, relative to standstill."""
        along = gravity_feedforward(self._machine, self._physics, self._pose + deviation)
        at_rest = gravity_feedforward(self._machine, self._physics, self._pose[None, :])
        return np.zeros_like(deviation) if along is None or at_rest is None else along - at_rest

    def _complaint(self, bound: Bound, amplitude: float | None) -> str:
        if bound.largest_share <= 0.0:
            return f"{bound.broken}, which holding and jog break by themselves"
        if amplitude is None:
            return f"{bound.broken}; at most {rounded_down(bound.largest_share):.3g} times these amplitudes would do"
        unit, largest = self._effort_units[0], rounded_down(bound.largest_share * amplitude)
        return f"{bound.broken}; an amplitude of at most {largest:.3g} {unit} instead of {amplitude:g} {unit} would do"

    def _peaks(self, bounds: list[Bound]) -> str:
        commands = [bound for bound in bounds if bound.what.startswith("command")]
        peaks = [
            f"{controller.axis} {np.abs(bound.offset + bound.slope).max():.2f} of {controller.limit:g} {bound.unit}"
            for bound, controller in zip(commands, self._machine.controllers, strict=True)
        ]
        return "predicted peak command: " + ", ".join(peaks)

    def plan(
        self,
        reference: np.ndarray,
        excitation: np.ndarray,
        start_pose: np.ndarray,
        metadata: dict[str, Any],
        notes: tuple[str, ...] = (),
    ) -> Plan:
        """Make the plan, with gravity feedforward for the axes that have it."""
        feedforward = gravity_feedforward(self._machine, self._physics, reference)
        return Plan(self._machine.axes, reference, reference, excitation, feedforward, start_pose, metadata, notes)


def gravity_feedforward(machine: Machine, physics: Physics, reference: np.ndarray) -> np.ndarray | None:
    """Return the static holding effort at every row of a reference (N, n_axes), for axes with feedforward; None when there is none."""
    asking = np.array([controller.gravity_feedforward for controller in machine.controllers])
    if not asking.any():
        return None
    poses, rows = np.unique(reference, axis=0, return_inverse=True)
    efforts = np.array([physics.holding_effort(pose) for pose in poses])
    return np.where(asking, efforts[rows.reshape(-1)], 0.0)


def rounded_down(value: float) -> float:
    """Round to three significant digits, never above `value`."""
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.floor(value / step * (1.0 - 1e-12)) * step
