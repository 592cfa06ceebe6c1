"""Images beside a run: `isocenter run ... --images DIR`."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import FASTEST_Hz
from hil.errors import UnusableInputError

if TYPE_CHECKING:
    from hil.cli.run_data import DataBeside
    from hil.machine import Machine
    from hil.receiving.panel_frames import RowSpan
    from hil.terminal.output import Answer

ImagesOption = Annotated[Path | None, typer.Option("--images", metavar="DIR", help="Receive the panel's frames too, as a scan folder.")]
SceneOption = Annotated[
    str, typer.Option("--scene", help="With --images: what stands in the beam, or a marker plate, experimental or clinical.")
]
ImageRateOption = Annotated[
    float, typer.Option("--image-rate", metavar="HZ", help="With --images on lockstep or from --panel: exposures a second.")
]
PanelOption = Annotated[
    str,
    typer.Option(
        "--panel", metavar="URL", help="With --images on a bus: the panel, tcp:HOST:PORT, where no emulator on this host says so."
    ),
]
SpoolOption = Annotated[
    Path | None, typer.Option("--spool", metavar="DIR", help="With --images on a bus: the folder where the panel's software leaves frames.")
]

BinningOption = Annotated[
    int, typer.Option("--image-binning", metavar="N", min=1, help="With --images: pixels of the panel read as one, in each direction.")
]


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
    panel_url: str,
    bus: str,
    recordings: list[Path],
    truth: Path | None,
    answer: Answer,
    lockstep: bool,
    real_time: bool,
    beside: DataBeside | None = None,
) -> Iterator[tuple[Path | None, RowSpan | None]]:
    """Receive frames while the block runs.

    Yields the truth file that the emulator has to write and the span of rows to fill in, where needed.

    Raises
    ------
    UnusableInputError
        Options that do not belong together, or frames that make no scan.
    """
    if images is None:
        if spool is not None or panel_url:
            raise UnusableInputError(f"{'--panel' if panel_url else '--spool'}: says where images come from; give --images DIR as well")
        yield truth, None
        return
    import multiprocessing

    from hil.emulated.beam import beam_of
    from hil.emulated.images import Exposures
    from hil.emulated.panel import PanelOrder
    from hil.imaging.mailbox import LockstepEnd
    from hil.imaging.marker_view import PLATE_M, watched_marker
    from hil.imaging.nominal import nominal_detector
    from hil.receiving.frame_measurements import Live
    from hil.receiving.frames_beside import finished_scan, frames_beside
    from hil.receiving.panel_frames import RemotePanel, RowSpan
    from hil.receiving.receiver import ReceiverOrder
    from hil.recording import read_recording

    if len(recordings) != 1:
        raise UnusableInputError(f"--images: belongs to one recording; this experiment makes {len(recordings)}")
    if not 0.0 < rate_Hz < FASTEST_Hz:
        raise UnusableInputError(f"--image-rate {rate_Hz:g}: must be a positive number below {FASTEST_Hz:g}")
    detector = nominal_detector(machine, binning)
    plate, nominal = watched_marker(machine, scene_name)
    url = _panel_url(spool, panel_url, bus, lockstep, scene_name)
    beam = beam_of(machine, scene_name) if spool is None else None
    with tempfile.TemporaryDirectory() as scratch:
        live = None if beside is None else Live(machine, beside.mailbox, counts_syncs=bool(url), skips=not lockstep, real_time=real_time)
        source: Path | RemotePanel = spool or Path(scratch) / "spool"
        rows = None
        if url:
            rows = RowSpan(multiprocessing.get_context("spawn"))
            source = RemotePanel(url, rate_Hz, binning, 1.0 / machine.sample_rate_Hz, rows)
        order = ReceiverOrder(source, images, detector, None if plate is None else plate.name, nominal, live)
        panel = None
        if lockstep:
            truth = truth or Path(scratch) / "truth.csv"
            assert isinstance(source, Path)
            assert beam is not None
            panel = PanelOrder(machine, truth, source, Exposures(rate_Hz), beam, detector, 0)
        with frames_beside(order, panel, None if lockstep else answer.say) as check:
            if beside is not None and isinstance(beside.inbox, LockstepEnd):
                beside.inbox.check = check
            yield truth, rows
            if lockstep or url:
                answer.say("the run is over; waiting for the panel's last images")
        shown: dict[str, object] = {"scene": scene_name} if plate is None else {"marker": scene_name, "marker_distance_mm": 1e3 * PLATE_M}
        got = finished_scan(machine, order, read_recording(recordings[0], machine), {**shown, "recording": recordings[0].name})
    if got.lost:
        shown_numbers = ", ".join(map(str, got.lost[:MANY])) + (", …" if len(got.lost) > MANY else "")
        answer.say(f"{images}: {len(got.lost)} frames never came: {shown_numbers}; what they showed is missing, the others are whole")
    answer.say(
        f"{images}: {got.exposures} images, {len(got.lost)} lost; the panel's clock runs {got.clock_ppm:+.0f} ppm against the loop's,"
        f" known to {got.doubt_ppm:.0f}, pulses {1e3 * got.residual_s:.2f} ms rms about it"
    )


def _panel_url(spool: Path | None, panel_url: str, bus: str, lockstep: bool, scene_name: str) -> str:
    """Return where the panel is; "" where its frames come through a folder.

    Raises
    ------
    UnusableInputError
        Nobody says where they come from, or two do, or what is emulated shows something else.
    """
    if lockstep:
        if spool is not None or panel_url:
            which = "--spool" if spool is not None else "--panel"
            raise UnusableInputError(f"{which}: on lockstep: the emulated panel has its own; leave it out")
        return ""
    if spool is not None and panel_url:
        raise UnusableInputError("--spool and --panel: frames come from one of them; leave the other out")
    if spool is not None:
        return ""
    if panel_url:
        return panel_url
    from hil.emulated.card import find

    card = find(bus)
    if card is None or not card.panel_url:
        raise UnusableInputError(
            f"--images: nobody says where the panel of {bus} is; start `isocenter emulate --panel SCENE` on this bus, give --panel URL,"
            " or --spool DIR with the folder of the panel's frames"
        )
    if card.panel_scene != scene_name:
        raise UnusableInputError(f"--scene {scene_name}: the panel that is emulated on {bus} shows {card.panel_scene}; give that one")
    return card.panel_url
