"""isocenter calibrate data and level: the observer and a few images instead of a phantom scan for every kind of scan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli.options import MachineArgument, can_be_written, load, not_an_input
from hil.cli.paged import PageOption, check_page, write_paged
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import progress

if TYPE_CHECKING:
    from rich.progress import TaskID

    from hil.calibration.data_driven.observed_beam import ObservedBeam
    from hil.calibration.data_driven.quasi_static import QuasiStatic
    from hil.calibration.data_driven.values import Calibration

RecordingArgument = Annotated[Path, typer.Argument(metavar="REC", help="Recording: of the scan, or at rest.")]


def register(app: typer.Typer) -> None:
    """Add the commands to `isocenter calibrate`."""
    app.command(
        short_help="Geometry at every sample, from the observer and a few images.",
        help="The geometry of a scan at every sample: quasi-static parameters and the observer's displacement in one filter, images as"
        " measurements until the parameters have converged."
        "\n\nExample:  isocenter calibrate data carm scan.mf4 phantom_scan --design carm.observer.npz -o scan.geometry.npz"
        "\n\nThen, without a phantom:  isocenter calibrate data carm patient.mf4 --start scan.geometry.npz --design carm.observer.npz"
        " -o patient.geometry.npz",
    )(data)
    app.command(
        short_help="Inertial measurements, turned back by the offsets that images told.",
        help="A recording whose inertial measurements are turned back by the offsets that images told: what an observer is designed from on"
        " a machine that is not built as drawn."
        "\n\nExample:  isocenter calibrate level carm still.mf4 --by scan.geometry.npz -o still.level.mf4",
    )(level)


def data(
    machine_name: MachineArgument,
    recording_file: RecordingArgument,
    scan_folder: Annotated[
        Path | None, typer.Argument(metavar="[SCAN]", help="Folder of its phantom images; none: images withdrawn.")
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="Geometry and parameters to write (.npz).")] = Path(
        "geometry.npz"
    ),
    start: Annotated[Path | None, typer.Option("--start", metavar="FILE", help="An earlier calibration to go on from.")] = None,
    design: Annotated[
        Path | None, typer.Option("--design", metavar="FILE", help="Observer to run over the recording; else its own estimates are used.")
    ] = None,
    marker: Annotated[Path | None, typer.Option("--marker", metavar="SCAN", help="Folder of marker images of the same scan.")] = None,
    images: Annotated[int | None, typer.Option("--images", metavar="N", min=0, help="Withdraw phantom images after so many.")] = None,
    until: Annotated[
        float, typer.Option("--until", metavar="MM", min=0.0, help="Withdraw phantom images once the place is known so well; 0: never.")
    ] = 0.0,
    late: Annotated[float, typer.Option("--late", metavar="MS", min=0.0, help="How long after its exposure an image is there.")] = 200.0,
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="The nine parameters over time.")] = None,
    jobs: Annotated[int, typer.Option("--jobs", metavar="N", min=1, help="Processes that look at images.")] = 1,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Observe, look at images, filter, write."""
    from hil.recording import read_recording
    from hil.verbs.calibrate_data import calibrate_data

    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(out, figure)
    check_page(page)
    not_an_input(out, *(path for path in (recording_file, start, design) if path is not None))
    if scan_folder is None and start is None and marker is None:
        raise UnusableInputError(
            "no images and no --start: nothing tells this machine's geometry; give SCAN, or a calibration to go on from"
        )
    recording = read_recording(recording_file, machine)
    with progress() as bars:
        tasks: dict[str, TaskID] = {}

        def follow(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done)

        made = calibrate_data(
            machine,
            recording,
            scan_folder,
            marker=marker,
            start=start,
            design=design,
            most=images,
            until_m=1e-3 * until,
            late_s=1e-3 * late,
            jobs=jobs,
            progress=follow,
        )
    if not made.is_observed:
        answer.say("no observer (--design): the displacement is taken for small, the geometry is that of slow motion")
    _report(answer, made.found, made.observed)
    made.write(out)
    answer.say(f"{out}: geometry of {len(made.observed)} samples, {len(made.model.names)} parameters")
    if figure is not None:
        _draw(made.observed, made.found, figure)
        answer.say(f"{figure}: the nine parameters over time")
    if page is not None:
        from hil.reports.calibrated import data_page

        write_paged(answer, data_page(machine, made.found, recording, (recording_file, out), answer.said), page)
    answer.write(_document(made.model, made.found, made.offered))


def level(
    machine_name: MachineArgument,
    recording_file: RecordingArgument,
    by: Annotated[Path, typer.Option("--by", metavar="FILE", help="A calibration that knows the offsets.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="REC", help="Recording to write (.mf4, .csv).")],
    json_to: JsonOption = None,
) -> None:
    """Read, turn back, write."""
    from hil.calibration.data_driven.data_file import read_data_file
    from hil.calibration.data_driven.levelled import levelled
    from hil.calibration.data_driven.quasi_static import QuasiStatic
    from hil.recording import read_recording, write_recording

    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(out)
    not_an_input(out, recording_file, by)
    recording = read_recording(recording_file, machine)
    model = QuasiStatic.of(machine)
    write_recording(levelled(machine, recording, model, read_data_file(by).parameters(model).values), out)
    answer.say(f"{out}: {recording.rows} rows, inertial measurements turned back by the offsets of {by.name}")
    answer.write({"recording": out, "rows": recording.rows})


def _report(answer: Answer, found: Calibration, observed: ObservedBeam) -> None:
    import numpy as np

    first, last = 1e3 * found.place_sigma_m[0], 1e3 * found.place_sigma_m[-1]
    answer.say(f"{len(found.used)} images taken in, place of the isocentre known to {last:.3f} mm (before them {first:.3f} mm)")
    if found.converged is not None:
        answer.say(f"converged after {found.converged} images, the rest were not needed")
    for k in found.changes:
        answer.say(f"  image {k}: the machine stands elsewhere than it did; the mount is found anew")
    if found.refused:
        answer.say(f"  {len(found.refused)} images contradict all others and were left out: {', '.join(map(str, found.refused[:5]))}")
    sigma = 1e3 * np.median(found.sigma, axis=0)
    shown = [" ".join(f"{value:.3f}" for value in sigma[k : k + 3]) for k in (0, 3, 6)]
    answer.say(
        f"  standard deviations, medians of {len(observed)} samples: source {shown[0]} mm, phantom {shown[1]} mm, rotation {shown[2]} mrad"
    )


def _draw(observed: ObservedBeam, found: Calibration, figure: Path) -> None:
    from hil.figures.geometry import deviations_figure

    picture = deviations_figure(
        observed.time_s, "time [s]", {"live": (found.live, found.covariance), "parameters of the end": (found.final, None)}
    )
    save_figure(picture, figure)


def _document(model: QuasiStatic, found: Calibration, offered: int) -> dict[str, Any]:
    import numpy as np

    deviation = np.sqrt(np.diag(found.parameters.covariance))
    return {
        "images": offered,
        "used": len(found.used),
        "refused": found.refused,
        "changes": found.changes,
        "converged": found.converged,
        "place_sigma_m": found.place_sigma_m,
        "parameters": {
            name: {"value": value, "unit": unit, "sigma": sigma}
            for name, unit, value, sigma in zip(model.names, model.units, found.parameters.values, deviation, strict=True)
        },
        "sigma": np.median(found.sigma, axis=0),
    }
