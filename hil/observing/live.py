"""The observer in the sample loop: its inputs per tick, its columns in a recording, and its addition to the command."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from controllers.damping import ModalDamping
from controllers.observers.modal_observer import ModalObserver
from drivers.interface import Sample
from hil.errors import UnusableInputError
from hil.observing.board import EstimateBoard
from hil.observing.measured import MeasuredRow
from hil.recording.channels import imu_channels

if TYPE_CHECKING:
    from hil.calibration.data_driven.live import LiveCalibration

IMU_GAP_ROWS = 8
"""Rows without an IMU over which the estimate is still acted upon: 31 ms at 256 Hz, a quarter of an 8 Hz period."""


class LiveObserver:
    """One observer for the loop.

    Parameters
    ----------
    observer : ModalObserver
    design : str
        Where its design is from, for the recording's metadata.
    damping : ModalDamping, optional
        Feedback from the estimate.
    effort_units : sequence of str
        Of the drives, where there is damping.
    imu : str
        Name of the IMU on the bench's line, of those the model knows; "" without one.
    calibration : LiveCalibration, optional
        Behind the observer: levels what it reads, and makes geometry of what it says and of images.

    Attributes
    ----------
    channels : list of (name, unit)
        Columns for the recording, in the order of `estimate`: the observer's, then `damping_<axis>` and `damping_share`,
        then the calibration's.
    estimate : (channels,) array
        Overwritten by every step; NaN before the first.
    effort : (n_axes,) array
        What it adds to the command.
    metadata : mapping
        Of the recording, so that a replay is the same filter.

    Raises
    ------
    UnusableInputError
        Damping without an IMU: it would never come into force.
    """

    def __init__(
        self,
        observer: ModalObserver,
        design: str = "",
        damping: ModalDamping | None = None,
        effort_units: Sequence[str] = (),
        *,
        imu: str = "imu",
        bus_imu: str = "",
        calibration: LiveCalibration | None = None,
    ) -> None:
        self.observer, self.damping, self.calibration = observer, damping, calibration
        axes = len(observer.model.axes)
        self.effort = np.zeros(axes) if damping is None else damping.effort
        self.channels = list(observer.channels)
        adapted = [mode + 1 for mode in observer.adapted]
        self.metadata: dict[str, Any] = {"design": design, "filter": observer.kind, "adapted_modes": adapted}
        if damping is not None:
            self.channels += [(f"damping_{axis}", unit) for axis, unit in zip(observer.model.axes, effort_units, strict=True)]
            self.channels.append(("damping_share", ""))
            self.metadata["damping"] = {"mode": damping.settings.mode + 1, "ratio": damping.settings.ratio}
        if calibration is not None:
            self.channels += calibration.channels
            self.metadata["calibration"] = {"until_m": calibration.until_m}
        self.estimate = np.full(len(self.channels), np.nan)
        self._observed = len(observer.channels)
        self._row = MeasuredRow(observer.model)
        channels = observer.model.channels()
        self._read = np.full(len(channels), np.nan)  # an IMU without a line stays missing
        self._imu_at = _places(imu, channels)
        self._bus_imu_at = _places(bus_imu, channels)
        if damping is not None and not len(self._imu_at):
            known = ", ".join(channels[2 * axes :])
            raise UnusableInputError(
                f"--damping: acts on an IMU's word; the bench has {imu or 'none'}, the observer's model looks at {known}"
            )
        self._board: EstimateBoard | None = None
        self._understudy = ModalObserver(observer.model, observer.noise, observer.kind, observer.adapted)
        nothing = np.zeros(axes)
        observer.step_measured(self._row.values, nothing)  # compiled before a tick waits for it
        if damping is not None:
            damping.step(observer.state, nothing, False, 0)
        self.restart(0)

    def restart(self, rows: int) -> None:
        """Prepare for row 0 of a plan of so many ticks; a replay starts here, too."""
        self._row.restart()
        self.observer.restart()
        self._understudy.restart()
        self.estimate[:] = np.nan
        self._without_imu = self._rows = self._tick = 0
        if self.calibration is not None:
            self.calibration.restart(rows)
        if self.damping is not None:
            self.damping.restart(rows)

    def rehearse(self) -> None:
        """Step another filter on the last row, shortly before a tick, which halves the time of the real step."""
        self._understudy.step_measured(self._row.values, self.effort)

    def step(self, sample: Sample, command: np.ndarray, tick: int) -> None:
        """Process a tick of the plan before the feedback: its sample, and the previous row's command (n_axes,), on the wire."""
        read, axes = self._read, len(command)
        read[:axes] = sample.position
        read[axes : 2 * axes] = sample.link_position
        if len(self._imu_at):
            read[self._imu_at] = sample.imu
        if len(self._bus_imu_at):
            read[self._bus_imu_at] = sample.bus_imu
        self._row.take(read)
        if self.calibration is not None:
            self.calibration.level(self._row.values)
        observer, observed = self.observer, self._observed
        if self._rows and tick > self._tick + 1:
            observer.skip(tick - self._tick - 1, command)
        self._tick = tick
        observer.step_measured(self._row.values, command)
        self.estimate[:observed] = observer.estimate
        damping = self.damping
        if damping is not None:
            damping.step(observer.state, command, self._is_good(), tick)
            self.estimate[observed : observed + axes] = damping.effort
            self.estimate[observed + axes] = damping.share
        if self.calibration is not None:
            self.calibration.step(tick, self.estimate)
            self.estimate[-len(self.calibration.values) :] = self.calibration.values
        if self._board is not None:
            self._board.put(self._rows, self.estimate)
        self._rows += 1

    @contextlib.contextmanager
    def shown(self, bus_url: str) -> Iterator[None]:
        """Let other processes find the newest estimate under this bus (`hil.observing.board`) inside the block."""
        board = self._board = EstimateBoard(bus_url, [name for name, _ in self.channels])
        try:
            yield
        finally:
            self._board = None
            board.close()

    def _is_good(self) -> bool:
        """Tell whether the estimate may be acted upon: finite, no lasting alarm, and a recent IMU reading."""
        axes = len(self.effort)
        read = self._row.values[2 * axes :].tolist()
        self._without_imu = 0 if any(value == value for value in read) else self._without_imu + 1
        is_known = self._without_imu <= IMU_GAP_ROWS and not self.observer.has_lasting_alarm
        return is_known and isfinite(sum(self.observer.state.tolist()))  # of arrays so short NumPy takes longer


def _places(imu: str, channels: Sequence[str]) -> np.ndarray:
    """Return where the channels of an IMU are among those the model looks at; an array, since a list would be made one at every use."""
    return np.array([channels.index(name) for name in (imu_channels(imu) if imu else ()) if name in channels], dtype=np.intp)
