"""isocenter calibrate data and level: the observer and a few images instead of a phantom scan for every kind of scan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.cli.options import MachineArgument, can_be_written, load, not_an_input
from hil.cli.paged import PageOption, check_page, write_paged
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import follower, progress, working

if TYPE_CHECKING:
    from hil.calibration.data_driven.observed_beam import ObservedBeam
    from hil.calibration.data_driven.quasi_static import QuasiStatic
    from hil.calibration.data_driven.values import Calibration, Measurement, Parameters
    from hil.machine import Machine
    from hil.recording import Recording

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
    from hil.calibration.data_driven.calibrate import calibrate_data
    from hil.calibration.data_driven.data_file import read_data_file, write_data_file
    from hil.calibration.data_driven.quasi_static import QuasiStatic
    from hil.calibration.data_driven.values import Parameters
    from hil.recording import read_recording

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
    model = QuasiStatic.of(machine)
    known = Parameters.unknown(model) if start is None else read_data_file(start).parameters(model)
    observed = _observed(machine, recording, model, known, design, answer)
    measurements: list[Measurement] = []
    if scan_folder is not None:
        measurements += _phantom(machine, scan_folder, observed, jobs, answer)
    if marker is not None:
        measurements += _marker(machine, marker, jobs, answer)
    measurements.sort(key=lambda each: each.time_s)
    before = known if start is None else known.aged(model)
    with working("calibrating"):
        found = calibrate_data(model, observed, measurements, before, late_s=1e-3 * late, until_m=1e-3 * until, most=images)
    _report(answer, found, observed)
    write_data_file(model, observed, found, out)
    answer.say(f"{out}: geometry of {len(observed)} samples, {len(model.names)} parameters")
    if figure is not None:
        _draw(observed, found, figure)
        answer.say(f"{figure}: the nine parameters over time")
    if page is not None:
        from hil.reports.calibrated import data_page

        write_paged(answer, data_page(machine, found, recording, (recording_file, out), answer.said), page)
    answer.write(_document(model, found, len(measurements)))


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


def _observed(
    machine: Machine, recording: Recording, model: QuasiStatic, known: Parameters, design: Path | None, answer: Answer
) -> ObservedBeam:
    from hil.calibration.data_driven.levelled import levelled
    from hil.calibration.data_driven.observed_beam import observed_beam, unobserved_beam

    if design is None:
        if f"estimate_link_position_{machine.axes[0]}" in recording:
            return observed_beam(machine, recording)
        answer.say("no observer (--design): the displacement is taken for small, the geometry is that of slow motion")
        return unobserved_beam(machine, recording)
    from hil.observing import observe, read_design
    from hil.recording import Channel, Recording

    made = read_design(design)
    if made.model.axes != machine.axes or made.model.sample_rate_Hz != machine.sample_rate_Hz:
        raise UnusableInputError(
            f"{design}: is for {', '.join(made.model.axes)} at {made.model.sample_rate_Hz:g} Hz, not for {machine.name}"
        )
    estimate = observe(levelled(machine, recording, model, known.values), made.observer())
    columns = zip(estimate.names, estimate.units, estimate.values.T, strict=True)
    return observed_beam(machine, Recording({**recording.channels, **{name: Channel(unit, v) for name, unit, v in columns}}, {}))


def _phantom(machine: Machine, folder: Path, observed: ObservedBeam, jobs: int, answer: Answer) -> list[Measurement]:
    from hil.calibration.data_driven.image_measurements import from_phantom
    from hil.calibration.phantom.phantom_calibration import calibrate_phantom
    from hil.imaging.nominal import nominal_beam
    from hil.imaging.phantoms import dodecahedron
    from hil.imaging.scan_folder import read_scan

    scan = read_scan(folder)
    positions, _, _ = observed.at(scan.middle_s)
    with progress() as bars:
        follow = follower(bars, bars.add_task("bullets", total=len(scan)))
        fit = calibrate_phantom(scan, dodecahedron(), nominal_beam(machine, positions), True, jobs, lambda done, total: follow(done))
    return from_phantom(machine, scan, fit, observed)


def _marker(machine: Machine, folder: Path, jobs: int, answer: Answer) -> list[Measurement]:
    import numpy as np

    from hil.calibration.data_driven.image_measurements import from_marker
    from hil.calibration.marker.scan import calibrate_marker, nominal_marker
    from hil.imaging.markers import PLATES
    from hil.imaging.nominal import nominal_beam
    from hil.imaging.scan_folder import read_scan

    scan = read_scan(folder)
    name, distance_mm = scan.notes.get("marker"), scan.notes.get("marker_distance_mm")
    if name not in PLATES or not isinstance(distance_mm, (int, float)):
        raise UnusableInputError(f"{folder}/scan.toml names no marker of {', '.join(PLATES)} and marker_distance_mm")
    nominal = nominal_marker(nominal_beam(machine, np.nan_to_num(scan.positions)), 1e-3 * float(distance_mm))
    with progress() as bars:
        follow = follower(bars, bars.add_task("marker", total=len(scan)))
        found = calibrate_marker(scan, PLATES[name](), nominal, jobs=jobs, progress=lambda done, total: follow(done))
    return from_marker(scan, found)


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
