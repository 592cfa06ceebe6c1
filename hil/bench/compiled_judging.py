"""The judges of all sensors, and the watch over all axes, as a compiled function each: a call for a tick of what takes many in Python."""

from __future__ import annotations

import numpy as np
from numba import boolean, float64, from_dtype, int64, uint8

from controllers.compiled import kept_on_disk
from drivers.canopen.motion_bounds import CHECKS, WATCHED, watched
from drivers.interface import Sample, imus_in, values_in
from drivers.judging.drive import judged_drive
from drivers.judging.encoders import judged_encoders
from drivers.judging.imu import judged_imu
from drivers.judging.judge import memory_in
from drivers.judging.temperature import judged_temperature

# One machine code for every machine, made when this is imported: compiling in the middle of a motion would stop the commands for seconds.
_JUDGE = boolean(
    *(uint8[::1], uint8[::1]),
    *(int64, float64, int64, boolean),
    *(float64, float64, int64, boolean, boolean),
)


@kept_on_disk(_JUDGE, fastmath=False, error_model="numpy")
def _judge(
    block: np.ndarray,
    sample: np.ndarray,
    imu_counter: int,
    imu_time_s: float,
    imu_damaged: int,
    has_imu_fault: bool,
    lateness_s: float,
    io_age_s: float,
    ticks: int,
    window_over: bool,
    led: bool,
) -> bool:
    """Judge a sample by all laws, in the order of `found`; return whether any finds something."""
    memory = memory_in(block)
    found, values, imu = memory.found, values_in(sample), imus_in(sample)[:6]
    place, any_found = 0, False
    for k in range(len(memory.imus)):
        if led:
            found[place] = judged_imu(
                memory.imus[k], imu, imu_counter, imu_time_s, imu_damaged, has_imu_fault, lateness_s, ticks, window_over
            )
        any_found = any_found or found[place] != 0
        place += 1
    for k in range(len(memory.pairs)):
        pair = memory.pairs[k]
        if led:
            found[place] = judged_encoders(pair, values[pair.axis], lateness_s, ticks)
        any_found = any_found or found[place] != 0
        place += 1
    for k in range(len(memory.thermometers)):
        thermometer = memory.thermometers[k]
        found[place] = judged_temperature(thermometer, values[thermometer.axis].temperature_degC, io_age_s, ticks)
        any_found = any_found or found[place] != 0
        place += 1
    for k in range(len(memory.drives)):
        drive = memory.drives[k]
        if led:
            found[place] = judged_drive(drive, memory.sent[k], values[drive.axis], ticks, window_over)
        any_found = any_found or found[place] != 0
        place += 1
    return any_found


def judged_at_once(block: np.ndarray, sample: Sample, ticks: int, window_over: bool, led: bool) -> bool:
    """Judge a sample by all laws at once, compiled; a `drivers.judging.judge.Law`."""
    return _judge(
        block,
        sample.memory,
        sample.imu_counter,
        sample.imu_time_s,
        sample.imu_damaged,
        sample.imu_fault != "",
        sample.lateness_s,
        sample.io_age_s,
        ticks,
        window_over,
        led,
    )


@kept_on_disk(int64(from_dtype(WATCHED)[::1], uint8[::1], int64), fastmath=False, error_model="numpy")
def watched_at_once(axes: np.ndarray, sample: np.ndarray, ticks: int) -> int:
    """Check the motion of all axes at once, compiled; a `drivers.canopen.motion_bounds.Law`."""
    values = values_in(sample)
    for k in range(len(axes)):
        found = watched(axes[k], values[k], ticks)
        if found != 0:
            return k * len(CHECKS) + found
    return 0
