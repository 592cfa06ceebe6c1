"""The observer designed, and replayed over a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from controllers.observers.modal_observer import FilterKind
from hil.errors import UnusableInputError
from hil.identification import FrequencyResponse, identify_poses
from hil.machine import Machine
from hil.observing import Estimate, ObserverDesign, emulated_design, read_design
from hil.observing import design_observer as design_from_measurements
from hil.observing import observe as replay
from hil.observing.observer_design import DEFAULT_MODES
from hil.observing.over_poses import observed_channels
from hil.recording import Recording
from hil.simulation import in_effort
from hil.tasks.errors import as_bench_errors
from hil.tasks.recordings import Recordings, Several, every_one, the_one


@as_bench_errors()
def design_observer(
    machine: Machine,
    responses: Sequence[FrequencyResponse] = (),
    *,
    multisines: Several = (),
    standing: Several = (),
    sweeps: Several = (),
    tuned_on: Several = (),
    modes: int = DEFAULT_MODES,
) -> ObserverDesign:
    """Design an observer from measurements of a machine; without any, of its emulation.

    Parameters
    ----------
    machine : Machine
    responses : sequence of FrequencyResponse
        One per pose.
    multisines : Recording, Recordings or several of them
        To identify responses from, in place of some or beside them; all poses.
    standing, sweeps, tuned_on : Recording, Recordings or several of them
        At rest, for noise, gravity and biases; sweeps there and back, for what turning axes push; ordinary operation to tune on.
    modes : int

    Raises
    ------
    UnusableInputError
        Standing recordings or sweeps without responses, or sweeps without standing recordings.
    BadAnswerError
        The modal model cannot be fitted.
    """
    still, moved, tuned = ([in_effort(each, machine) for each in every_one(given).values()] for given in (standing, sweeps, tuned_on))
    excited = [in_effort(each, machine) for each in every_one(multisines).values()]
    identified = identify_poses(excited, "robust_bla", outputs=observed_channels(machine)) if excited else ()
    if responses or identified:
        return design_from_measurements(machine, [*responses, *identified], still, tuned, modes, moved)
    if still or moved:
        raise UnusableInputError("standing and sweeps go with responses: without them the emulated machine is measured")
    return emulated_design(machine, tuned, modes)


@as_bench_errors()
def observe(
    machine: Machine,
    recording: Recording | Recordings,
    design: ObserverDesign | str | Path | None = None,
    *,
    filter: FilterKind = "ukf",
    adapted: Sequence[int] = (),
    progress: Callable[[int], None] | None = None,
) -> Estimate:
    """Replay the observer over a recording: where the detector really was.

    Parameters
    ----------
    machine : Machine
    recording : Recording
    design : ObserverDesign or path, optional
        Without one, it is designed on the emulated machine and tuned on the recording itself, which takes a while.
    filter : "kf", "ekf" or "ukf"
    adapted : sequence of int
        Modes, from 0, whose frequency is a state.
    progress : callable, optional
        Told from time to time how many rows are done.

    Returns
    -------
    Estimate
        `estimate["estimate_detector_x"]` (rows,) [m] and so on; `.frame()` for pandas.

    Raises
    ------
    UnusableInputError
        The design is of other axes or another sample rate.
    RecordingError
        Another sample rate, none of the channels, or a hole in the commands.
    """
    one = in_effort(the_one(recording), machine)
    if design is None:
        design = emulated_design(machine, [one])
    elif not isinstance(design, ObserverDesign):
        design = read_design(design)
    if design.model.axes != machine.axes or design.model.sample_rate_Hz != machine.sample_rate_Hz:
        raise UnusableInputError(
            f"the observer design is for {', '.join(design.model.axes)} at {design.model.sample_rate_Hz:g} Hz;"
            f" {machine.name} has {', '.join(machine.axes)} at {machine.sample_rate_Hz:g} Hz"
        )
    return replay(one, design.observer(filter, adapted), machine_hash=design.machine_hash, notes=design.notes, progress=progress)
