"""The judges of all sensors, and the watch over all axes, compiled: a call for a tick of what takes many in Python.

One machine code for every machine, made when this is imported: compiling in the middle of a motion would stop the commands for seconds.
"""

from __future__ import annotations

from numba import boolean, float64, int64, uint8, void

from controllers.compiled import kept_on_disk
from drivers.canopen.motion_bounds import watched_axes
from drivers.judging.judge import judged
from drivers.judging.motion_window import average

_JUDGE = boolean(uint8[::1], uint8[::1], int64, float64, int64, boolean, float64, float64, int64, boolean, boolean)
_AVERAGE = void(uint8[::1], float64[:, ::1], float64, float64[:, ::1], float64[::1])
_WATCH = int64(uint8[::1], uint8[::1], int64)

judged_at_once = kept_on_disk(_JUDGE, fastmath=False, error_model="numpy")(judged)
averaged_at_once = kept_on_disk(_AVERAGE, fastmath=False, error_model="numpy")(average)
watched_at_once = kept_on_disk(_WATCH, fastmath=False, error_model="numpy")(watched_axes)
