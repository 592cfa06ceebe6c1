"""Geometric calibration: images of scans to the geometry of every exposure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from hil.calibration.kinematic.from_tables import model_from_tables
from hil.calibration.kinematic.geometric_model import GeometricModel
from hil.calibration.phantom.from_scan import calibrate_phantom_scan
from hil.calibration.use.lookup_table import LookUp
from hil.emulated.anatomy import with_patient
from hil.emulated.beam import beam_of
from hil.emulated.images import Exposures, xray_side
from hil.emulated.images import expose as expose_images
from hil.imaging.nominal import nominal_detector
from hil.imaging.scan_folder import ImageScan, read_scan
from hil.machine import Machine
from hil.recording import Recording
from hil.tasks.errors import as_bench_errors
from hil.tasks.recordings import Recordings, the_one


@as_bench_errors()
def expose(
    machine: Machine,
    recording: Recording | Recordings,
    truth: str | Path,
    out: str | Path,
    *,
    scene: str = "dodecahedron",
    rate_Hz: float = 7.0,
    binning: int = 4,
    seed: int = 0,
    patient: int | None = None,
) -> ImageScan:
    """Make the images of a scan as the emulated machine's panel takes them.

    Parameters
    ----------
    machine : Machine
        The emulated one.
    recording : Recording
        Of the scan, for its axis positions.
    truth : str or Path
        Truth file of the same run: `machine.run(..., truth=...)`.
    out : str or Path
        Folder to write.
    scene : str
        What stands in the beam: `dodecahedron` (the calibration phantom), `wires-1mm`, `wires-0.2mm`, `vessel`, `aneurysm`, or a marker
        plate on the tube, `experimental` or `clinical`.
    rate_Hz : float
        Exposures a second.
    binning : int
        Pixels read as one, in each direction.
    seed : int
        Of the photons.
    patient : int, optional
        A drawn patient in the beam, too, who lets fewer photons through: even numbers are heads, odd ones trunks.

    Raises
    ------
    UnusableInputError
        No such scene, a truth file of another run, or a package of the extra `imaging` is missing.
    """
    exposures, folder, beam = Exposures(rate_Hz=rate_Hz), Path(out), beam_of(machine, scene)
    notes: dict[str, object] = {"scene": scene}
    if patient is not None:
        beam, notes = with_patient(beam, patient), {**notes, "patient": patient}
    side = xray_side(machine, Path(truth), beam.spot, exposures.first_s)
    expose_images(machine, side, exposures, beam, nominal_detector(machine, binning), folder, the_one(recording), seed, notes=notes)
    return read_scan(folder)


@as_bench_errors()
def calibrate_phantom(
    machine: Machine,
    scan: ImageScan | str | Path,
    *,
    six: bool = False,
    pixels: bool = False,
    at_standstill: bool = False,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> LookUp:
    """Find the geometry of every exposure of a scan, from images of the bullet phantom.

    Parameters
    ----------
    machine : Machine
        Whose file says the nominal geometry.
    scan : ImageScan, or its folder
    six : bool
        Hold the source at nominal and fit six parameters only.
    pixels : bool
        Fit the pixels' aspect and skew, too.
    at_standstill : bool
        Keep the poses at which the machine stood, averaged: a roadmapping grid.
    jobs : int
        Processes that look at images.
    progress : callable
        Told how many of how many images are done.

    Returns
    -------
    LookUp
        `.deviation` (N, 9) from the nominal geometry over `.positions` (N, axes), with `.covariance`; `.at(positions)` between them.

    Raises
    ------
    UnusableInputError
        Images that show no phantom, or a scan whose axis positions are not known.
    """
    folder = scan if isinstance(scan, ImageScan) else read_scan(Path(scan))
    return calibrate_phantom_scan(machine, folder, six=six, pixels=pixels, at_standstill=at_standstill, jobs=jobs, progress=progress).table


@as_bench_errors()
def calibrate_model(machine: Machine, tables: Sequence[LookUp], *, frozen: Sequence[str] = ()) -> GeometricModel:
    """Fit a Denavit-Hartenberg model whose joints give way under gravity, which predicts the nine parameters of any pose.

    Parameters
    ----------
    machine : Machine
    tables : sequence of LookUp
        Of phantom-calibrated scans.
    frozen : sequence of str
        Parameters kept at nominal.

    Raises
    ------
    UnusableInputError
        A table is of another machine, or there is no such parameter.
    """
    return model_from_tables(machine, tables, frozen)[0]
