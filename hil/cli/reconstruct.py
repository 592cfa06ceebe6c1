"""isocenter reconstruct: a volume from a scan's images and the geometry of each exposure."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import MachineArgument, ScanArgument, folder_can_be_written, load
from hil.cli.paged import PageOption, check_page, write_paged
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import progress

if TYPE_CHECKING:
    import numpy as np

    from hil.reconstruction.fdk import Volume

LARGE_BYTES = 2e9
"""Memory from which on a reconstruction reports how much it takes."""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="A volume from a scan's images.",
        help="A volume from a scan's images, with the nominal geometry or a calibrated one, and how sharp thin wires are in it."
        " With --neck and --dome the shape of an aneurysm in it, each number with its standard deviation."
        "\n\nExample:  isocenter reconstruct carm wire_scan --lookup roll.lookup.npz -o reconstruction",
    )(reconstruct)


def reconstruct(
    machine_name: MachineArgument,
    scan_folder: ScanArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for volume.mha and figures.")],
    lookup: Annotated[Path | None, typer.Option("--lookup", metavar="LOOKUP", help="Look-up table or model; nominal without.")] = None,
    geometry: Annotated[
        Path | None, typer.Option("--geometry", metavar="FILE", help="Geometry of this very run: isocenter calibrate data.")
    ] = None,
    size: Annotated[int, typer.Option("--size", min=16, max=1024, help="Voxels along each edge.")] = 128,
    spacing: Annotated[float, typer.Option("--spacing", metavar="MM", help="Edge of a voxel.")] = 0.5,
    hann: Annotated[float, typer.Option("--hann", min=0.0, max=1.0, help="Hann window's cut-off, relative to Nyquist; 0: none.")] = 0.0,
    neck: Annotated[
        str, typer.Option("--neck", metavar="X,Y,Z", help="Of an aneurysm to measure: a point of its neck's plane [mm], with --dome.")
    ] = "",
    dome: Annotated[
        str, typer.Option("--dome", metavar="X,Y,Z", help="A point inside its dome [mm]; the plane is square to the line between both.")
    ] = "",
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Read, reconstruct, judge, draw."""
    import numpy as np

    from hil.calibration.data_driven.data_file import read_data_file
    from hil.calibration.kinematic.geometric_model import read_calibration
    from hil.calibration.use.lookup_table import LookUp, sweep_speed
    from hil.emulated.scenes import scene
    from hil.figures.reconstruction import volume_figure, wires_figure
    from hil.imaging.nominal import nominal_beam
    from hil.imaging.scan_folder import read_scan
    from hil.reconstruction.fdk import line_integrals, write_volume
    from hil.reconstruction.fdk import reconstruct as make
    from hil.reconstruction.wire_profiles import wire_quality
    from virtual_bus.xray.objects import Rod

    if not 0.0 < spacing < np.inf:
        raise UnusableInputError(f"--spacing {spacing:g}: must be a positive number")
    if bool(neck) != bool(dome):
        raise UnusableInputError("--neck and --dome: give both, or none")
    points = [_point(option, text) for option, text in (("--neck", neck), ("--dome", dome)) if text]
    if lookup is not None and geometry is not None:
        raise UnusableInputError("--lookup and --geometry: give the one or the other")
    machine = load(machine_name)
    answer = Answer(json_to)
    folder_can_be_written(out)
    check_page(page)
    scan = read_scan(scan_folder)
    positions = scan.positions_of(machine)
    beam = nominal_beam(machine, positions)
    source = "nominal geometry"
    if lookup is not None:
        table = read_calibration(lookup, machine)
        if table.notes.get("hash", machine.hash) != machine.hash:
            answer.say(f"{lookup.name} was made with another version of {machine.name}'s file; its deviations are used as they are")
        other = table.other_speed(sweep_speed(scan.middle_s, positions)) if isinstance(table, LookUp) else ""
        if other:
            answer.say(f"{lookup.name}: {other}")
        beam, source = beam.moved(table.at(positions)), f"geometry from {lookup.name}"
    if geometry is not None:
        beam, source = read_data_file(geometry).beam(machine, scan.middle_s), f"geometry from {geometry.name}"
    _require_memory(size, (len(scan), scan.detector.rows, scan.detector.columns), answer)
    images = np.empty((len(scan), scan.detector.rows, scan.detector.columns), dtype=np.float32)
    with progress() as bars:
        task = bars.add_task("reading", total=len(scan))
        for k in range(len(scan)):
            images[k] = line_integrals(scan.frame(k))
            bars.update(task, completed=k + 1)
        bars.update(bars.add_task("reconstructing", total=None))
        volume = make(images, scan.detector, beam, size, 1e-3 * spacing, hann)
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_volume(volume, out / "volume.mha")
        volume_figure(volume, f"{scan_folder.name}, {source}").savefig(out / "volume.png", dpi=130)
    except OSError as error:
        raise UnusableInputError(f"{out}: cannot be written: {error.strerror or error}") from None
    answer.say(f"{out}: volume.mha of {size}^3 voxels of {spacing:g} mm, volume.png; {len(scan)} projections, {source}")
    name = str(scan.notes.get("scene", ""))
    judged = {}
    if name.startswith("wires"):
        rods = [item for item in scene(name) if isinstance(item, Rod)]
        for axis, rod in zip("xyz", rods, strict=True):
            try:
                judged[f"wire {axis}"] = wire_quality(volume, rod.start_m, rod.end_m, rod.attenuation_1_m)
            except UnusableInputError as error:
                answer.say(f"  wire {axis}: {error}")
        if judged:
            wires_figure(judged, f"{scan_folder.name}, {source}").savefig(out / "wires.png", dpi=130)
        for wire, quality in judged.items():
            answer.say(
                f"  {wire}: peak {quality.mean_peak_1_m:.1f} 1/m, {quality.peak_ratio:.2f} of what it has, widths"
                f" {1e3 * quality.widths_m[0]:.2f} and {1e3 * quality.widths_m[1]:.2f} mm,"
                f" {1e3 * np.linalg.norm(quality.offset_m):.2f} mm from its place, artefacts {quality.artefact:.1%} of the peak"
            )
    shape = _aneurysm(volume, points, answer) if points else {}
    if page is not None:
        from hil.reports.reconstructed import reconstructed_page

        facts = {"Geometry": source, "Projections": str(len(scan))}
        write_paged(answer, reconstructed_page(machine, volume, judged, (scan_folder, out), facts), page)
    answer.write(
        {
            "geometry": source,
            "projections": len(scan),
            "wires": {
                wire: {
                    "peak_1_m": q.mean_peak_1_m,
                    "peak_ratio": q.peak_ratio,
                    "widths_m": q.widths_m,
                    "offset_m": q.offset_m,
                    "artefact": q.artefact,
                }
                for wire, q in judged.items()
            },
            "aneurysm": shape,
        }
    )


def _point(option: str, text: str) -> np.ndarray:
    """Read a point [m] of the phantom's frame."""
    import numpy as np

    try:
        point = 1e-3 * np.array([float(part) for part in text.split(",")])
    except ValueError:
        point = np.empty(0)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise UnusableInputError(f"{option} {text}: must be three numbers in mm, such as 0,-12.5,3")
    return point


def _aneurysm(volume: Volume, points: list[np.ndarray], answer: Answer) -> dict[str, dict[str, float | str]]:
    """Measure an aneurysm, and say its numbers in millimetres."""
    from hil.reconstruction.aneurysm import UNITS, aneurysm_shape

    found = aneurysm_shape(volume, *points)
    for name, unit in UNITS.items():
        power = {"m": 1, "m^2": 2, "m^3": 3}.get(unit, 0)
        value, deviation = (1e3**power * each[name] for each in (found.values, found.deviations))
        answer.say(f"  {name.replace('_', ' '):18s} {value:8.4g} ± {deviation:.2g} {unit.replace('m', 'mm', 1)}".rstrip())
    return {name: {"value": found.values[name], "deviation": found.deviations[name], "unit": unit} for name, unit in UNITS.items()}


def _require_memory(size: int, projections: tuple[int, int, int], answer: Answer) -> None:
    """Refuse a volume that this computer cannot hold; say how much memory a large one takes."""
    import numpy as np

    from hil.reconstruction.fdk import bytes_needed

    needed, there_is = bytes_needed(size, projections), np.inf
    if hasattr(os, "sysconf"):  # Windows does not say
        there_is = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > there_is:
        raise UnusableInputError(f"--size {size}: takes {needed / 1e9:.1f} GB of memory; this computer has {there_is / 1e9:.1f} GB")
    if needed > LARGE_BYTES:
        answer.say(f"--size {size} takes {needed / 1e9:.1f} GB of memory")
