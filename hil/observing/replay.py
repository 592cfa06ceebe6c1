"""The observer over a recording: bit for bit the same numbers as live, because the same step runs on the same rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from controllers.observers.modal_observer import ModalObserver
from hil.observing.estimate import Estimate
from hil.observing.measured import MeasuredRow
from hil.observing.tuning import rows_of
from hil.recording import Recording

if TYPE_CHECKING:
    from hil.calibration.data_driven.live import LiveCalibration


def observe(
    recording: Recording,
    observer: ModalObserver,
    *,
    machine_hash: str = "",
    notes: tuple[str, ...] = (),
    calibration: LiveCalibration | None = None,
    progress: Callable[[int], None] | None = None,
    after: Callable[[ModalObserver], None] | None = None,
) -> Estimate:
    """Replay an observer over a recording, from its first row on.

    Parameters
    ----------
    recording : Recording
        Channels it lacks count as missing; missing samples are predicted over.
    observer : ModalObserver
        Is restarted.
    calibration : LiveCalibration, optional
        Behind it, as live: levels what it reads, its columns follow. Is restarted.
    after : callable, optional
        Given the observer after each row.

    Raises
    ------
    RecordingError
        Another sample rate, none of the channels, or a hole in the commands.
    """
    measured, commands = rows_of(recording, observer.model)
    channels = observer.model.channels()
    absent = [name for name in channels if name not in recording]
    if absent:
        notes = (*notes, f"not in the recording, so not looked at: {', '.join(absent)}")
    observer.restart()
    row = MeasuredRow(observer.model)
    columns = [*observer.channels, *(calibration.channels if calibration is not None else [])]
    values = np.zeros((len(measured), len(columns)))
    width = len(observer.channels)
    innovation = np.zeros(measured.shape)
    states = np.zeros((len(measured), len(observer.state)))
    ticks = recording.ticks
    if calibration is not None:
        calibration.restart(int(ticks[-1]) + 1)
    for k in range(len(measured)):
        row.take(measured[k])
        if calibration is not None:
            calibration.level(row.values)
        if k and ticks[k] > ticks[k - 1] + 1:  # skipped by the loop; live, time passed there, too
            observer.skip(int(ticks[k] - ticks[k - 1] - 1), commands[k - 1])
        observer.step_measured(row.values, commands[max(k - 1, 0)])
        values[k, :width], innovation[k], states[k] = observer.estimate, observer.innovation, observer.state
        if after is not None:
            after(observer)
        if calibration is not None:
            calibration.step(int(ticks[k]), values[k, :width])
            values[k, width:] = calibration.values
        if progress is not None and k % 1024 == 0:
            progress(k)
    return Estimate(
        time_s=recording.time,
        names=tuple(name for name, _ in columns),
        units=tuple(unit for _, unit in columns),
        values=values,
        measured_names=channels,
        innovation=innovation,
        state_names=tuple(observer.state_names),
        states=states,
        filter=observer.kind,
        machine_hash=machine_hash,
        notes=notes,
    )
