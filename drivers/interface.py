"""The interface between the sample loop and a machine: exchange a command for a sample, and stop.

Timing (docs/explanation/notation.md): `exchange(command_k)` puts command k on the wire at once, waits for tick k+1, sends SYNC
k+1 and returns sample k+1. The drives apply command k at SYNC k+1, so the effort in sample k+1 already answers to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from drivers.records import record_type

VALUES = record_type(
    # what its devices answer to a SYNC
    ("position", "f8"),
    ("link_position", "f8"),
    ("effort", "f8"),
    ("statusword", "i8"),
    ("position_late", "?"),
    ("link_late", "?"),
    # what is known beside
    ("commanded", "f8"),
    ("age_s", "f8"),
    ("temperature_degC", "f8"),
    ("brakes_open", "?"),
)
"""What a sample holds of one axis, as compiled code takes it; `Sample` says what each is."""

NOTHING = np.array((np.nan, np.nan, np.nan, -1, False, False, np.nan, 0.0, np.nan, False), VALUES)
ANSWERED_BYTES, IMUS_BYTES = 40, 2 * 6 * 8
"""Of what an axis's devices answer, at the beginning of its values, and of the readings of two IMUs."""


@dataclass
class Sample:
    """The values latched at one SYNC, in SI and the drives' units. One object is reused for every tick, so copy what must be kept.

    Arrays have the length of the axis list. A value that did not arrive is NaN (or -1 for a statusword) in this row;
    `age_s` says how old the newest good value of that axis is.
    """

    axes: int
    memory: np.ndarray = field(init=False)  # bytes of all arrays below, which are views of it
    values: np.ndarray = field(init=False)  # VALUES
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
        self.memory = np.zeros(IMUS_BYTES + self.axes * VALUES.itemsize, np.uint8)
        self.values = values = self.memory[IMUS_BYTES:].view(VALUES)
        values[:] = NOTHING
        self.position, self.link_position, self.effort = values["position"], values["link_position"], values["effort"]
        self.statusword = values["statusword"]
        self.position_late, self.link_late = values["position_late"], values["link_late"]
        self.commanded, self.age_s = values["commanded"], values["age_s"]
        self.temperature_degC, self.brakes_open = values["temperature_degC"], values["brakes_open"]
        self.imu, self.bus_imu = self.memory[:IMUS_BYTES].view(np.float64).reshape(2, 6)
        self.imu[:] = self.bus_imu[:] = np.nan
        self._answers = self.memory[IMUS_BYTES:].reshape(self.axes, VALUES.itemsize)[:, :ANSWERED_BYTES]
        self._no_answers = self._answers.copy()

    def forget_answers(self) -> None:
        """Mark all that the devices answer to a SYNC as missing."""
        self._answers[:] = self._no_answers  # field by field it takes ten times as long

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
