"""The interface between the sample loop and a machine: exchange a command for a sample, and stop.

Timing (docs/explanation/notation.md): `exchange(command_k)` puts command k on the wire at once, waits for tick k+1, sends SYNC
k+1 and returns sample k+1. The drives apply command k at SYNC k+1, so the effort in sample k+1 already answers to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

ANSWER = np.dtype(
    [
        ("position", "f8"),
        ("link_position", "f8"),
        ("effort", "f8"),
        ("statusword", "i8"),
        ("position_late", "?"),
        ("link_late", "?"),
    ],
    align=True,
)
"""What one axis's devices answer to a SYNC, as compiled code takes it; `Sample` says what each is."""

NO_ANSWER = np.array((np.nan, np.nan, np.nan, -1, False, False), ANSWER)


@dataclass
class Sample:
    """The values latched at one SYNC, in SI and the drives' units. One object is reused for every tick, so copy what must be kept.

    Arrays have the length of the axis list. A value that did not arrive is NaN (or -1 for a statusword) in this row;
    `age_s` says how old the newest good value of that axis is.
    """

    axes: int
    answers: np.ndarray = field(init=False)  # ANSWER; the arrays of its fields, below, are views of it
    position: np.ndarray = field(init=False)  # rad or m
    link_position: np.ndarray = field(init=False)  # rad or m; NaN without a link encoder
    effort: np.ndarray = field(init=False)  # in the drive's unit
    commanded: np.ndarray = field(init=False)  # effort sent before this SYNC, as on the wire; NaN where the drive's own loops add to it
    statusword: np.ndarray = field(init=False)  # int64, -1 when missing
    age_s: np.ndarray = field(init=False)
    imu: np.ndarray = field(init=False)  # (6,) specific force m/s^2, angular rate rad/s
    imu_time_s: float = field(default=float("nan"), init=False)
    imu_counter: int = field(default=-1, init=False)
    bus_imu: np.ndarray = field(init=False)  # (6,) likewise, of the IMU that is a node of the bus; NaN without one
    bus_imu_counter: int = field(default=-1, init=False)  # of its samples, -1 when missing
    temperature_degC: np.ndarray = field(init=False)
    hold_to_run: bool = field(default=True, init=False)
    door_closed: bool = field(default=True, init=False)
    brakes_open: np.ndarray = field(init=False)  # bool
    io_age_s: float = field(default=0.0, init=False)
    lateness_s: float = field(default=0.0, init=False)  # of this tick's SYNC against its absolute time
    arrived_s: float = field(default=0.0, init=False)  # perf_counter when the sample was complete: the wait for answers ends here
    unanswered: int = field(default=0, init=False)  # ticks since any node answered in time, where several should; 0: now
    position_late: np.ndarray = field(init=False)  # bool: only an answer to an earlier SYNC has come, so its node is not silent
    link_late: np.ndarray = field(init=False)
    fault: str = field(default="", init=False)  # first device fault since the last tick, in words; "" when none
    imu_damaged: int = field(default=0, init=False)  # messages of the IMU that failed their checksum since it was configured
    imu_fault: str = field(default="", init=False)  # the IMU's first fault since it was configured; motion does not depend on it

    def __post_init__(self) -> None:
        """Fill the arrays with missing values."""
        self.answers = np.full(self.axes, NO_ANSWER)
        self._bytes, self._missing = self.answers.view(np.uint8), self.answers.view(np.uint8).copy()
        self.position, self.link_position, self.effort = (self.answers[name] for name in ("position", "link_position", "effort"))
        self.statusword = self.answers["statusword"]
        self.position_late, self.link_late = self.answers["position_late"], self.answers["link_late"]
        self.commanded = np.full(self.axes, np.nan)
        self.age_s = np.zeros(self.axes)
        self.imu = np.full(6, np.nan)
        self.bus_imu = np.full(6, np.nan)
        self.temperature_degC = np.full(self.axes, np.nan)
        self.brakes_open = np.zeros(self.axes, dtype=bool)

    def forget_answers(self) -> None:
        """Mark all that the devices answer to a SYNC as missing."""
        self._bytes[:] = self._missing  # field by field it takes ten times as long

    @property
    def is_whole(self) -> bool:
        """Whether every axis's devices have answered this SYNC, as far as their bus is in time."""
        return not self.unanswered and True not in self.position_late.tolist()


class Clock(Protocol):
    """Time as the drivers and the loop know it: wall time on a bench, virtual time in lockstep.

    Attributes
    ----------
    awake_s : float
        How long after a SYNC its answers are polled without sleeping; later ones are awaited asleep.
    """

    awake_s: float

    def now(self) -> float:
        """Return seconds since an arbitrary start."""

    def wait(self, seconds: float) -> None:
        """Let this much time pass (in lockstep the emulated machine advances with it)."""

    def start_ticks(self, period_s: float) -> None:
        """Start ticks at this moment with tick 0; later ticks come at absolute times."""

    def wait_tick(self) -> float:
        """Wait for the next tick and return its lateness [s]. Overrun ticks are skipped entirely, see `missed`."""

    def await_tick(
        self, comes: Callable[[float], bool], due_s: float, patience_s: float, shortly_before: Callable[[], object] | None = None
    ) -> bool:
        """Wait for a tick that somebody else gives, expected at `due_s` and no later than `patience_s` after it.

        `comes` waits for it for so many seconds at most and returns whether it came; so does this. `shortly_before` is called before a
        tick that has not come by then.
        """

    def lose(self, ticks: int) -> None:
        """Count ticks that were lost while others gave them."""

    @property
    def missed(self) -> int:
        """Number of ticks skipped because the work of one took longer than its period."""


class MachineLink(Protocol):
    """A machine that can be run in closed loop, real or emulated."""

    def exchange(self, command: np.ndarray) -> Sample:
        """Send `command` (n_axes,) in the drives' units, wait for the next tick and return what was latched at its SYNC.

        Raises
        ------
        HeartbeatLostError, DeviceFaultError, BusError
            The exchange failed; the motors were told to stop before the error is raised.
        """

    def stop(self) -> None:
        """Quick stop every drive, close the brakes, prove them, disable. Works from any state, any number of times, and never raises."""

    @property
    def outcome(self) -> str:
        """How the last stop ended, in words, as far as it was seen."""
