"""The observer: designed from measurements, replayed over a recording, and whether its estimates are to be trusted."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from hil.errors import RequestError, UnusableInputError
from hil.verbs.errors import as_bench_errors
from hil.verbs.verb import KEPT, NOBODY, RECORDING, Listener, argument, option

if TYPE_CHECKING:
    from controllers.observers.modal_observer import FilterKind, ModalObserver
    from hil.calibration.data_driven.live import LiveCalibration
    from hil.identification import FrequencyResponse
    from hil.machine import Machine
    from hil.observing import Alarm, Estimate, Observability, ObserverDesign
    from hil.observing.live import LiveObserver
    from hil.recording import Recording
    from hil.verbs.recordings import Given, Several
    from virtual_bus.linear.left_out import LeftOut

DEFAULT_MODES = 4
"""Modes of an observer's model, unless another number is asked for."""

NIS_BAND = (0.5, 2.0)
"""Mean squared innovation per measurement, in units of what the observer expects; 1 fits. Beyond it noise or model are off by 1.4."""


@dataclass(frozen=True)
class Replay:
    """A recording, or its file, and the observer that goes over it."""

    machine: Machine
    recording: Given = argument(RECORDING, "REC")
    out: Path | None = option("Estimates (.npz), or the recording with them (.mf4, .csv).", "EST", "-o", "--out", is_needed=True)
    design: ObserverDesign | str | Path | None = option("Observer design to use.", "FILE", "--design")
    """None: it is made from what was measured, and tuned on the recording itself where that says nothing of tuning."""


@dataclass(frozen=True)
class Measured:
    """What an observer is designed from: recordings and responses, or their files."""

    responses: Sequence[FrequencyResponse | str | Path] = option(
        "Frequency response to design from; once per pose.", "FRF", "--frf", default=(), is_several=True
    )
    multisines: Sequence[Given] = option(
        "Recording of a multisine to identify for the design; all poses.", "REC", "--multisine", default=(), is_several=True
    )
    standing: Sequence[Given] = option(
        "Recording at rest, for noise, gravity and biases; repeatable.", "REC", "--standing", default=(), is_several=True
    )
    sweeps: Sequence[Given] = option(
        "Recording of a sweep there and back, for what turning axes push; repeatable.", "REC", "--sweep", default=(), is_several=True
    )
    tuned_on: Sequence[Given] = option(
        "Recording of ordinary operation to tune on; repeatable.", "REC", "--tune", default=(), is_several=True
    )
    save_design: Path | None = option("Write the design as well.", "FILE", "--save-design")
    modes: int = option("Modes of the model.", None, "--modes", default=DEFAULT_MODES, least=1)

    @property
    def every(self) -> list[object]:
        """All that was given."""
        return [*self.responses, *self.multisines, *self.standing, *self.sweeps, *self.tuned_on]


@dataclass(frozen=True)
class ObserveRequest(Measured, Replay):
    """An observer over a recording; what is replayed stands before what was measured."""

    filter: str = option("kf, ekf or ukf.", None, "--filter", default="ukf")
    adapted: tuple[int, ...] = option("Modes (from 1) whose frequency is a state.", "N,N,...", "--adapt", default=(), form="modes")
    """Modes, from 0."""
    data: Path | None = option("Replay the live calibration too: what it went on from (run --data).", "FILE", "--data")
    images: Path | None = option("With --data: the folder of that run's images.", "DIR", "--images")

    @property
    def inputs(self) -> list[Path]:
        """Files that are read."""
        return [Path(one) for one in (self.recording, *self.every, self.design, self.data) if isinstance(one, str | Path)]


@dataclass(frozen=True)
class Replayed:
    """An observer that has gone over a recording."""

    recording: Recording
    design: ObserverDesign
    observer: ModalObserver
    estimate: Estimate


@dataclass(frozen=True)
class ObserveAnswer:
    """Estimates, and whether they are to be trusted."""

    estimate: Path | None
    """The file that was written."""
    rows: int
    """Its rows."""
    filter: str
    """`kf`, `ekf` or `ukf`."""
    mean_nis: float
    """Consistency: mean normalised innovation squared per measurement; 1 fits."""
    share_in_band: float
    """Share of rows in the 95 % band."""
    alarm_share: float
    """Share of rows with an alarm."""
    rms: Mapping[str, float]
    """Estimate to its root mean square."""
    states: tuple[str, ...]
    """Names of the states."""
    not_observed: tuple[tuple[str, ...], ...]
    """Combinations of states that the sensors do not show."""
    notes: tuple[str, ...]
    """What a user should know."""
    live: str
    """How the replay compares with what ran along: `the same`, or the first difference; empty where nothing ran along."""
    alarms: tuple[Alarm, ...]
    """Each alarm."""
    emulated: bool
    """Whether the recording was made on the emulator."""
    outside: list[str]
    """Warnings of axes that leave the poses at which the design was measured."""
    left_out: tuple[LeftOut, ...]
    """Effects of the machine file that the linear model of this answer does not hold."""
    replayed: Replayed = field(metadata=KEPT, repr=False)
    seen: Observability = field(metadata=KEPT, repr=False)

    @property
    def sentence(self) -> str:
        """The answer in a sentence."""
        if not self.rows or not math.isfinite(self.share_in_band):
            return "Nothing was measured that the observer looks at: its estimates are predictions alone."
        if self.alarms:
            longest = max(self.alarms, key=lambda alarm: alarm.rows)
            times = f"{len(self.alarms)} times" if len(self.alarms) > 1 else f"once, from {longest.from_s:.2f} to {longest.to_s:.2f} s"
            share = 100.0 * self.alarm_share
            return (
                f"The sensors contradict the observer's model in {share:.1f} % of rows, where its estimates may be worse than stated:"
                f" the alarm is raised {times}, most by {longest.channel}."
            )
        return f"The estimates agree with the sensors: no alarm in {self.rows} rows, NIS {self.mean_nis:.2f} (1 fits)."

    @property
    def lines(self) -> list[str]:
        """The rest in words."""
        from hil.observing.alarms import alarm_lines
        from virtual_bus.linear.left_out import sentences

        lines = [*self.outside, *alarm_lines(self.alarms, self.replayed.recording)]
        if not self.replayed.design.poses.size:
            lines.append("the design does not say at which poses it was measured, so whether this recording leaves them is not known")
        lines.append(f"{self.estimate}: {self.filter} over {self.rows} rows, {len(self.states)} states")
        lines += [*self.notes, *self.seen.lines, *(f"the observer's model is without {said}" for said in sentences(self.left_out))]
        lines.append(
            f"NIS {self.mean_nis:.2f} per measurement (1 fits), {100.0 * self.share_in_band:.1f} % of rows in the 95 % band,"
            f" alarm in {100.0 * self.alarm_share:.1f} % of rows"
        )
        return [*lines, *([f"live estimates in the recording: {self.live}"] if self.live else [])]


def answer(request: ObserveRequest, listener: Listener = NOBODY) -> ObserveAnswer:
    """Design or read an observer, replay it, write what is asked for, and judge the estimates.

    Raises
    ------
    RequestError
        Parts of the request do not go together.
    UnusableInputError, RecordingError
        A file cannot be read or written, is of another machine, or lacks what is needed.
    BadAnswerError
        The modal model cannot be fitted.
    """
    from controllers.observers.consistency import share_in_band
    from hil.observing import alarms, observability, write_estimate
    from hil.observing.alarms import outside_lines
    from virtual_bus.linear.left_out import left_out

    replayed = replay(request, listener)
    recording, design, observer, estimate = replayed.recording, replayed.design, replayed.observer, replayed.estimate
    if request.out is not None:
        write_estimate(estimate, request.out, recording)
    seen = observability(observer, [recording.matrix([f"position_{axis}" for axis in request.machine.axes])[0]])
    measured = estimate["estimate_measured"]
    return ObserveAnswer(
        request.out,
        len(estimate.time_s),
        estimate.filter,
        estimate.mean_nis,
        share_in_band(estimate["estimate_nis"], measured) if (measured > 0).any() else math.nan,
        estimate.alarm_share,
        estimate.rms,
        estimate.state_names,
        seen.blind,
        estimate.notes,
        _against_live(estimate, recording),
        alarms(estimate, recording, observer.noise.measurement, design.poses),
        recording.emulated,
        outside_lines(recording, design.poses),
        left_out(request.machine.plant.effects),
        replayed,
        seen,
    )


def replay(request: ObserveRequest, listener: Listener = NOBODY) -> Replayed:
    """Design or read an observer and replay it, without a judgement; raises as `answer` does."""
    from hil.observing import observe as replay_observer
    from hil.observing import write_design
    from hil.simulation import in_effort
    from hil.verbs.recordings import the_one

    _check(request)
    machine = request.machine
    recording = in_effort(the_one(request.recording, machine), machine)
    design = _design(request, recording, listener)
    if request.save_design is not None:
        write_design(design, request.save_design)
        listener.say(f"{request.save_design}: design")
    modes = design.model.modes
    if any(not 0 <= mode < modes for mode in request.adapted) or len(set(request.adapted)) < len(request.adapted):
        asked = ",".join(str(mode + 1) for mode in request.adapted)
        raise RequestError("{adapted} {}: the model has modes 1 to {}, each named once", asked, modes)
    observer = design.observer(cast("FilterKind", request.filter), request.adapted)
    calibration = _calibration(machine, observer, request.data, request.images)
    name = request.recording.name if isinstance(request.recording, Path) else "replaying"
    with listener.working(name, recording.rows) as work:
        estimate = replay_observer(
            recording, observer, machine_hash=design.machine_hash, notes=design.notes, calibration=calibration, progress=work.done
        )
        work.done(recording.rows)
    return Replayed(recording, design, observer, estimate)


def designed(machine: Machine, measured: Measured, listener: Listener = NOBODY) -> ObserverDesign:
    """Return the observer that measurements give, or without responses the machine file; raises as `design_observer` does."""
    from hil.identification import identify_poses, read_frf
    from hil.observing import design_observer, emulated_design
    from hil.observing.over_poses import observed_channels
    from hil.verbs.recordings import efforts

    tuned = efforts(measured.tuned_on, machine)
    excited = efforts(measured.multisines, machine)
    if not measured.responses and not excited:
        if measured.standing or measured.sweeps:
            raise RequestError("{standing} and {sweeps} go with {responses} or {multisines}: without them the model is the file's")
        listener.say(f"no --design, --frf or --multisine: the model has the numbers of {machine.name}'s file, not of the recorded machine")
        with listener.working(f"holding the design to the truth of the emulated {machine.name}") as work:
            return emulated_design(machine, tuned, modes=measured.modes, told=work.done)
    responses = [read_frf(each) if isinstance(each, str | Path) else each for each in measured.responses]
    with listener.working("designing the observer"):
        if excited:
            responses += identify_poses(excited, "robust_bla", outputs=observed_channels(machine))
        still, sweeps = efforts(measured.standing, machine), efforts(measured.sweeps, machine)
        return design_observer(machine, responses, still, tuned, sweeps, modes=measured.modes)


def read_fitting(design: ObserverDesign | str | Path, machine: Machine, listener: Listener = NOBODY) -> ObserverDesign:
    """Return a design, read where its file is given, which must be of the machine's axes and sample rate."""
    from hil.observing import ObserverDesign, read_design

    made = design if isinstance(design, ObserverDesign) else read_design(design)
    if made.model.axes != machine.axes or made.model.sample_rate_Hz != machine.sample_rate_Hz:
        raise UnusableInputError(
            f"{'' if made is design else f'{design}: '}the observer design is for"
            f" {', '.join(made.model.axes)} at {made.model.sample_rate_Hz:g} Hz;"
            f" {machine.name} has {', '.join(machine.axes)} at {machine.sample_rate_Hz:g} Hz"
        )
    if made.machine_hash != machine.hash:
        listener.say(f"the design was made for another version of {made.machine}; its model and noise are used as they are")
    return made


def live_observer(
    design: ObserverDesign | str | Path | None,
    machine: Machine,
    damping: float = 0.0,
    calibration: Callable[[ModalObserver], LiveCalibration] | None = None,
    listener: Listener = NOBODY,
) -> LiveObserver | None:
    """Return the observer that runs along, ready for the loop, with the damping from it and its calibration; None without a design."""
    if design is None:
        if damping:
            raise RequestError("{damping}: comes from an observer's estimate; give {observer} FILE as well")
        return None
    from controllers.damping import DampingSettings, ModalDamping
    from hil.observing.board import remove_abandoned
    from hil.observing.damping import accept_damping, examine_damping
    from hil.observing.live import LiveObserver

    made = read_fitting(design, machine, listener)
    if left := remove_abandoned():
        listener.say(f"removed {left} {'page' if left == 1 else 'pages'} of shared memory that killed runs had left")
    observer = made.observer()
    law = ModalDamping(observer, DampingSettings(damping)) if damping else None
    units = [units.effort for units in machine.units] if law is not None else []
    beside = None if calibration is None else calibration(observer)
    file = "" if made is design else str(design)
    live = LiveObserver(observer, file, law, units, imu=machine.line_imu, bus_imu=machine.bus_imu, calibration=beside)
    if law is not None:
        listener.say(accept_damping(machine, examine_damping(machine, law, observer)))
    return live


@as_bench_errors()
def design_observer(
    machine: Machine | str | Path,
    responses: Sequence[FrequencyResponse] = (),
    *,
    multisines: Sequence[Given] = (),
    standing: Several = (),
    sweeps: Several = (),
    tuned_on: Several = (),
    modes: int = DEFAULT_MODES,
) -> ObserverDesign:
    """Design an observer from measurements of a machine; without any, from its file.

    Parameters
    ----------
    machine : Machine, its file, or the name of a shipped one
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
    from hil.machine import load_machine
    from hil.verbs.recordings import each_of

    excited, still, moved, tuned = (each_of(given) for given in (multisines, standing, sweeps, tuned_on))
    machine = load_machine(machine) if isinstance(machine, str | Path) else machine
    return designed(machine, Measured(list(responses), excited, still, moved, tuned, modes=modes))


@as_bench_errors()
def observe(
    machine: Machine,
    recording: Given,
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
    recording : Recording, or its file
    design : ObserverDesign or path, optional
        Without one, it is designed from the machine file and tuned on the recording itself, which takes a while.
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
    request = ObserveRequest(machine, recording, design=design, filter=filter, adapted=tuple(adapted))
    return replay(request, Listener(progress)).estimate


def _check(request: ObserveRequest) -> None:
    from controllers.observers.modal_observer import KINDS
    from hil.files.writable import can_be_written, not_an_input

    if request.filter not in KINDS:
        raise RequestError("{filter} {}: must be {}", request.filter, ", ".join(KINDS))
    if request.design is not None and request.every:
        raise RequestError("{design}: a design is ready; {responses}, {multisines}, {standing}, {sweeps} and {tuned_on} make a new one")
    if (request.data is None) != (request.images is None):
        raise RequestError("{data} and {images}: a live calibration is replayed from both")
    can_be_written(request.out, suffixes=(".npz", ".mf4", ".csv"))
    can_be_written(request.save_design)
    for written in (request.out, request.save_design):
        if written is not None:
            not_an_input(written, *request.inputs)


def _design(request: ObserveRequest, recording: Recording, listener: Listener) -> ObserverDesign:
    """Return the design that was given, or the one that is made, tuned on the recording unless there is another to tune on."""
    if request.design is not None:
        return read_fitting(request.design, request.machine, listener)
    if not request.tuned_on:
        listener.say("tuned on the recording itself; --tune gives another")
        request = replace(request, tuned_on=[recording])
    return designed(request.machine, request, listener)


def _calibration(machine: Machine, observer: ModalObserver, data: Path | None, images: Path | None) -> LiveCalibration | None:
    """Return the calibration that ran along, with its images as they came then."""
    if data is None or images is None:
        return None
    from hil.calibration.data_driven.data_file import read_data_file
    from hil.calibration.data_driven.live import LiveCalibration
    from hil.calibration.data_driven.live_file import SIGHTINGS, KeptSightings

    sightings = KeptSightings(images / SIGHTINGS)
    return LiveCalibration(machine, read_data_file(data), observer, sightings, sightings.until_m, sightings.poses)


def _against_live(estimate: Estimate, recording: Recording) -> str:
    """Compare the replay with the live run: `the same`, bit for bit, or the first difference; "" where nothing ran along."""
    import numpy as np

    if not all(name in recording for name in estimate.names):
        return ""
    differ = ~np.isclose(recording.matrix(estimate.names), estimate.values, rtol=0.0, atol=0.0, equal_nan=True)
    if not differ.any():
        return "the same"
    row = int(np.flatnonzero(differ.any(axis=1))[0])
    if "deviation_images" in recording and "deviation_images" not in estimate.names:
        return f"others from row {row} on: a calibration ran along, which levels what the observer reads; give --data and --images as well"
    first = estimate.names[int(np.flatnonzero(differ[row])[0])]
    return f"others from row {row} on ({first}): another design, filter, --adapt or version of this program ran along"
