"""Data-driven calibration: the observer and a few images instead of a phantom scan for every kind of scan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.calibration.data_driven.calibrate import calibrate_data as run_filter
from hil.calibration.data_driven.data_file import DataFile, read_data_file, write_data_file
from hil.calibration.data_driven.image_measurements import from_marker, from_phantom
from hil.calibration.data_driven.levelled import levelled
from hil.calibration.data_driven.observed_beam import ObservedBeam, observed_beam, unobserved_beam
from hil.calibration.data_driven.quasi_static import QuasiStatic
from hil.calibration.data_driven.values import Calibration, Measurement, Parameters
from hil.calibration.marker.scan import calibrate_marker, nominal_marker
from hil.calibration.phantom.phantom_calibration import calibrate_phantom
from hil.errors import UnusableInputError
from hil.imaging.markers import PLATES
from hil.imaging.nominal import nominal_beam
from hil.imaging.phantoms import dodecahedron
from hil.imaging.scan_folder import ImageScan, read_scan
from hil.machine import Machine
from hil.observing import ObserverDesign, observe
from hil.recording import Channel, Recording
from hil.verbs.errors import as_bench_errors
from hil.verbs.observe import read_fitting
from hil.verbs.recordings import Recordings, the_one

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class DataCalibration:
    """Geometry at every sample of a recording.

    Attributes
    ----------
    model : QuasiStatic
        What the parameters are of.
    observed : ObservedBeam
        The observer's geometry; its `time_s` and `positions` are those of the samples.
    found : Calibration
        `live` and `final`, deviations (N, 9) from the nominal geometry as known at each sample and with the parameters found at the end;
        `sigma` (N, 9); `parameters`.
    offered : int
        Images that were offered.
    is_observed : bool
        Whether an observer told the displacement; without, the geometry is that of slow motion.
    """

    model: QuasiStatic
    observed: ObservedBeam
    found: Calibration
    offered: int
    is_observed: bool

    def write(self, path: str | Path) -> None:
        """Write geometry and parameters (.npz), to continue from and for `isocenter reconstruct`."""
        write_data_file(self.model, self.observed, self.found, Path(path))


@as_bench_errors()
def calibrate_data(
    machine: Machine,
    recording: Recording | Recordings,
    scan: ImageScan | str | Path | None = None,
    *,
    marker: ImageScan | str | Path | None = None,
    start: DataFile | str | Path | None = None,
    design: ObserverDesign | str | Path | None = None,
    most: int | None = None,
    until_m: float = 0.0,
    late_s: float = 0.2,
    jobs: int = 1,
    progress: Progress = lambda what, done, total: None,
) -> DataCalibration:
    """Find the geometry of a scan at every sample: quasi-static parameters and the observer's displacement in one filter.

    Parameters
    ----------
    machine : Machine
        Whose file says the nominal geometry.
    recording : Recording
        Of the scan.
    scan, marker : ImageScan, or its folder, optional
        Phantom images and marker images of the same scan.
    start : DataFile or path, optional
        An earlier calibration to continue from.
    design : ObserverDesign or path, optional
        Observer to run over the recording; its own estimates are used otherwise.
    most : int, optional
        Withdraw phantom images after so many.
    until_m : float
        Withdraw them once the place of the isocentre is known to this standard deviation; 0: never.
    late_s : float
        How long after its exposure an image is there.
    jobs : int
        Processes that look at images.
    progress : callable
        Told what is looked at, and how many of how many images are done.

    Raises
    ------
    UnusableInputError
        Neither images nor a start, a design of another machine, or images without what they show.
    """
    if scan is None and start is None and marker is None:
        raise UnusableInputError("neither images nor a start: nothing tells this machine's geometry; give one of them")
    one, model = the_one(recording), QuasiStatic.of(machine)
    earlier = None if start is None else start if isinstance(start, DataFile) else read_data_file(Path(start))
    known = Parameters.unknown(model) if earlier is None else earlier.parameters(model)
    observed, is_observed = _observed(machine, one, model, known, design)
    measurements: list[Measurement] = []
    if scan is not None:
        measurements += _phantom(machine, _scan(scan), observed, jobs, progress)
    if marker is not None:
        measurements += _marker(machine, _scan(marker), jobs, progress)
    measurements.sort(key=lambda each: each.time_s)
    begin = known if earlier is None else known.aged(model)
    found = run_filter(model, observed, measurements, begin, late_s=late_s, until_m=until_m, most=most)
    return DataCalibration(model, observed, found, len(measurements), is_observed)


def _scan(given: ImageScan | str | Path) -> ImageScan:
    return given if isinstance(given, ImageScan) else read_scan(Path(given))


def _observed(
    machine: Machine, recording: Recording, model: QuasiStatic, known: Parameters, design: ObserverDesign | str | Path | None
) -> tuple[ObservedBeam, bool]:
    """Return the observer's geometry, and whether there is an observer."""
    if design is None:
        if f"estimate_link_position_{machine.axes[0]}" in recording:
            return observed_beam(machine, recording), True
        return unobserved_beam(machine, recording), False
    made = read_fitting(design, machine)
    estimate = observe(levelled(machine, recording, model, known.values), made.observer())
    columns = zip(estimate.names, estimate.units, estimate.values.T, strict=True)
    return observed_beam(machine, Recording({**recording.channels, **{name: Channel(unit, v) for name, unit, v in columns}}, {})), True


def _phantom(machine: Machine, scan: ImageScan, observed: ObservedBeam, jobs: int, progress: Progress) -> list[Measurement]:
    positions, _, _ = observed.at(scan.middle_s)

    def follow(done: int, total: int) -> None:
        progress("bullets", done, total)

    fit = calibrate_phantom(scan, dodecahedron(), nominal_beam(machine, positions), True, jobs, follow)
    return from_phantom(machine, scan, fit, observed)


def _marker(machine: Machine, scan: ImageScan, jobs: int, progress: Progress) -> list[Measurement]:
    name, distance_mm = scan.notes.get("marker"), scan.notes.get("marker_distance_mm")
    if name not in PLATES or not isinstance(distance_mm, (int, float)):
        raise UnusableInputError(f"{scan.folder}/scan.toml names no marker of {', '.join(PLATES)} and marker_distance_mm")

    def follow(done: int, total: int) -> None:
        progress("marker", done, total)

    nominal = nominal_marker(nominal_beam(machine, np.nan_to_num(scan.positions)), 1e-3 * float(distance_mm))
    return from_marker(scan, calibrate_marker(scan, PLATES[name](), nominal, jobs=jobs, progress=follow))
