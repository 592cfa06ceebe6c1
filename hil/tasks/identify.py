"""Frequency responses from recordings."""

from __future__ import annotations

from collections.abc import Sequence

from hil.identification import FrequencyResponse, IdentificationError, LocalModel, PoseModel, identify_poses
from hil.identification.from_recordings import PlantInput
from hil.machine import Machine
from hil.simulation import in_effort
from hil.tasks.errors import as_bench_errors
from hil.tasks.recordings import Several, every_one


@as_bench_errors()
def identify(
    recordings: Several,
    method: str = "robust_bla",
    *,
    model: LocalModel | None = None,
    select: bool = False,
    band_Hz: tuple[float, float] | None = None,
    outputs: Sequence[str] | None = None,
    plant_input: PlantInput = "command",
    machine: Machine | None = None,
) -> FrequencyResponse:
    """Identify the frequency response matrix of one pose, with covariances.

    Parameters
    ----------
    recordings : Recording, Recordings or several of them
        All experiments and realisations of one pose.
    method : str
        One of `hil.identification.METHODS`, or of `ARBITRARY_METHODS` with a band.
    model : LocalModel, optional
        Orders and windows of a local method.
    select : bool
        Choose them from the data instead.
    band_Hz : (low, high), optional
        Excited band, for the arbitrary methods.
    outputs : sequence of str, optional
        Channels; motor positions and accelerations unless given.
    plant_input : "command" or "measured"
    machine : Machine, optional
        For recordings that do not carry theirs.

    Returns
    -------
    FrequencyResponse
        `.G` (lines, outputs, inputs) over `.frequencies_Hz`, `.bound()`, and `.control`, a `control.FRD`.

    Raises
    ------
    IdentificationError, RecordingError
        One line on what is wrong with the recordings or the method; recordings are of several poses.
    """
    found = identify_all_poses(
        recordings, method, model=model, select=select, band_Hz=band_Hz, outputs=outputs, plant_input=plant_input, machine=machine
    )
    if len(found) > 1:
        poses = ", ".join(f"({', '.join(f'{value:.4g}' for value in each.pose)})" for each in found)
        raise IdentificationError(f"recordings of {len(found)} poses: {poses}; identify_all_poses returns a response for each")
    return found[0]


@as_bench_errors()
def identify_all_poses(
    recordings: Several,
    method: str = "robust_bla",
    *,
    model: LocalModel | None = None,
    over_poses: PoseModel | None = None,
    select: bool = False,
    band_Hz: tuple[float, float] | None = None,
    outputs: Sequence[str] | None = None,
    plant_input: PlantInput = "command",
    machine: Machine | None = None,
) -> tuple[FrequencyResponse, ...]:
    """Identify a frequency response matrix for every start pose that recordings have, in ascending order.

    Parameters
    ----------
    recordings, method, model, select, band_Hz, outputs, plant_input, machine
        As `identify`; method also `nd_lpm` or `nd_lrm`, in which neighbouring poses help.
    over_poses : PoseModel, optional
        Orders and windows over the poses for these.

    Raises
    ------
    IdentificationError, RecordingError
    """
    every = list(every_one(recordings).values())
    return identify_poses(
        [in_effort(each, machine) for each in every] if plant_input == "command" else every,
        method,
        model=model,
        over_poses=over_poses,
        select=select,
        band_Hz=band_Hz,
        outputs=outputs,
        plant_input=plant_input,
    )
