"""Options of a run, for type checkers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Required, TypedDict

if TYPE_CHECKING:
    from hil.machine import Machine
    from hil.observing import ObserverDesign
    from hil.shaping.choice import ShaperChoice
    from hil.shaping.shaper_file import ShaperFile


class RunOptions(TypedDict, total=False):
    """Options of `OpenMachine.run`, which describes them."""

    bus: Required[str]
    out: str | Path | None
    shaper: ShaperChoice | ShaperFile | str | Path | None
    observer: ObserverDesign | str | Path | None
    seed: int
    noise: bool
    emulated: Machine | None
    faults: str | Path | None
    truth: str | Path | None
    frame_log: str | Path | None
    imu: str
    io: str
    real_time: bool
    accept_margins: bool
    progress: Callable[[int, int], None] | None
