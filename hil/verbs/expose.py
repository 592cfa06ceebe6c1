"""Images of a scan as an emulated machine's panel takes them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hil.errors import RequestError
from hil.verbs.errors import as_bench_errors
from hil.verbs.verb import KEPT, NOBODY, Listener, argument, option

if TYPE_CHECKING:
    from hil.imaging.detector import Detector
    from hil.imaging.scan_folder import ImageScan
    from hil.machine import Machine
    from hil.recording import Recording
    from hil.verbs.recordings import Given, Recordings


@dataclass(frozen=True)
class ExposeRequest:
    """A scan of an emulated machine, and what its panel sees."""

    machine: Machine
    recording: Given = argument("Recording of the scan, for its axis positions.", "REC")
    truth: Path = option("Truth file of the same run.", "FILE", "--truth", is_needed=True)
    out: Path = option("Folder to write.", "DIR", "-o", "--out", is_needed=True)
    scene: str = option(
        "What stands in the beam: dodecahedron, wires-1mm, wires-0.2mm, vessel, aneurysm.", None, "--scene", default="dodecahedron"
    )
    rate_Hz: float = option("Exposures a second, by the panel's own clock.", "HZ", "--rate", default=7.0)
    width_s: float = option("Length of an exposure, milliseconds.", "MS", "--width", default=0.008)
    binning: int = option("Pixels read as one, in each direction.", None, "--binning", default=4, least=1)
    marker: str | None = option("In place of a scene, a plate on the tube: experimental, clinical.", "PLATE", "--marker", kind=str)
    distance_m: float = option("From the focal spot to the marker plate.", "MM", "--distance", default=0.25)
    patient: int | None = option(
        "Draw patient N on a table, besides: tissue, bone, wires, vessels; even: a head, odd: a trunk.",
        "N",
        "--patient",
        kind=int,
        least=0,
    )
    photons: float | None = option("Mean count of a pixel in the open beam; 2000, or 20000 with a patient.", None, "--photons", kind=float)
    seed: int = option("Seed of the photons.", None, "--seed", default=0)


@dataclass(frozen=True)
class ExposeAnswer:
    """The images that were written."""

    folder: Path
    """The scan's folder."""
    exposures: int
    """Its images."""
    request: ExposeRequest = field(metadata=KEPT, repr=False)
    detector: Detector = field(metadata=KEPT, repr=False)

    @property
    def sentence(self) -> str:
        """The answer in a sentence."""
        request, shown = self.request, f"{self.detector.columns} x {self.detector.rows} pixels"
        patient = "" if request.patient is None else f" and patient {request.patient}"
        return f"{self.folder}: {self.exposures} images of {shown}, {request.marker or request.scene}{patient}"


def answer(request: ExposeRequest, listener: Listener = NOBODY) -> ExposeAnswer:
    """Render one image after the other; raises as `expose` does."""
    from hil.emulated.anatomy import PHOTONS, with_patient
    from hil.emulated.beam import Beam
    from hil.emulated.images import Exposures, expose, xray_side
    from hil.emulated.marker_images import TubeMarker
    from hil.emulated.scenes import scene
    from hil.imaging.marker_view import plate_at_m, plate_of
    from hil.imaging.nominal import nominal_detector, panel_in_tube
    from hil.verbs.recordings import the_one
    from virtual_bus.xray.imaging import Optics

    photons = request.photons
    if photons is None:
        photons = Optics().photons if request.patient is None else PHOTONS
    for part, value in (("rate_Hz", request.rate_Hz), ("width_s", 1e3 * request.width_s), ("photons", photons)):
        if not 0.0 < value < math.inf:
            raise RequestError("{" + part + "} {}: must be a positive number", f"{value:g}")
    machine, recording = request.machine, the_one(request.recording, request.machine)
    exposures, detector = Exposures(request.rate_Hz, request.width_s), nominal_detector(machine, request.binning)
    shown: dict[str, object] = {"scene": request.scene}
    plate = None
    if request.marker is not None:
        shown = {"marker": request.marker, "marker_distance_mm": round(1e3 * request.distance_m, 9)}
        plate = TubeMarker(plate_of(request.marker), plate_at_m(shown["marker_distance_mm"]), panel_in_tube(machine))
    beam = Beam(scene(request.scene) if plate is None else [], plate, Optics(photons=photons))
    if request.patient is not None:
        beam, shown = with_patient(beam, request.patient, photons), {**shown, "patient": request.patient}
    if isinstance(request.recording, str | Path):
        shown["recording"] = Path(request.recording).name
    side = xray_side(machine, request.truth, beam.spot, exposures.first_s)
    with listener.working("exposing") as work:
        count = expose(machine, side, exposures, beam, detector, request.out, recording, request.seed, work.done, shown)
    return ExposeAnswer(request.out, count, request, detector)


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
    from hil.imaging.markers import PLATES
    from hil.imaging.scan_folder import read_scan

    plate = scene if scene in PLATES else None
    request = ExposeRequest(
        machine, recording, Path(truth), Path(out), scene, rate_Hz, binning=binning, marker=plate, patient=patient, seed=seed
    )
    return read_scan(answer(request).folder)
