"""Options of the bench: how to reach a machine."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from hil.machine import Machine
from virtual_bus.faults.fault import FaultSetting
from virtual_bus.faults.motion_log import MotionLog
from virtual_bus.faults.schedule import FaultEvent
from virtual_bus.quirks.quirk import QuirkSetting


@dataclass(frozen=True)
class BenchOptions:
    """Options of the bench: how to reach a machine.

    Parameters
    ----------
    bus_url : str
    imu_device, io_url : str
        Addresses of the IMU and the I/O, if neither the machine file nor an emulator on this host gives them.
    seed : int
        In lockstep, seed of the emulated sensors' noise.
    noise : bool
        In lockstep, whether the emulated sensors have noise.
    frame_log : Path, optional
        File for every CAN frame, in the format of candump.
    truth : Path, optional
        In lockstep, file for the values that only the emulator knows.
    emulated : Machine, optional
        In lockstep, the machine that is emulated, where it differs from the machine file.
    faults : tuple of FaultSetting
        In lockstep, what goes wrong on the emulated machine.
    quirks : tuple of QuirkSetting
        In lockstep, how the emulated drives bend the standard.
    motion : MotionLog, optional
        In lockstep, takes the machine's true motion, from power-on until it is at rest after the last SYNC.
    events : list
        In lockstep, takes when each fault began and ended.
    real_time : bool
        On a bus, request real-time scheduling; not where loop and emulator have to share one processor.
    paced : bool
        In lockstep, let time pass as on the wall, for somebody who watches.
    accepted_margins : tuple of str
        What `machine check` finds failing of the controllers and the user accepts, in words; goes into every recording.
    """

    bus_url: str
    imu_device: str = ""
    io_url: str = ""
    seed: int = 0
    noise: bool = True
    frame_log: Path | None = None
    truth: Path | None = None
    emulated: Machine | None = None
    faults: tuple[FaultSetting, ...] = ()
    quirks: tuple[QuirkSetting, ...] = ()
    motion: MotionLog | None = None
    events: list[FaultEvent] = field(default_factory=list)
    real_time: bool = True
    paced: bool = False
    accepted_margins: tuple[str, ...] = ()
