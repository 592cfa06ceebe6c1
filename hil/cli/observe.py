"""isocenter observe: the observer of Chapter 5, replayed over a recording."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from hil.cli.emulated import say_emulated
from hil.cli.options import MachineArgument, can_be_written, load, not_an_input
from hil.cli.paged import PageOption, check_page, write_paged
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import progress, working

if TYPE_CHECKING:
    from controllers.observers.modal_observer import FilterKind, ModalObserver
    from hil.calibration.data_driven.live import LiveCalibration
    from hil.machine import Machine
    from hil.observing import Alarm, Estimate, ObserverDesign
    from hil.observing.live import LiveObserver
    from hil.observing.observability import Observability
    from hil.recording import Recording

ObserverOption = Annotated[
    Path | None,
    typer.Option("--observer", metavar="FILE", help="Observer design to run along: estimates join the recording (isocenter observe)."),
]
DampingOption = Annotated[
    float,
    typer.Option(
        "--damping", metavar="RATIO", help="With --observer: damping ratio that feedback from its estimate gives the lowest mode."
    ),
]


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="The observer replayed over a recording.",
        help="Where the detector really was: the observer replayed over a recording, the same numbers as live."
        "\n\nExample:  isocenter observe carm run.mf4 -o run.est.npz --design carm.observer.npz"
        "\n\nA design is made from measurements: isocenter observe carm run.mf4 -o run.est.npz --multisine a.mf4 --multisine b.mf4"
        " --standing still.mf4 --tune scan.mf4 --save-design carm.observer.npz",
    )(observe)


def live_observer(
    path: Path | None,
    damping: float,
    machine: Machine,
    answer: Answer,
    calibration: Callable[[ModalObserver], LiveCalibration] | None = None,
) -> LiveObserver | None:
    """Return the observer of a design file, ready for the loop, with its calibration; None without a file."""
    if path is None:
        if damping:
            raise typer.BadParameter("--damping: comes from an observer's estimate; give --observer FILE as well")
        return None
    from hil.observing import read_design
    from hil.observing.board import remove_abandoned
    from hil.observing.live import LiveObserver

    design = read_design(path)
    _check_machine(design, path, machine, answer)
    if left := remove_abandoned():
        answer.say(f"removed {left} {'page' if left == 1 else 'pages'} of shared memory that killed runs had left")
    observer, law = design.observer(), None
    if damping:
        from controllers.damping import DampingSettings, ModalDamping
        from hil.observing.damping import accept_damping, examine_damping

        law = ModalDamping(observer, DampingSettings(damping))
    units = [units.effort for units in machine.units] if law is not None else []
    beside = None if calibration is None else calibration(observer)
    live = LiveObserver(observer, str(path), law, units, imu=machine.line_imu, bus_imu=machine.bus_imu, calibration=beside)
    if law is not None:
        answer.say(accept_damping(machine, examine_damping(machine, law, observer)))
    return live


def _check_machine(design: ObserverDesign, path: Path, machine: Machine, answer: Answer) -> None:
    """Refuse a design of other axes or another sample rate; tell where the machine file differs from the design's."""
    if design.model.axes != machine.axes or design.model.sample_rate_Hz != machine.sample_rate_Hz:
        raise UnusableInputError(
            f"{path}: the observer design is for {', '.join(design.model.axes)} at {design.model.sample_rate_Hz:g} Hz;"
            f" {machine.name} has {', '.join(machine.axes)} at {machine.sample_rate_Hz:g} Hz"
        )
    if design.machine_hash != machine.hash:
        answer.say(f"the design was made for another version of {design.machine}; its model and noise are used as they are")


def observe(
    machine_name: MachineArgument,
    recording_path: Annotated[Path, typer.Argument(metavar="REC", help="Recording (.mf4, .csv, .parquet, .mcap, .mat).")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="EST", help="Estimates (.npz), or the recording with them (.mf4, .csv).")],
    design_path: Annotated[Path | None, typer.Option("--design", metavar="FILE", help="Observer design to use.")] = None,
    frf: Annotated[
        list[Path] | None, typer.Option("--frf", metavar="FRF", help="Frequency response to design from; once per pose.")
    ] = None,
    multisine: Annotated[
        list[Path] | None,
        typer.Option("--multisine", metavar="REC", help="Recording of a multisine to identify for the design; all poses."),
    ] = None,
    standing: Annotated[
        list[Path] | None, typer.Option("--standing", metavar="REC", help="Recording at rest, for noise, gravity and biases; repeatable.")
    ] = None,
    sweep: Annotated[
        list[Path] | None,
        typer.Option("--sweep", metavar="REC", help="Recording of a sweep there and back, for what turning axes push; repeatable."),
    ] = None,
    tune: Annotated[
        list[Path] | None, typer.Option("--tune", metavar="REC", help="Recording of ordinary operation to tune on; repeatable.")
    ] = None,
    save_design: Annotated[Path | None, typer.Option("--save-design", metavar="FILE", help="Write the design as well.")] = None,
    modes: Annotated[int, typer.Option("--modes", min=1, help="Modes of the model.")] = 4,
    filter_name: Annotated[str, typer.Option("--filter", help="kf, ekf or ukf.")] = "ukf",
    adapt: Annotated[str, typer.Option("--adapt", metavar="N,N,...", help="Modes (from 1) whose frequency is a state.")] = "",
    data: Annotated[
        Path | None, typer.Option("--data", metavar="FILE", help="Replay the live calibration too: what it went on from (run --data).")
    ] = None,
    images: Annotated[Path | None, typer.Option("--images", metavar="DIR", help="With --data: the folder of that run's images.")] = None,
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="Draw it as well.")] = None,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Design or read, replay, write."""
    from controllers.observers.modal_observer import KINDS
    from hil.observing import alarms, observability, read_design, write_design, write_estimate
    from hil.observing import observe as replay
    from hil.observing.alarms import alarm_lines, outside_lines
    from hil.recording import read_recording
    from hil.simulation import in_effort
    from virtual_bus.linear.left_out import left_out, sentences

    if filter_name not in KINDS:
        raise typer.BadParameter(f"--filter {filter_name}: must be {', '.join(KINDS)}")
    if design_path is not None and (frf or multisine or standing or sweep or tune):
        raise typer.BadParameter("--design: a design is ready; --frf, --multisine, --standing, --sweep and --tune make a new one")
    if (data is None) != (images is None):
        raise typer.BadParameter("--data and --images: a live calibration is replayed from both")
    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(out, suffixes=(".npz", ".mf4", ".csv"))
    can_be_written(figure, save_design)
    check_page(page)
    inputs = [recording_path, *(frf or []), *(multisine or []), *(standing or []), *(sweep or []), *(tune or [])]
    inputs += [path for path in (design_path, data) if path is not None]
    for written in (out, save_design, figure):
        if written is not None:
            not_an_input(written, *inputs)
    recording = in_effort(read_recording(recording_path, machine), machine)
    if design_path is not None:
        design = read_design(design_path)
    else:
        design = _designed(machine, recording, (frf or [], multisine or []), (standing or [], sweep or []), tune or [], modes, answer)
    if save_design is not None:
        write_design(design, save_design)
        answer.say(f"{save_design}: design")
    observer = design.observer(cast("FilterKind", filter_name), _modes(adapt, design.model.modes))
    if design_path is not None:
        _check_machine(design, design_path, machine, answer)
    calibration = _calibration(machine, observer, data, images)
    with progress() as bars:
        task = bars.add_task(recording_path.name, total=recording.rows)
        estimate = replay(
            recording,
            observer,
            machine_hash=design.machine_hash,
            notes=design.notes,
            calibration=calibration,
            progress=lambda row: bars.update(task, completed=row),
        )
        bars.update(task, completed=recording.rows)
    write_estimate(estimate, out, recording)
    if figure is not None:
        from hil.figures.observer import observer_figure

        save_figure(observer_figure(estimate), figure)
        answer.say(f"{figure}: figure")
    seen = observability(observer, [recording.matrix([f"position_{axis}" for axis in machine.axes])[0]])
    found = alarms(estimate, recording, observer.noise.measurement, design.poses)
    document = _document(estimate, seen) | {"live": _against_live(estimate, recording), "alarms": found}
    answer.say(_sentence(document, found))
    document["emulated"] = say_emulated(answer, {recording_path: recording})
    document["outside"] = outside_lines(recording, design.poses)
    for line in (*document["outside"], *alarm_lines(found, recording)):
        answer.say(line)
    if not design.poses.size:
        answer.say("the design does not say at which poses it was measured, so whether this recording leaves them is not known")
    answer.say(f"{out}: {filter_name} over {recording.rows} rows, {len(estimate.state_names)} states")
    for note in (*estimate.notes, *seen.lines):
        answer.say(note)
    outside = left_out(machine.plant.effects)
    for said in sentences(outside):
        answer.say(f"the observer's model is without {said}")
    answer.say(
        f"NIS {document['mean_nis']:.2f} per measurement (1 fits), {100.0 * document['share_in_band']:.1f} % of rows in the 95 % band,"
        f" alarm in {100.0 * document['alarm_share']:.1f} % of rows"
    )
    if document["live"]:
        answer.say(f"live estimates in the recording: {document['live']}")
    if page is not None:
        from hil.reports.observed import observed_page

        write_paged(
            answer, observed_page(machine, estimate, recording, (recording_path, out), design_path or save_design, answer.said), page
        )
    answer.write({"estimate": out, **document, "left_out": [vars(each) for each in outside]})


def _sentence(document: dict[str, Any], found: Sequence[Alarm]) -> str:
    """Return the answer in a sentence."""
    if not document["rows"] or not math.isfinite(document["share_in_band"]):
        return "Nothing was measured that the observer looks at: its estimates are predictions alone."
    if found:
        longest = max(found, key=lambda alarm: alarm.rows)
        times = f"{len(found)} times" if len(found) > 1 else f"once, from {longest.from_s:.2f} to {longest.to_s:.2f} s"
        share = 100.0 * document["alarm_share"]
        return f"The estimates are not to be trusted in {share:.1f} % of rows: the alarm is raised {times}, most by {longest.channel}."
    return f"The estimates agree with the sensors: no alarm in {document['rows']} rows, NIS {document['mean_nis']:.2f} (1 fits)."


def _calibration(machine: Machine, observer: ModalObserver, data: Path | None, images: Path | None) -> LiveCalibration | None:
    """Return the calibration that ran along, with its images as they came then."""
    if data is None or images is None:
        return None
    from hil.calibration.data_driven.data_file import read_data_file
    from hil.calibration.data_driven.live import LiveCalibration
    from hil.calibration.data_driven.live_file import SIGHTINGS, KeptSightings

    kept = KeptSightings(images / SIGHTINGS)
    return LiveCalibration(machine, read_data_file(data), observer, kept, kept.until_m, kept.poses)


def _designed(
    machine: Machine,
    recording: Recording,
    measured: tuple[list[Path], list[Path]],
    moved: tuple[list[Path], list[Path]],
    tune: list[Path],
    modes: int,
    answer: Answer,
) -> ObserverDesign:
    from hil.identification import identify_poses, read_frf
    from hil.observing import design_observer
    from hil.observing.over_poses import observed_channels
    from hil.recording import read_recording
    from hil.simulation import in_effort

    (frf, multisine), (standing, sweep) = measured, moved
    tuned_on = [in_effort(read_recording(path, machine), machine) for path in tune] or [recording]
    if not tune:
        answer.say("tuned on the recording itself; --tune gives another")
    if not frf and not multisine:
        if standing or sweep:
            raise typer.BadParameter("--standing and --sweep go with --frf or --multisine: without them the emulated machine is measured")
        answer.say(
            f"no --design, --frf or --multisine: the model is identified on the emulated {machine.name}, not on the recorded machine"
        )
        return _measured_on_the_emulator(machine, tuned_on, modes)
    responses = [read_frf(path) for path in frf]
    with working("designing the observer"):
        if multisine:
            recordings = [in_effort(read_recording(path, machine), machine) for path in multisine]
            responses += identify_poses(recordings, "robust_bla", outputs=observed_channels(machine))
        still, sweeps = ([in_effort(read_recording(path, machine), machine) for path in paths] for paths in (standing, sweep))
        return design_observer(machine, responses, still, tuned_on, modes, sweeps)


def _measured_on_the_emulator(machine: Machine, tuned_on: Sequence[Recording], modes: int) -> ObserverDesign:
    """Design from measurements of the emulated machine, of which there are many: the bar counts them, then says that it fits."""
    from hil.observing import emulated_design

    with progress(stays=False) as bars:
        task = bars.add_task(f"measuring the emulated {machine.name}", total=None)

        def told(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total)
            if done == total:
                bars.add_task("fitting the model, then tuning", total=None)

        return emulated_design(machine, tuned_on, modes, told=told)


def _modes(text: str, modes: int) -> tuple[int, ...]:
    try:
        chosen = tuple(int(part) - 1 for part in text.split(",") if part.strip())
    except ValueError:
        raise typer.BadParameter(f"--adapt {text}: must be mode numbers, such as 1,2") from None
    if any(not 0 <= mode < modes for mode in chosen) or len(set(chosen)) < len(chosen):
        raise typer.BadParameter(f"--adapt {text}: the model has modes 1 to {modes}, each named once")
    return chosen


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


def _document(estimate: Estimate, seen: Observability) -> dict[str, Any]:
    import numpy as np

    from controllers.observers.consistency import share_in_band

    nis, measured = estimate["estimate_nis"], estimate["estimate_measured"]
    values = estimate.names.index("estimate_nis") // 2
    return {
        "rows": len(estimate.time_s),
        "filter": estimate.filter,
        "mean_nis": float(nis.sum() / max(measured.sum(), 1.0)),
        "share_in_band": share_in_band(nis, measured) if (measured > 0).any() else float("nan"),
        "alarm_share": float(np.mean(estimate["estimate_alarm"])),
        "rms": {name: float(np.sqrt(np.mean(estimate[name] ** 2))) for name in estimate.names[:values]},
        "states": estimate.state_names,
        "not_observed": seen.blind,
        "notes": estimate.notes,
    }
