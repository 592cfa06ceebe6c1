"""A machine link that answers by script, a clock to go with it, and the smallest loop around both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from controllers.settings import AxisController, AxisLimits
from drivers.interface import Sample
from drivers.judging.judge import SensorJudge
from drivers.judging.settings import DriveJudging, JudgingSettings
from hil.bench.control import Control
from hil.bench.loop import SampleLoop
from hil.bench.row_layout import AxisColumns, RowLayout

PERIOD_S = 1 / 256
AXES = ("propeller", "roll")
GAIN = 10.0  # A/rad, no dynamics: a command can be told by hand


class ScriptedClock:
    """Its `missed` and its time stamps are whatever a script says."""

    def __init__(self) -> None:
        self.idle_began_s = self.tick_began_s = 0.0
        self.missed = 0


class ScriptedLink:
    """Every sample is a machine at `pose` with everything in order, until a script changes it.

    Parameters
    ----------
    clock : ScriptedClock
    script : mapping of row number to callable
        Called with the link before sample k is handed out; changes `sample` in place, or raises.
    """

    def __init__(self, clock: ScriptedClock, script: dict[int, Callable[[ScriptedLink], None]] | None = None) -> None:
        self.clock, self.script = clock, script or {}
        self.sample = Sample(len(AXES))
        self.commands: list[np.ndarray] = []
        self.stops = 0

    def exchange(self, command: np.ndarray) -> Sample:
        sample, k = self.sample, len(self.commands)
        self.commands.append(command.copy())
        sample.position[:] = 0.0
        sample.link_position[:] = 0.0
        sample.effort[:] = command  # the command put on the wire before this SYNC is what the motors feel
        sample.statusword[:] = 0x1637
        sample.fault, sample.unanswered = "", 0
        sample.position_late[:] = False
        if k in self.script:
            self.script[k](self)
        return sample

    def stop(self) -> None:
        self.stops += 1

    @property
    def outcome(self) -> str:
        return "the motors were stopped: propeller, roll at rest: brake proven, voltage off"


@dataclass
class Rows:
    """A sink that keeps everything."""

    rows: list[np.ndarray] = field(default_factory=list)
    keeps = True

    def put(self, row: np.ndarray) -> None:
        self.rows.append(row.copy())


@dataclass
class Signals:
    """A plan by hand: standstill at zero, nothing excited."""

    reference: np.ndarray
    excitation: np.ndarray
    reference_raw: np.ndarray
    feedforward: np.ndarray | None = None


def still(rows: int) -> Signals:
    return Signals(np.zeros((rows, 2)), np.zeros((rows, 2)), np.zeros((rows, 2)))


def layout() -> RowLayout:
    return RowLayout([AxisColumns(axis, "rad", "A", "A") for axis in AXES], PERIOD_S, imu="imu", link=True, temperature=True)


def proportional_loop(link: ScriptedLink, *, guard_io: bool = True) -> SampleLoop:
    """U = 10 A/rad (r - y), limited to 8 A; range +-1 rad, tracking error 0.5 rad, I/O age 0.5 s, 8 lost and 3 stale ticks bridged.

    Roll's drive is judged: its warning stops the motors.
    """
    drive = DriveJudging("drive_roll", 1, "A", "stop", tolerance=0.5, settling_ticks=2, bridged_ticks=3)
    sections = np.array([[GAIN, 0.0, 0.0, 1.0, 0.0, 0.0]])
    return SampleLoop(
        link,
        link.clock,
        Control([AxisController(axis, sections, None, 8.0, False) for axis in AXES]),
        [AxisLimits(axis, -1.0, 1.0, 1.0, 1.0, 1.0, 0.5) for axis in AXES],
        layout(),
        guard_io=guard_io,
        io_stale_s=0.5,
        overrun_ticks=8,
        stale_ticks=3,
        judge=SensorJudge(JudgingSettings(drives=(drive,)), PERIOD_S),
    )


def column(name: str) -> int:
    return [channel for channel, _ in layout().channels].index(name)
