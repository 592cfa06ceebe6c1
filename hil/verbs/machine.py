"""A machine opened: what its file says, and the experiments that run on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self, Unpack, overload

import numpy as np

from hil.errors import UnusableInputError
from hil.experiments import Experiment, JogOnly, Move, Multisine, Scan, Static, Tour
from hil.experiments.plan import pose_array
from hil.machine import Finding, Machine, load_machine
from hil.machine.effects_file import bound_effects, read_effects_file
from hil.recording import Recording
from hil.verbs.check import findings_of
from hil.verbs.errors import as_bench_errors
from hil.verbs.options import RunOptions
from hil.verbs.recordings import Recordings

if TYPE_CHECKING:
    import control

    from virtual_bus.linear.plant import LinearPlant


@dataclass(frozen=True)
class OpenMachine(Machine):
    """A machine file, read and checked, that can be run; made by `open_machine`. Positions are in rad (m on a prismatic axis)."""

    @overload
    def run(self, experiment: Multisine, **options: Unpack[RunOptions]) -> Recordings: ...
    @overload
    def run(self, experiment: JogOnly | Scan | Static | Move | Tour, **options: Unpack[RunOptions]) -> Recording: ...
    @overload
    def run(self, experiment: Experiment, **options: Unpack[RunOptions]) -> Recording | Recordings: ...
    def run(self, experiment: Experiment, **options: Unpack[RunOptions]) -> Recording | Recordings:
        """Run an experiment in closed loop and record it.

        Parameters
        ----------
        experiment : Experiment
            Planned, and checked against every limit, before anything moves.
        bus : str
            `lockstep:`, `socketcan:can0`, `udp:GROUP` or any INTERFACE:CHANNEL of python-can. On `lockstep:` the emulated machine runs in
            this process and in virtual time. On any other bus processes are started, so a script does its work under
            `if __name__ == "__main__":`.
        out : str or Path, optional
            File to keep (.mf4, .csv, .parquet or .mcap); of several recordings each gets its realisation and experiment in its name. None
            keeps no file. An existing recording is moved aside.
        shaper : ShaperChoice, ShaperFile or path, optional
            The reference goes through it.
        observer : ObserverDesign or path, optional
            Runs along; its estimates join the recording.
        seed : int
            In lockstep, of the emulated sensors' noise: runs that shall not be copies of each other each take their own.
        noise : bool
            In lockstep, whether the emulated sensors have noise.
        emulated : Machine, optional
            In lockstep, the machine that is really there, where it is not as its file says: `machine.with_effect(...)`.
        faults : path, optional
            In lockstep, a faults file: what goes wrong, and when.
        truth, frame_log : path, optional
            Files for what only the emulator knows, in lockstep, and for every CAN frame.
        imu, io : str
            Addresses of IMU and I/O where the machine file names none.
        real_time : bool
            On a bus, ask for real-time scheduling.
        accept_margins : bool
            Run a controller that `check` fails; the recording says so.
        progress : callable, optional
            In lockstep, told from time to time how many of how many rows are done.

        Returns
        -------
        Recording, or Recordings of a multisine

        Raises
        ------
        ExperimentError
            The experiment cannot be run on this machine.
        LoopAbortedError, DriverError
            The motors were stopped; what was recorded until then is kept.
        """
        from hil.verbs.run import run  # here because it loads the bench

        return run(self, experiment, **options)

    def home(self, bus: str, *, imu: str = "", io: str = "") -> tuple[str, ...]:
        """Check brakes and the direction of every axis, home, and leave the machine braked; return the findings, a line each.

        A `RecordingWarning` tells of sensors that were not to be believed.

        Raises
        ------
        DriverError
            A device is absent, wrong or at fault, or a check failed; the motors were stopped.
        """
        from hil.verbs.run import home

        return home(self, bus, imu=imu, io=io)

    def move(self, to: Mapping[str, float], bus: str, *, imu: str = "", io: str = "") -> dict[str, float]:
        """Go to a pose and close the brakes there; axes left out stay. Return where each axis stands [rad or m]."""
        from hil.verbs.run import move

        return move(self, to, bus, imu=imu, io=io)

    @as_bench_errors()
    def check(self) -> list[Finding]:
        """Return what a machine file is checked for: modes, margins, holding efforts, bus load; those that fail have `ok` False."""
        return findings_of(self)

    @as_bench_errors()
    def with_effect(self, name: str, at: str, **parameters: float) -> Self:
        """Return the same machine with one more effect of the catalogue.

        Parameters
        ----------
        name, at : str
            As in an effects file, and as `isocenter effects` lists them.
        **parameters : float
            With their units in their names: `with_effect("coulomb_friction", "roll", Fc_Nm=12.0)`.

        Raises
        ------
        MachineFileError
            There is no such effect, place or parameter; the message says what there is.
        """
        added = bound_effects([{"name": name, "at": at, **parameters}], self, "with_effect")
        return self.with_effects((*self.plant.effects, *added))

    @as_bench_errors()
    def with_effects_file(self, path: str | Path) -> Self:
        """Return the same machine with the effects of a file (TOML), as `diagnose` writes it."""
        return self.with_effects((*self.plant.effects, *read_effects_file(path, self)))

    @as_bench_errors()
    def plant_at(self, pose: Mapping[str, float] | None = None) -> control.StateSpace:
        """Return the plant, linear about rest at a pose: from efforts to encoders and IMU, continuous, without friction effects.

        Parameters
        ----------
        pose : mapping, optional
            Positions by axis name [rad or m]; axes left out stand at zero.
        """
        return linear_plant(self, pose or {}).state_space()

    @as_bench_errors()
    def controller(self, axis: str) -> control.TransferFunction:
        """Return C_y of an axis, from position error to effort, sampled.

        Raises
        ------
        UnusableInputError
            There is no such axis, or it has no controller.
        """
        import control  # takes half a second to load, and only this needs it

        found = {each.axis: each for each in self.controllers}
        if axis not in found:
            there = ", ".join(found) or "no axis"
            raise UnusableInputError(f"{axis}: {self.name} has a controller of {there}")
        whole = control.tf([1.0], [1.0], dt=1.0 / self.sample_rate_Hz)
        for section in np.atleast_2d(found[axis].position_sections):
            whole *= control.tf(section[:3], section[3:], dt=1.0 / self.sample_rate_Hz)
        return whole


def linear_plant(machine: Machine, pose: Mapping[str, float]) -> LinearPlant:
    """Return the plant, linear about rest at a pose by axis name [rad or m], without importing python-control."""
    from virtual_bus.physics import Physics  # here because it compiles the plant

    return Physics(machine.plant, noise=False).linear(pose_array(machine, pose))


@as_bench_errors()
def open_machine(machine: str | Path | Machine) -> OpenMachine:
    """Open a machine by its shipped name (`carm`), by the path of a machine file, or one that was loaded before.

    Raises
    ------
    MachineFileError
        One line: file, key, value, what is wrong and what would be right.

    Examples
    --------
    >>> import hil
    >>> carm = hil.open_machine("carm")
    >>> carm.axes, carm.sample_rate_Hz
    (('propeller', 'roll'), 256.0)
    """
    return OpenMachine(**vars(machine if isinstance(machine, Machine) else load_machine(machine)))
