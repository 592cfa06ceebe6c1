"""How to reach a machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hil.machine import Machine


@dataclass(frozen=True)
class BenchOptions:
    """How to reach a machine.

    Parameters
    ----------
    bus_url : str
    imu_device, io_url : str
        Where the IMU and the I/O are, if neither the machine file nor an emulator on this host says so.
    seed : int
        In lockstep, of the emulated sensors' noise.
    noise : bool
        In lockstep, whether they have any.
    frame_log : Path, optional
        Every CAN frame, as candump writes them.
    truth : Path, optional
        In lockstep, what only the emulator knows.
    emulated : Machine, optional
        In lockstep, the machine that is really there, where it differs from its file.
    real_time : bool
        On a bus, ask for real-time scheduling; not where loop and emulator have to share one processor.
    """

    bus_url: str
    imu_device: str = ""
    io_url: str = ""
    seed: int = 0
    noise: bool = True
    frame_log: Path | None = None
    truth: Path | None = None
    emulated: Machine | None = None
    real_time: bool = True
