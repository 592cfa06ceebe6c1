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
from hil.verbs import expose as exposing

if TYPE_CHECKING:
    from hil.calibration.marker.scan import MarkerScan

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


@asks
def expose(machine_name: MachineArgument, request: Callable[..., exposing.ExposeRequest], json_to: JsonOption = None) -> None:
    """Render, one image after the other."""
    asked = request(machine=load(machine_name))
    answer = Answer(json_to)
    found = ask(exposing.answer, asked, answer, told_as=UnusableInputError)
    answer.say(found.sentence)
    answer.write(found)


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
    from hil.imaging.marker_view import plate_at_m, plate_of
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
    distance_m = plate_at_m(away)
    plate = plate_of(str(name))
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
