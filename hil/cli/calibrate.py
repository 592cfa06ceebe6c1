"""isocenter calibrate phantom and marker, and expose: geometric calibration from images."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from hil.cli.asking import ask
from hil.cli.options import MachineArgument, ScanArgument, can_be_written, load
from hil.cli.paged import PageOption, check_drawn, check_page, write_paged
from hil.cli.shared import asks
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import follower, progress
from hil.verbs import calibrate as verb

if TYPE_CHECKING:
    from hil.calibration.marker.scan import MarkerScan
    from hil.imaging.markers import MarkerPlate

app = typer.Typer(
    no_args_is_help=True,
    short_help="Geometric calibration.",
    help="Geometric calibration from recordings and images.\n\nExample:  isocenter calibrate phantom carm phantom_scan -o roll.lookup.npz",
)

FigureOption = Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="The nine parameters over the scan.")]
JobsOption = Annotated[int, typer.Option("--jobs", metavar="N", min=1, help="Processes that look at images.")]


def register(parent: typer.Typer) -> None:
    """Add the commands."""
    parent.command(
        short_help="Images of a scan on the emulated machine.",
        help="Images of a scan as the emulated machine's panel takes them, from the truth its emulator wrote."
        "\n\nExample:  isocenter expose carm scan.mf4 --truth truth.csv --scene dodecahedron -o phantom_scan"
        "\n\nThe recording and its truth file come from one run: isocenter run scan ... -o scan.mf4 --truth truth.csv",
    )(expose)
    app.command(
        short_help="The geometry of every exposure, from images of the bullet phantom.",
        help="The geometry of every exposure, from images of the bullet phantom, as a look-up table over axis positions."
        "\n\nExample:  isocenter calibrate phantom carm phantom_scan -o roll.lookup.npz --figure roll.png",
    )(phantom)
    app.command(
        short_help="Tube against panel in every exposure, from a marker plate.",
        help="Where tube and panel stand to each other in every exposure, from a marker plate on the tube."
        "\n\nExample:  isocenter calibrate marker carm marker_scan -o marker.npz --figure marker.png",
    )(marker)
    parent.add_typer(app, name="calibrate")


def expose(
    machine_name: MachineArgument,
    recording_file: Annotated[Path, typer.Argument(metavar="REC", help="Recording of the scan, for its axis positions.")],
    truth: Annotated[Path, typer.Option("--truth", metavar="FILE", help="Truth file of the same run.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder to write.")],
    scene_name: Annotated[
        str, typer.Option("--scene", help="What stands in the beam: dodecahedron, wires-1mm, wires-0.2mm, vessel, aneurysm.")
    ] = "dodecahedron",
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", help="Exposures a second, by the panel's own clock.")] = 7.0,
    width: Annotated[float, typer.Option("--width", metavar="MS", help="Length of an exposure, milliseconds.")] = 8.0,
    binning: Annotated[int, typer.Option("--binning", min=1, help="Pixels read as one, in each direction.")] = 4,
    marker_name: Annotated[
        str | None, typer.Option("--marker", metavar="PLATE", help="In place of a scene, a plate on the tube: experimental, clinical.")
    ] = None,
    distance: Annotated[float, typer.Option("--distance", metavar="MM", help="From the focal spot to the marker plate.")] = 250.0,
    patient_seed: Annotated[
        int | None,
        typer.Option(
            "--patient",
            metavar="N",
            min=0,
            help="Draw patient N on a table, besides: tissue, bone, wires, vessels; even: a head, odd: a trunk.",
        ),
    ] = None,
    photons: Annotated[
        float | None, typer.Option("--photons", help="Mean count of a pixel in the open beam; 2000, or 20000 with a patient.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the photons.")] = 0,
    json_to: JsonOption = None,
) -> None:
    """Render, one image after the other."""
    import numpy as np

    from hil.emulated.anatomy import PHOTONS, with_patient
    from hil.emulated.beam import Beam
    from hil.emulated.images import Exposures, xray_side
    from hil.emulated.images import expose as render
    from hil.emulated.marker_images import TubeMarker
    from hil.emulated.scenes import scene
    from hil.imaging.nominal import nominal_detector, panel_in_tube
    from hil.recording import read_recording
    from virtual_bus.xray.imaging import Optics

    if photons is None:
        photons = Optics().photons if patient_seed is None else PHOTONS
    for option, value in (("--rate", rate), ("--width", width), ("--photons", photons)):
        if not 0.0 < value < np.inf:
            raise UnusableInputError(f"{option} {value:g}: must be a positive number")
    machine = load(machine_name)
    answer = Answer(json_to)
    recording = read_recording(recording_file, machine)
    exposures = Exposures(rate_Hz=rate, width_s=1e-3 * width)
    detector = nominal_detector(machine, binning)
    shown = {"scene": scene_name} if marker_name is None else {"marker": marker_name, "marker_distance_mm": distance}
    plate = None if marker_name is None else TubeMarker(_plate(marker_name), 1e-3 * _positive(distance), panel_in_tube(machine))
    beam = Beam(scene(scene_name) if plate is None else [], plate, Optics(photons=photons))
    if patient_seed is not None:
        beam, shown = with_patient(beam, patient_seed, photons), {**shown, "patient": patient_seed}
    side = xray_side(machine, truth, beam.spot, exposures.first_s)
    with progress() as bars:
        task = bars.add_task("exposing", total=None)
        count = render(
            machine,
            side,
            exposures,
            beam,
            detector,
            out,
            recording,
            seed,
            lambda done, total: bars.update(task, completed=done, total=total),
            {**shown, "recording": recording_file.name},
        )
    answer.say(
        f"{out}: {count} images of {detector.columns} x {detector.rows} pixels, {marker_name or scene_name}"
        + ("" if patient_seed is None else f" and patient {patient_seed}")
    )
    answer.write({"folder": out, "exposures": count})


@asks
def phantom(
    machine_name: MachineArgument,
    request: Callable[..., verb.CalibrateRequest],
    figure: FigureOption = None,
    jobs: JobsOption = 1,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Find the bullets, fit the poses, write the table."""
    answer = Answer(json_to)
    asked = request(machine=load(machine_name), jobs=jobs)
    check_drawn(figure, page, ())
    found = ask(verb.answer, asked, answer)
    for line in found.lines:
        answer.say(line)
    if figure is not None:
        from hil.figures.geometry import deviations_figure

        along, label, axis = found.over
        save_figure(deviations_figure(along, label, {"phantom": (found.deviation, found.found.table.covariance)}), figure)
        answer.say(f"{figure}: the nine parameters over {axis}")
    if page is not None:
        from hil.reports.calibrated import phantom_page

        files = cast("tuple[Path, Path]", (asked.scan, asked.out))
        write_paged(answer, phantom_page(asked.machine, found.found.fit, found.found.table, files, answer.said), page)
    answer.write(found)


def marker(
    machine_name: MachineArgument,
    scan_folder: ScanArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="Parameters of every exposure to write (.npz).")],
    plate_name: Annotated[
        str | None, typer.Option("--plate", metavar="PLATE", help="experimental or clinical; as scan.toml says without.")
    ] = None,
    distance: Annotated[
        float | None, typer.Option("--distance", metavar="MM", help="From the focal spot to the plate; as scan.toml says without.")
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(
            "--free",
            metavar="NAME",
            help="A parameter to fit, repeated; without: focal_u, focal_v, focal_length, theta_x, theta_y, theta_z."
            " The others: offset_x, offset_y, plate_distance.",
        ),
    ] = None,
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="The fitted parameters over the scan.")] = None,
    jobs: JobsOption = 1,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Find the plate, fit its pose, write."""
    import numpy as np

    from hil.calibration.marker.scan import calibrate_marker, nominal_marker, write_marker_scan
    from hil.calibration.marker.tube_to_panel import NONLINEAR
    from hil.imaging.nominal import nominal_beam
    from hil.imaging.scan_folder import read_scan

    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(out, figure)
    check_page(page)
    scan = read_scan(scan_folder)
    name = plate_name or scan.notes.get("marker")
    away = distance if distance is not None else scan.notes.get("marker_distance_mm")
    if name is None or away is None:
        raise UnusableInputError(f"{scan_folder}/scan.toml names no marker and marker_distance_mm; give --plate and --distance")
    distance_m = 1e-3 * _positive(away)
    plate = _plate(str(name))
    positions = np.nan_to_num(scan.positions)  # tube and panel stand the same to each other in every nominal pose
    nominal = nominal_marker(nominal_beam(machine, positions), distance_m)
    with progress() as bars:
        follow = follower(bars, bars.add_task("marker", total=len(scan)))
        result = calibrate_marker(scan, plate, nominal, tuple(free or NONLINEAR), jobs, lambda done, total: follow(done))
    _report_marker(answer, result, plate.name)
    if figure is not None:
        from hil.figures.marker import marker_figure

        axis = int(np.argmax(np.ptp(positions, axis=0)))
        turning = np.ptp(positions[:, axis]) > 0.0
        along, label = (np.degrees(positions[:, axis]), f"{scan.axes[axis]} [deg]") if turning else (scan.middle_s, "time [s]")
        save_figure(marker_figure(along, label, result, f"{scan_folder.name}, {plate.name} plate"), figure)
        answer.say(f"{figure}: the fitted parameters over {label.split()[0]}")
    write_marker_scan(result, scan, {"machine": machine.name, "hash": machine.hash, "plate": plate.name}, out)
    answer.say(f"{out}: parameters of {int(result.good.sum())} exposures")
    if page is not None:
        from hil.reports.calibrated import marker_page

        write_paged(answer, marker_page(machine, result, scan, (scan_folder, out), answer.said), page)
    answer.write(
        {
            "plate": plate.name,
            "exposures": len(scan),
            "used": int(result.good.sum()),
            "free": result.free,
            "values": result.values,
            "sigma": np.sqrt(np.einsum("nii->ni", result.covariance)),
            "points": result.points,
            "residual_pixels": result.residual_pixels,
            "unusable": result.unusable,
            "deviation_pixels": result.quality.deviation_pixels,
            "blur_pixels": result.quality.blur_pixels,
            "suspect_exposures": result.quality.suspects,
        }
    )


def _plate(name: str) -> MarkerPlate:
    from hil.imaging.markers import PLATES

    if name not in PLATES:
        raise UnusableInputError(f"marker plate {name}: there are {', '.join(PLATES)}")
    return PLATES[name]()


def _positive(distance_mm: object) -> float:
    import numpy as np

    if not isinstance(distance_mm, (int, float)) or not 0.0 < distance_mm < np.inf:
        raise UnusableInputError(f"distance of the marker plate {distance_mm} mm: must be a positive number")
    return float(distance_mm)


def _report_marker(answer: Answer, result: MarkerScan, plate: str) -> None:
    import numpy as np

    from hil.imaging.markers.projection import PARAMETERS

    good = result.good
    held = ", ".join(name for name in PARAMETERS if name not in result.free)
    answer.say(
        f"{int(good.sum())} of {len(good)} exposures, a median of {np.median(result.points[good]):.0f} crossings of the {plate} plate,"
        f" {int(result.refused[good].sum())} lines refused, residual {float(np.nanmedian(result.residual_pixels)):.3f} pixels; held: {held}"
    )
    for k, reason in list(result.unusable.items())[:3]:
        answer.say(f"  exposure {k} not used: {reason}")
    quality, blur = result.quality, np.nanmedian(result.quality.blur_pixels, axis=0)
    answer.say(
        f"image quality: crossings to {float(np.nanmedian(quality.deviation_pixels)):.3f} pixels, blur {blur[0]:.2f} pixels along columns,"
        f" {blur[1]:.2f} along rows; {len(quality.suspects)} exposures stand out"
    )
    for k in quality.suspects[:3]:
        across, down = quality.blur_pixels[k]
        answer.say(f"  exposure {k}: crossings to {quality.deviation_pixels[k]:.3f} pixels, blur {across:.2f} and {down:.2f} pixels")
    for name in result.free:
        k = PARAMETERS.index(name)
        change = 1e3 * (result.values - result.nominal)[good, k]
        sigma = 1e3 * float(np.median(np.sqrt(result.covariance[good, k, k])))
        answer.say(f"  {name:14s} {change.min():8.3f} to {change.max():8.3f} {'mrad' if 3 <= k < 6 else 'mm'}, sigma {sigma:.3f}")
