"""What a machine would have recorded, noise off, from a recording's reference and excitation."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, overload

from hil.verbs.errors import as_bench_errors
from hil.verbs.verb import KEPT, NOBODY, RECORDING, Listener, argument, option

if TYPE_CHECKING:
    from hil.machine import Machine
    from hil.recording import Recording
    from hil.verbs.recordings import Given, Recordings
    from virtual_bus.settings import EffectSetting


@dataclass(frozen=True)
class SimulateRequest:
    """A machine, with effects where it has some, and a recording, or its file."""

    machine: Machine
    recording: Given = argument(RECORDING, "REC")
    out: Path | None = option("Where to write the simulation.", "SIM", "-o", "--out", is_needed=True)


@dataclass(frozen=True)
class SimulateAnswer:
    """The simulation of a recording."""

    simulation: Path | None
    """The file that was written."""
    rows: int
    """Its rows."""
    effects: tuple[EffectSetting, ...]
    """Physics that was added."""
    machine: str = field(metadata=KEPT)
    recorded: Recording = field(metadata=KEPT, repr=False)
    simulated: Recording = field(metadata=KEPT, repr=False)

    @property
    def sentence(self) -> str:
        """The answer in a sentence."""
        added = ", ".join(f"{effect.name} at {effect.at}" for effect in self.effects) or "nothing"
        return f"{self.simulation}: {self.rows} rows of {self.machine}; physics added to its file: {added}"


def answer(request: SimulateRequest, listener: Listener = NOBODY) -> SimulateAnswer:
    """Simulate a recording and write the simulation where that is asked for.

    Raises as `simulate` does, and UnusableInputError where a file cannot be read or written, or is the recording itself.
    """
    from hil.files.writable import can_be_written, not_an_input
    from hil.recording import write_recording
    from hil.recording.formats import check_writable
    from hil.simulation import simulate as simulated_of
    from hil.verbs.recordings import the_one

    machine, out, given = request.machine, request.out, request.recording
    if out is not None:
        check_writable(out)
        can_be_written(out)
        if isinstance(given, str | Path):
            not_an_input(out, Path(given))
    recorded = the_one(given, machine)
    with listener.working(f"simulating {Path(given).name}" if isinstance(given, str | Path) else "simulating"):
        simulated = simulated_of(machine, recorded)
    if out is not None:
        write_recording(simulated, out)
    return SimulateAnswer(out, simulated.rows, machine.added_effects, machine.name, recorded, simulated)


@overload
def simulate(machine: Machine, recording: Recording) -> Recording: ...
@overload
def simulate(machine: Machine, recording: Recordings) -> Recordings: ...
@as_bench_errors()
def simulate(machine: Machine, recording: Recording | Recordings) -> Recording | Recordings:
    """Simulate what a machine would have recorded, noise off, from a recording's reference and excitation.

    Parameters
    ----------
    machine : Machine
        With effects where it has some: `machine.with_effect(...)`.
    recording : Recording or Recordings

    Returns
    -------
    Recording or Recordings
        The same rows.

    Raises
    ------
    RecordingError
        The reference (or command) is missing or has a hole, or the sample rate is not the machine's.
    BadAnswerError
        The simulation diverged.
    """
    from hil.verbs.recordings import Recordings

    if isinstance(recording, Recordings):
        return Recordings({name: simulate(machine, each) for name, each in recording.items()})
    return answer(SimulateRequest(machine, recording)).simulated
