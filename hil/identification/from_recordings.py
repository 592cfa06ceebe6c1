"""Recordings as the estimators' arrays: which channels, which recording is which realisation, and how lost rows are handled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypedDict

import numpy as np

from hil.errors import IdentificationError, RecordingError
from hil.identification.lpm_lrm.arbitrary_lpm_lrm import ArbitraryRecords
from hil.identification.records import PeriodicRecords, periodic_records
from hil.recording import Recording
from hil.recording.ticks import on_every_tick

PlantInput = Literal["command", "measured"]
Details = dict[str, Any]  # a recording's metadata table `experiment`
ACCELERATIONS = ("imu_x", "imu_y", "imu_z")
SATURATED_RUN = 3  # equal commands in a row at the extreme value: a random-phase multisine with feedback never holds its peak


class Channels(TypedDict):
    """Which channels of a recording are the excited axes, the outputs and the plant's input; None takes the defaults."""

    axes: Sequence[str] | None
    outputs: Sequence[str] | None
    plant_input: PlantInput


def records_from(
    recordings: Sequence[Recording],
    *,
    axes: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    plant_input: PlantInput = "command",
    settle_periods: int | None = None,
) -> PeriodicRecords:
    """Arrange recordings of one pose as realisations and experiments.

    Parameters
    ----------
    recordings : all experiments of all realisations, in any order; each states them in its metadata table `experiment`.
    axes : inputs of the response; None takes every axis that is excited.
    outputs : channel names; None takes the accelerations that exist and the axes' positions, the thesis's order (Sec. 3.2.1).
    plant_input : "command" takes `command_A`, what the loop computed; "measured" takes `current_A` or `effort_A`.
    settle_periods : None takes the metadata's.

    Raises
    ------
    IdentificationError, RecordingError
        Recordings that do not belong together, channels that are missing, an incomplete set of experiments.
    """
    if not recordings:
        raise IdentificationError("no recordings given")
    recordings = [on_every_tick(recording) for recording in recordings]
    details = [_details(recording, index) for index, recording in enumerate(recordings)]
    for key in ("period_samples", "start_pose", "excited_lines", "settle_periods"):
        _same(details, key)
    first = details[0]
    machine_axes = recordings[0].axes
    chosen_axes, excitations, channels, inputs = _chosen(recordings, axes, outputs, plant_input)

    order = _arrangement(details)
    rows = min(_row_numbers(recording)[-1] + 1 for recording in recordings)
    notes = (*_by_reference(excitations), *_notes(recordings, machine_axes, chosen_axes, rows, first["period_samples"]))
    stacked = {
        kind: np.stack([[_matrix(recordings[index], names, rows) for index in experiments] for experiments in order])
        for kind, names in (("outputs", channels), ("inputs", inputs), ("excitation", excitations))
    }
    jog = first.get("jog") or {}
    return periodic_records(
        **stacked,
        period_samples=first["period_samples"],
        sample_rate_Hz=_sample_rate_Hz(recordings[0]),
        lines=np.asarray(first["excited_lines"], int) if first.get("excited_lines") else None,
        settle_periods=first.get("settle_periods", 0) if settle_periods is None else settle_periods,
        output_names=channels,
        input_names=inputs,
        output_units=tuple(recordings[0].channel(name).unit for name in channels),
        input_units=tuple(recordings[0].channel(name).unit for name in inputs),
        pose=tuple(float(value) for value in first.get("start_pose") or ()),
        unexcited_reference_lines=(int(jog["line"]),) if "line" in jog else (),
        notes=notes,
    )


def arbitrary_records(
    recordings: Sequence[Recording],
    *,
    axes: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    plant_input: PlantInput = "command",
) -> ArbitraryRecords:
    """Arrange recordings of one pose as records of any excitation, cut to the shortest; parameters and errors as in `records_from`."""
    if not recordings:
        raise IdentificationError("no recordings given")
    recordings = [on_every_tick(recording) for recording in recordings]
    machine_axes = recordings[0].axes
    chosen_axes, excitations, channels, inputs = _chosen(recordings, axes, outputs, plant_input)
    recordings, without = _without_edges(recordings, (*excitations, *channels, *inputs))
    rows = min(_row_numbers(recording)[-1] + 1 for recording in recordings)
    notes = [*_by_reference(excitations), *_idle(machine_axes, chosen_axes), *_saturated(recordings, chosen_axes), *without]
    others = [name for axis in machine_axes if (name := f"reference_{axis}") not in excitations]
    if any(_moves(recording, name) for recording in recordings for name in others):
        notes.append("the reference moves: what it does to the outputs counts as noise")

    def stacked(names: Sequence[str]) -> np.ndarray:
        return np.stack([_matrix(recording, names, rows) for recording in recordings])

    return ArbitraryRecords(
        outputs=stacked(channels),
        inputs=stacked(inputs),
        excitation=stacked(excitations),
        sample_rate_Hz=_sample_rate_Hz(recordings[0]),
        output_names=channels,
        input_names=inputs,
        output_units=tuple(recordings[0].channel(name).unit for name in channels),
        input_units=tuple(recordings[0].channel(name).unit for name in inputs),
        pose=tuple(float(value) for value in recordings[0].experiment.get("start_pose") or ()),
        notes=tuple(notes),
    )


def _without_edges(recordings: Sequence[Recording], names: Sequence[str]) -> tuple[list[Recording], list[str]]:
    """Return recordings without the rows at either end in which a channel is missing, as where signals of several rates met; and a note."""
    kept, cut = [], 0
    for recording in recordings:
        known = np.flatnonzero(np.isfinite(recording.matrix(names)).all(axis=1))
        rows = slice(known[0], known[-1] + 1) if known.size else slice(None)
        kept.append(recording.part(rows))
        cut += recording.rows - kept[-1].rows
    return kept, [f"{cut} rows at the ends of the recordings, in which a channel is missing, are left out"] if cut else []


def by_pose(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Group recordings by their start pose, poses in ascending order."""
    groups: dict[tuple[float, ...], list[Recording]] = {}
    for recording in recordings:
        groups.setdefault(tuple(recording.experiment.get("start_pose") or ()), []).append(recording)
    return [groups[pose] for pose in sorted(groups)]


def _details(recording: Recording, index: int) -> Details:
    details = recording.experiment
    samples = details.get("period_samples")
    if not isinstance(samples, int) or samples < 2:
        raise RecordingError(
            f"recording {index + 1} is not periodic: its metadata lacks experiment.period_samples; `--method arbitrary_lrm --band LOW:HIGH`"
            " takes any excitation, a sweep of the reference too"
        )
    return details


def _same(details: Sequence[Details], key: str) -> None:
    for index, other in enumerate(details):
        if other.get(key) != details[0].get(key):
            what = f"{details[0].get(key)} and {other.get(key)}" if key != "excited_lines" else "two different lists"
            raise IdentificationError(f"recordings 1 and {index + 1} do not belong together: {key} is {what}")


def _arrangement(details: Sequence[Details]) -> list[list[int]]:
    """Return the indices of the recordings as [realisation][experiment]."""
    places: dict[tuple[int, int], int] = {}
    for index, item in enumerate(details):
        place = (int(item.get("realisation", 0)), int(item.get("experiment", 0)))
        if place in places:
            raise IdentificationError(
                f"recordings {places[place] + 1} and {index + 1} are both realisation {place[0]}, experiment {place[1]}; give each once"
            )
        places[place] = index
    realisations, experiments = sorted({m for m, _ in places}), sorted({e for _, e in places})
    for m in realisations:
        for e in experiments:
            if (m, e) not in places:
                raise IdentificationError(f"realisation {m} lacks experiment {e}; every realisation needs the same experiments")
    return [[places[m, e] for e in experiments] for m in realisations]


def _chosen(
    recordings: Sequence[Recording], axes: Sequence[str] | None, outputs: Sequence[str] | None, plant_input: PlantInput
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Return excited axes, the channels that excite them, output channels and plant input channels.

    Where nothing is added to an axis's command, its reference is what excites the loop from outside.
    """
    machine_axes = recordings[0].axes
    excited = tuple(a for a in machine_axes if any(_is_excited(r, a) for r in recordings))
    led = tuple(a for a in machine_axes if a not in excited and any(_moves(r, f"reference_{a}") for r in recordings))
    chosen = tuple(axes) if axes else excited or led
    if not chosen:
        found = ", ".join(name for name in recordings[0].channels if name != "time")
        raise IdentificationError(
            "no axis is excited in any recording: excitation_<axis> and reference_<axis> are constant or missing;"
            f" name the channel that excites with `isocenter convert --map NAME=excitation_<axis>`, of {found}"
        )
    excitations = tuple(f"{'reference' if axis in led else 'excitation'}_{axis}" for axis in chosen)
    channels = tuple(outputs) if outputs else _default_outputs(recordings[0], machine_axes)
    return chosen, excitations, channels, tuple(_input_channel(recordings[0], axis, plant_input) for axis in chosen)


def _is_excited(recording: Recording, axis: str) -> bool:
    name = f"excitation_{axis}"
    return name in recording and bool(np.nanmax(np.abs(recording[name]), initial=0.0) > 0.0)


def _moves(recording: Recording, name: str) -> bool:
    known = recording[name][np.isfinite(recording[name])] if name in recording else np.zeros(0)
    return known.size > 0 and bool(np.ptp(known) > 0.0)


def _by_reference(excitations: Sequence[str]) -> list[str]:
    names = [name for name in excitations if name.startswith("reference_")]
    return [f"nothing is added to the command: {', '.join(names)} taken as what excites the loop"] if names else []


def _default_outputs(recording: Recording, axes: Sequence[str]) -> tuple[str, ...]:
    return (*(name for name in ACCELERATIONS if name in recording), *(f"position_{axis}" for axis in axes))


def _input_channel(recording: Recording, axis: str, plant_input: PlantInput) -> str:
    measured = f"current_{axis}" if f"current_{axis}" in recording else f"effort_{axis}"
    name = f"command_{axis}" if plant_input == "command" else measured
    if name not in recording:
        other = ("measured", measured) if plant_input == "command" else ("command", f"command_{axis}")
        way = f"`--input {other[0]}` takes {other[1]}" if other[1] in recording else f"name it with `isocenter convert --map NAME={name}`"
        raise IdentificationError(f"no channel {name}, by which the plant is driven; {way}")
    return name


def _sample_rate_Hz(recording: Recording) -> float:
    return round(1.0 / float(np.median(np.diff(recording.time))), 6)


def _row_numbers(recording: Recording) -> np.ndarray:
    """Return the row number of each row from its time: lost rows leave gaps."""
    if recording.rows < 2:
        raise RecordingError("a recording of fewer than two rows has no sample rate")
    ticks: np.ndarray = np.rint((recording.time - recording.time[0]) * _sample_rate_Hz(recording)).astype(int)
    return ticks


def _matrix(recording: Recording, names: Sequence[str], rows: int) -> np.ndarray:
    """Return channels (rows, len(names)); lost rows are NaN except in the excitation, which repeats every period."""
    numbers = _row_numbers(recording)
    kept = numbers < rows
    values = np.full((rows, len(names)), np.nan)
    values[numbers[kept]] = recording.matrix(names)[kept]
    samples = recording.experiment.get("period_samples")
    if names[0].startswith(("excitation_", "reference_")) and samples:
        for start in range(samples, rows, samples):
            part = values[start : start + samples]
            missing = np.isnan(part)
            part[missing] = values[:samples][: len(part)][missing]
    return values


def _notes(
    recordings: Sequence[Recording], machine_axes: Sequence[str], chosen_axes: Sequence[str], rows: int, period_samples: int
) -> tuple[str, ...]:
    notes = []
    lengths = {_row_numbers(recording)[-1] + 1 for recording in recordings}
    if len({length // period_samples for length in lengths}) > 1:
        notes.append(f"recordings differ in length; the first {rows // period_samples} periods of each are used")
    return (*notes, *_saturated(recordings, chosen_axes), *_idle(machine_axes, chosen_axes))


def _saturated(recordings: Sequence[Recording], axes: Sequence[str]) -> list[str]:
    counts = {axis: sum(_is_saturated(r[f"command_{axis}"]) for r in recordings if f"command_{axis}" in r) for axis in axes}
    return [
        f"command_{axis} saturates in {count} of {len(recordings)} recordings: the excitation is not what was designed"
        for axis, count in counts.items()
        if count
    ]


def _idle(machine_axes: Sequence[str], chosen_axes: Sequence[str]) -> list[str]:
    idle = [axis for axis in machine_axes if axis not in chosen_axes]
    return [f"{', '.join(idle)} not excited: the response is that of the machine with those loops closed"] if idle else []


def _is_saturated(command: np.ndarray) -> bool:
    for extreme in (np.nanmax(command), np.nanmin(command)):
        at = np.concatenate(([0], (command == extreme).astype(np.int8), [0]))
        edges = np.flatnonzero(np.diff(at))
        if len(edges) and (edges[1::2] - edges[::2]).max() >= SATURATED_RUN:
            return True
    return False
