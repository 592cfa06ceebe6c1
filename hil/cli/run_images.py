"""Images beside a run: `isocenter run ... --images DIR`."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from hil.errors import UnusableInput

if TYPE_CHECKING:
    from hil.cli.output import Answer
    from hil.cli.run_data import DataBeside
    from hil.machine import Machine

ImagesOption = Annotated[Path | None, typer.Option("--images", metavar="DIR", help="Receive the panel's frames too, as a scan folder.")]
SceneOption = Annotated[
    str, typer.Option("--scene", help="With --images on lockstep: what stands in the beam, or a marker plate, experimental or clinical.")
]
ImageRateOption = Annotated[float, typer.Option("--image-rate", metavar="HZ", help="With --images on lockstep: exposures a second.")]
SpoolOption = Annotated[
    Path | None, typer.Option("--spool", metavar="DIR", help="With --images on a bus: the folder where the panel's software leaves frames.")
]

BinningOption = Annotated[
    int, typer.Option("--image-binning", metavar="N", min=1, help="With --images: pixels of the panel read as one, in each direction.")
]

DISTANCE_MM = 250.0
"""Of a marker plate from the focal spot."""

MANY = 8
"""Lost frames that are named."""


@contextmanager
def images_beside(
    machine: Machine,
    images: Path | None,
    scene_name: str,
    rate_Hz: float,
    binning: int,
    spool: Path | None,
    recordings: list[Path],
    truth: Path | None,
    answer: Answer,
    lockstep: bool,
    beside: DataBeside | None = None,
) -> Iterator[Path | None]:
    """Receive frames while the block runs; yields the truth file the emulator has to write, where one is needed.

    Raises
    ------
    UnusableInput
        Options that do not belong together, or frames that make no scan.
    """
    if images is None:
        yield truth
        return
    from hil.imaging.emulated import SPOT, Exposures
    from hil.imaging.emulated_panel import PanelOrder
    from hil.imaging.frames_beside import finished_scan, frames_beside
    from hil.imaging.mailbox import LockstepEnd
    from hil.imaging.marker_view import watched_marker
    from hil.imaging.markers.emulated import TubeMarker
    from hil.imaging.nominal import nominal_detector, panel_in_tube
    from hil.imaging.receiver import ReceiverOrder
    from hil.imaging.scenes import scene
    from hil.imaging.watch import Live
    from hil.recording import read_recording
    from virtual_bus.xray.imaging import Optics

    if len(recordings) != 1:
        raise UnusableInput(f"--images: belongs to one recording; this experiment makes {len(recordings)}")
    if lockstep == (spool is not None):
        raise UnusableInput("--spool: on lockstep: the emulated panel has its own; on a bus give the folder of the panel's frames")
    if not 0.0 < rate_Hz < np.inf:
        raise UnusableInput(f"--image-rate {rate_Hz:g}: must be a positive number")
    detector = nominal_detector(machine, binning)
    plate, nominal = watched_marker(machine, scene_name, 1e-3 * DISTANCE_MM)
    with tempfile.TemporaryDirectory() as scratch:
        live = None if beside is None else Live(machine, beside.mailbox)
        order = ReceiverOrder(spool or Path(scratch) / "spool", images, detector, None if plate is None else plate.name, nominal, live)
        panel = None
        if lockstep:
            truth = truth or Path(scratch) / "truth.csv"
            on_tube = None if plate is None else TubeMarker(plate, 1e-3 * DISTANCE_MM, panel_in_tube(machine))
            items = scene(scene_name) if plate is None else []
            panel = PanelOrder(machine, truth, order.spool, Exposures(rate_Hz), items, detector, Optics(), SPOT, on_tube, 0)
        with frames_beside(order, panel) as check:
            if beside is not None and isinstance(beside.inbox, LockstepEnd):
                beside.inbox.check = check
            yield truth
            if lockstep:
                answer.say("the run is over; waiting for the emulated panel's last images")
        shown: dict[str, object] = {"scene": scene_name} if plate is None else {"marker": scene_name, "marker_distance_mm": DISTANCE_MM}
        got = finished_scan(machine, order, read_recording(recordings[0], machine), {**shown, "recording": recordings[0].name})
    if got.lost:
        shown_numbers = ", ".join(map(str, got.lost[:MANY])) + (", …" if len(got.lost) > MANY else "")
        answer.say(f"{images}: {len(got.lost)} frames never came: {shown_numbers}; what they showed is missing, the others are whole")
    answer.say(
        f"{images}: {got.exposures} images, {len(got.lost)} lost; the panel's clock runs {got.clock_ppm:+.0f} ppm against the loop's,"
        f" known to {got.doubt_ppm:.0f}, pulses {1e3 * got.residual_s:.2f} ms rms about it"
    )
