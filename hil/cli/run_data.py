"""Calibration during a run: `isocenter run ... --observer DESIGN --images DIR --data CALIBRATION`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import FASTEST_Hz
from hil.errors import UnusableInputError

if TYPE_CHECKING:
    import numpy as np

    from controllers.observers.modal_observer import ModalObserver
    from hil.calibration.data_driven.data_file import DataFile
    from hil.calibration.data_driven.live import LiveCalibration
    from hil.experiments import Plan
    from hil.imaging.mailbox import LoopEnd, Mailbox
    from hil.machine import Machine
    from hil.terminal.output import Answer

DataOption = Annotated[
    Path | None,
    typer.Option(
        "--data", metavar="FILE", help="With --observer and --images: calibrate live, going on from this calibration (calibrate data)."
    ),
]
UntilOption = Annotated[
    float, typer.Option("--until", metavar="MM", min=0.0, help="With --data: withdraw phantom images once the place is known so well.")
]

ASKED = 40
"""Poses of the run at which the place is asked for."""


@dataclass
class DataBeside:
    """Parts of a live calibration before there is an observer: its start, its mailbox, and when phantom images are withdrawn."""

    machine: Machine
    start: DataFile
    source: Path
    mailbox: Mailbox
    inbox: LoopEnd
    until_m: float
    poses: np.ndarray
    calibration: LiveCalibration | None = None

    def behind(self, observer: ModalObserver) -> LiveCalibration:
        """Return the calibration, behind this observer."""
        from hil.calibration.data_driven.live import LiveCalibration

        try:
            self.calibration = LiveCalibration(self.machine, self.start, observer, self.inbox, self.until_m, self.poses)
        except UnusableInputError as error:
            raise UnusableInputError(f"{self.source}: {error}") from None
        return self.calibration


def data_beside(
    machine: Machine,
    source: Path | None,
    until_mm: float,
    has_observer: bool,
    images: Path | None,
    rate_Hz: float,
    plans: Sequence[Plan],
    lockstep: bool,
) -> DataBeside | None:
    """Return what a live calibration starts from; None without a file.

    Raises
    ------
    UnusableInputError
        Options that do not belong together, or no calibration.
    """
    if source is None:
        if until_mm:
            raise UnusableInputError("--until: withdraws images from a live calibration; give --data FILE as well")
        return None
    import multiprocessing

    from hil.calibration.data_driven.data_file import read_data_file
    from hil.emulated.images import Exposures
    from hil.imaging.mailbox import LATE_S, LockstepEnd, LoopEnd, Mailbox

    if not has_observer or images is None:
        raise UnusableInputError("--data: takes the observer's estimate and images; give --observer FILE and --images DIR as well")
    mailbox = Mailbox(multiprocessing.get_context("spawn"), len(machine.axes))
    period_s = 1.0 / machine.sample_rate_Hz
    inbox: LoopEnd = LoopEnd(mailbox)
    if lockstep and 0.0 < rate_Hz < FASTEST_Hz:  # any other is refused with the images' options
        exposures = Exposures(rate_Hz)
        due_s = exposures.starts(len(plans[0].reference) * period_s) + exposures.width_s + LATE_S
        inbox = LockstepEnd(mailbox, due_s, period_s)
    reference = plans[0].reference
    poses = reference[:: max(1, len(reference) // ASKED)]
    return DataBeside(machine, read_data_file(source), source, mailbox, inbox, 1e-3 * until_mm, poses)


def keep_sightings(beside: DataBeside, images: Path) -> None:
    """Write what a replay needs into the images' folder, of an aborted run, too."""
    from hil.calibration.data_driven.live_file import SIGHTINGS, write_sightings

    if beside.calibration is not None and images.is_dir():
        write_sightings(beside.calibration, images / SIGHTINGS)


def leave(beside: DataBeside, images: Path, answer: Answer) -> dict[str, object]:
    """Write the geometry into the images' folder, and say how it went."""
    import numpy as np

    from hil.calibration.data_driven.live_file import GEOMETRY, write_live_geometry
    from hil.imaging.mailbox import POSES

    live = beside.calibration
    assert live is not None
    write_live_geometry(live, images / GEOMETRY)
    found = live.summary
    place = 1e3 * found["place_sigma_m"]
    left = ", ".join(f"{found[fate]} {said}" for fate, said in _LEFT.items() if found[fate])
    answer.say(f"{len(live.arrivals)} images seen live, {live.used} taken in{f'; {left}' if left else ''}; place known to {place:.3f} mm")
    if live.used:
        p50, p95, oldest = (1e3 * found["age_s"][name] for name in ("p50", "p95", "max"))
        answer.say(f"from exposure to use it took {p50:.0f} ms, of 95 % up to {p95:.0f} ms, at most {oldest:.0f} ms")
    if beside.inbox.skipped:
        answer.say(f"{beside.inbox.skipped} were not looked at, as a newer one was there: looking takes longer than images are apart")
    if beside.inbox.lost:
        answer.say(f"{beside.inbox.lost} more were seen and lost: the loop takes images in while it knows where the axes are, and did not")
    if beside.inbox.unplaced:
        kept_s = POSES / beside.machine.sample_rate_Hz
        answer.say(f"{beside.inbox.unplaced} more came later than {kept_s:.0f} s after their exposures, or show lost rows: not taken in")
    if live.withdrawn_after is not None:
        answer.say(f"images of the phantom were withdrawn after {live.withdrawn_after}")
    if found["change"]:
        answer.say("the machine stands elsewhere than it did; the mount was found anew")
    answer.say(f"{images / GEOMETRY}: geometry of {int(np.isfinite(live.live[:, 0]).sum())} samples")
    told = {"lost": beside.inbox.lost, "unplaced": beside.inbox.unplaced, "skipped": beside.inbox.skipped}
    return {**found, **told, "source": str(beside.source), "geometry": str(images / GEOMETRY)}


_LEFT = {"refused": "contradicted", "late": "came too late", "withdrawn": "not needed any more"}
