"""The reference of axes that are jogged by hand: it moves while an order is renewed, and comes to rest by itself without one."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
import ruckig

from controllers.settings import AxisLimits

SILENT_S = 0.35
"""Time without a renewed order after which an axis comes to rest: a page renews it three times meanwhile, so that one late order stops
nothing, and whoever lets go, closes the page or is killed stops before anybody would have asked the supervisor."""

SHARE = 0.25
"""Largest share of an axis' speed that is jogged by hand: on the C-arm 15 degrees a second, from which it rests in half a second."""


class HandJog:
    """Jerk-limited references, one tick at a time; no order leads out of a range.

    Parameters
    ----------
    limits : sequence of AxisLimits
        Of all axes, finite.
    period_s : float
    now : callable
        Monotonic time of the wall [s], by which orders are renewed.
    """

    def __init__(self, limits: Sequence[AxisLimits], period_s: float, now: Callable[[], float] = time.monotonic) -> None:
        self._now, self._limits = now, tuple(limits)
        self._orders = np.zeros(len(limits))
        self._heard_s = float("-inf")
        self._steps = [ruckig.Ruckig(1, period_s) for _ in limits]
        self._inputs = [ruckig.InputParameter(1) for _ in limits]
        self._outputs = [ruckig.OutputParameter(1) for _ in limits]
        self.position = np.zeros(len(limits))  # [rad or m] of the reference
        self.begin(self.position)

    def begin(self, pose: np.ndarray) -> None:
        """Begin at rest at a pose (n_axes,), with no order."""
        self.let_go()
        for at, limit, wanted in zip(pose.tolist(), self._limits, self._inputs, strict=True):
            wanted.current_position, wanted.current_velocity, wanted.current_acceleration = [at], [0.0], [0.0]
            wanted.target_velocity, wanted.max_acceleration, wanted.max_jerk = [0.0], [limit.acceleration], [limit.jerk]
        self.position[:] = pose

    def order(self, axis: int, speed: float) -> None:
        """Take, or renew, the order to move an axis at a speed [rad/s or m/s], of which no more than `SHARE` of the limit is followed."""
        most = SHARE * self._limits[axis].speed
        self._orders[:] = 0.0  # one axis at a time: there is one hand
        self._orders[axis] = min(max(speed, -most), most)
        self._heard_s = self._now()

    def let_go(self) -> None:
        """Come to rest from now on."""
        self._orders[:] = 0.0

    @property
    def held(self) -> bool:
        """Whether somebody holds a button just now."""
        return bool(self._orders.any()) and self._now() - self._heard_s <= SILENT_S

    @property
    def rests(self) -> bool:
        """Whether the reference stands."""
        return all(wanted.current_velocity[0] == 0.0 and wanted.current_acceleration[0] == 0.0 for wanted in self._inputs)

    def step(self) -> np.ndarray:
        """Advance by one tick; return the reference (n_axes,), which is overwritten by the next step."""
        orders = self._orders if self.held else np.zeros_like(self._orders)
        parts = zip(self._steps, self._inputs, self._outputs, self._limits, orders.tolist(), strict=True)
        for axis, (step, wanted, found, limit, speed) in enumerate(parts):
            margin = limit.tracking_error
            end = limit.upper - margin if speed > 0.0 else limit.lower + margin
            if speed and (end - wanted.current_position[0]) * speed > 0.0:
                wanted.control_interface = ruckig.ControlInterface.Position
                wanted.target_position, wanted.max_velocity = [end], [abs(speed)]
            else:
                wanted.control_interface = ruckig.ControlInterface.Velocity
            result = step.update(wanted, found)
            if result not in (ruckig.Result.Working, ruckig.Result.Finished):
                raise ValueError(f"{limit.axis}: no jog at {speed:g} from {wanted.current_position}: {result}")
            found.pass_to_input(wanted)
            if result == ruckig.Result.Finished and wanted.control_interface == ruckig.ControlInterface.Velocity:
                wanted.current_velocity, wanted.current_acceleration = [0.0], [0.0]  # without rounding, so that it is seen to stand
            self.position[axis] = found.new_position[0]
        return self.position
