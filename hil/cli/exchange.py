"""isocenter geometry convert: geometry between tables, 3 x 4 matrices, RTK's XML, DICOM's attributes and other programs' vectors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import MachineArgument, can_be_written, load, not_an_input
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption

if TYPE_CHECKING:
    import numpy as np

    from hil.imaging.detector import Detector
    from hil.imaging.exchange.read_vectors import Vectors
    from hil.imaging.geometry import ConeBeam
    from hil.machine import Machine

FAR = 1.25
"""Ratio of focal lengths beyond which matrices are of other pixels: binning goes in steps of 1.5 and more."""

_SQUARE = 0.01
"""Largest difference of a pixel's height from its width, as a share, that is not told."""

_SHOWN = 8
"""Names of arrays in one message."""

SUFFIXES = (".npz", ".csv", ".json", ".xml", ".dcm")
READABLE = (*SUFFIXES, ".npy")
ENHANCED = "enhanced-xa"


@dataclass(frozen=True)
class _Geometry:
    beam: ConeBeam
    detector: Detector
    positions: np.ndarray | None = None  # of the axes, where the source knows them
    images: Path | None = None  # the scan's folder
    notes: tuple[str, ...] = ()


def register(geometry: typer.Typer) -> None:
    """Add the command to the group."""
    geometry.command(
        "convert",
        short_help="Geometry between programs' files.",
        help="Geometry of exposures from one file to another: a scan's folder, .npz tables, .csv and .json 3 x 4 matrices [mm to pixels],"
        " .xml of RTK, .dcm attributes of X-ray angiography, .npz and .npy vectors of ASTRA, LEAP or TIGRE, which --for writes."
        "\n\nExample:  isocenter geometry convert carm scan scan.xml --with carm.model.npz",
    )(convert)


def convert(
    machine_name: MachineArgument,
    source: Annotated[Path, typer.Argument(metavar="IN", help="Folder of a scan, or .npz, .npy, .csv, .json, .xml, .dcm.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="To write: .npz, .csv, .json, .xml or .dcm.")],
    calibration: Annotated[
        Path | None, typer.Option("--with", metavar="FILE", help="For a scan's folder: look-up table or model; nominal unless given.")
    ] = None,
    binning: Annotated[int, typer.Option("--binning", min=1, help="Pixels read as one, where IN does not say.")] = 4,
    rows_up: Annotated[bool, typer.Option("--rows-up", help="Of .xml: for images flipped up-down, with positive distances.")] = False,
    images: Annotated[bool, typer.Option("--images", help="Of .dcm: with the scan's images.")] = False,
    program: Annotated[
        str, typer.Option("--for", metavar="PROGRAM", help="Of .npz: arrays of astra, leap or tigre; of .dcm: enhanced-xa.")
    ] = "",
    json_to: JsonOption = None,
) -> None:
    """Read, write, say what was lost."""
    from hil.imaging.exchange.vectors import PROGRAMS, write_vectors

    machine = load(machine_name)
    answer = Answer(json_to)
    can_be_written(target, suffixes=SUFFIXES)
    not_an_input(target, source)
    if calibration is not None and not source.is_dir():
        raise UnusableInputError(f"--with {calibration}: {source.name} has a geometry of its own; --with is for a scan's folder")
    fits = target.suffix.lower() == (".dcm" if program == ENHANCED else ".npz") and not rows_up and not (images and program != ENHANCED)
    if program and (program not in (*PROGRAMS, ENHANCED) or not fits):
        wanted = f"{', '.join(PROGRAMS)} for .npz, without --rows-up and --images, or {ENHANCED} for .dcm"
        raise UnusableInputError(f"--for {program}: must be {wanted}")
    read = _read(source, machine, calibration, binning)
    if program and program != ENHANCED:
        notes = [*read.notes, *write_vectors(target, read.beam, read.detector, program)]
    else:
        notes = [*read.notes, *_write(target, read, machine, rows_up, images, enhanced=program == ENHANCED)]
    answer.say(f"{target}: geometry of {len(read.beam)} exposures from {source.name}")
    for note in notes:
        answer.say(f"  {note}")
    answer.write({"written": target, "exposures": len(read.beam), "parameters": read.beam.parameters, "notes": notes})


def _read(path: Path, machine: Machine, calibration: Path | None, binning: int) -> _Geometry:
    from hil.calibration.kinematic.geometric_model import read_calibration
    from hil.calibration.use.lookup_table import LookUp
    from hil.files.arrays import read_arrays
    from hil.imaging.exchange.read_vectors import program_of, read_bare_vectors, read_vectors
    from hil.imaging.nominal import nominal_beam, nominal_detector

    if path.is_dir():
        from hil.imaging.scan_folder import read_scan

        scan = read_scan(path)
        positions = scan.positions_of(machine)
        beam = nominal_beam(machine, positions)
        if calibration is not None:
            beam = beam.moved(read_calibration(calibration, machine).at(positions))
        return _Geometry(beam, scan.detector, positions, path)
    detector = nominal_detector(machine, binning)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return _vectors(path, machine, read_bare_vectors(path, detector))
    if suffix == ".npz":
        arrays = read_arrays(path, "an archive of vectors or a look-up table")
        if program_of(arrays):
            return _vectors(path, machine, read_vectors(path, arrays, detector))
        if "format" not in arrays:
            has = ", ".join(sorted(arrays)[:_SHOWN]) + (", ..." if len(arrays) > _SHOWN else "")
            known = "Vectors of ASTRA, sourcePositions or phis of LEAP, DSO and DSD of TIGRE, format of a table"
            raise UnusableInputError(f"{path}: holds {has or 'nothing'}; what is read has one of: {known}")
        table = read_calibration(path, machine)
        if not isinstance(table, LookUp):
            raise UnusableInputError(f"{path}: a model has no exposures of its own; convert a scan's folder --with it")
        return _Geometry(nominal_beam(machine, table.positions).moved(table.deviation), detector, table.positions)
    if suffix in (".csv", ".json"):
        from hil.imaging.exchange.matrices import read_matrices

        beam, detector = read_matrices(path, detector)
        _check_distance(path, machine, beam, f"--binning {binning} was taken for that of the images")
        return _Geometry(beam, detector)
    if suffix == ".xml":
        from hil.imaging.exchange.rtk_xml import read_rtk

        beam, flipped = read_rtk(path)
        return _Geometry(beam, detector, notes=_flip_note(flipped))
    if suffix == ".dcm":
        from hil.imaging.exchange.dicom_file import read_xa

        found = read_xa(path)
        if found.detector is None and found.size not in (None, (detector.columns, detector.rows)):
            own, wanted = (" x ".join(map(str, each)) for each in (found.size or (), (detector.columns, detector.rows)))
            words = f"no ImagerPixelSpacing, and {own} pixels, where {machine.name} with --binning {binning} has {wanted}"
            raise UnusableInputError(f"{path}: {words}; name the --binning of its images")
        named = "no size of its pixels: that" if found.size else "no pixels: those"
        pixels = (
            ()
            if found.detector
            else (f"it names {named} of {machine.name} with --binning {binning} {'was' if found.size else 'were'} taken",)
        )
        return _Geometry(found.beam, found.detector or detector, notes=(*found.notes, *pixels))
    raise UnusableInputError(f"{path}: must be a scan's folder or end in {', '.join(READABLE)}")


def _check_distance(path: Path, machine: Machine, beam: ConeBeam, question: str) -> None:
    """Refuse a geometry whose focal spot is at another distance from the panel than the machine's."""
    import numpy as np

    from hil.imaging.nominal import nominal_beam

    expected = -nominal_beam(machine, np.zeros((1, len(machine.axes)))).source_m[0, 2]
    ratio = float(np.median(-beam.source_m[:, 2])) / expected
    if not 1.0 / FAR < ratio < FAR:
        where = f"puts the focal spot {ratio * expected:.3g} m from the panel, {machine.name} has {expected:.3g} m"
        raise UnusableInputError(f"{path}: {where}; {question}")


def _vectors(path: Path, machine: Machine, read: Vectors) -> _Geometry:
    _check_distance(path, machine, read.beam, f"{read.program.upper()}'s lengths are taken in mm")
    return _Geometry(read.beam, read.detector, notes=(*read.notes, *_flip_note(read.flipped)))


def _flip_note(flipped: bool) -> tuple[str, ...]:
    return ("its images are to be flipped up-down",) if flipped else ()


def _write(path: Path, read: _Geometry, machine: Machine, rows_up: bool, images: bool, *, enhanced: bool) -> list[str]:
    """Write the geometry; return what was lost."""
    import numpy as np

    from hil.imaging.nominal import nominal_beam

    suffix = path.suffix.lower()
    if rows_up and suffix != ".xml":
        raise UnusableInputError(f"--rows-up: is for .xml, not {path.name}")
    if images and (suffix != ".dcm" or read.images is None):
        raise UnusableInputError("--images: is for a scan's folder and .dcm")
    if suffix == ".npz":
        from hil.calibration.use.lookup_table import LookUp, write_look_up

        if read.positions is None:
            raise UnusableInputError(f"{path}: a table goes by axis positions, and the input has none; convert a scan's folder or a table")
        deviation = read.beam.deviation_from(nominal_beam(machine, read.positions))
        notes = {"machine": machine.name, "hash": machine.hash}
        write_look_up(LookUp(machine.axes, read.positions, deviation, np.zeros((len(deviation), 9, 9)), notes), path)
        return ["without covariances"]
    if suffix in (".csv", ".json"):
        from hil.imaging.exchange.matrices import write_matrices

        write_matrices(path, read.beam, read.detector)
        panel = read.detector
        wide, high = 1e3 * panel.pitch_m, 1e3 * panel.pitch_m * panel.aspect
        height = f" x {high:.4g}" if abs(high - wide) > _SQUARE * wide else ""
        return [f"for images of {panel.columns} x {panel.rows} pixels of {wide:.4g}{height} mm"]
    if suffix == ".xml":
        from hil.imaging.exchange.rtk_xml import write_rtk

        write_rtk(path, read.beam, rows_up)
        return ["for images flipped up-down"] if rows_up else []
    from hil.imaging.exchange.dicom_enhanced import write_enhanced_xa
    from hil.imaging.exchange.dicom_xa import positioner_of, write_xa

    positioner, lost = positioner_of(read.beam, read.detector, each_distance=enhanced)
    (write_enhanced_xa if enhanced else write_xa)(path, positioner, _images(read.images) if images and read.images is not None else None)
    largest = np.abs(lost).max(axis=0)
    return [
        "DICOM's attributes hold no offsets and no turn in the panel's plane: lost up to"
        f" {1e3 * largest[:6].max():.2f} mm and {1e3 * largest[6:].max():.2f} mrad"
    ]


def _images(folder: Path) -> np.ndarray:
    import numpy as np

    from hil.imaging.scan_folder import read_scan

    scan = read_scan(folder)
    return np.array([scan.frame(k) for k in range(len(scan))])
