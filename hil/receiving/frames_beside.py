"""Images beside a run: the receiving process, on the emulator the panel's too, and the scan folder they become."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np

from drivers.imaging import PanelLink
from hil.emulated import panel as emulated_panel
from hil.emulated.images import positions_at
from hil.emulated.panel import PanelOrder
from hil.errors import BadAnswerError, UnusableInputError
from hil.extras import extra_package
from hil.imaging.scan_folder import FRAMES, write_description, write_exposures
from hil.machine import Machine
from hil.processes.second_in_line import POLITE, PROMPT, politely
from hil.receiving import receiver
from hil.receiving.panel_frames import RemotePanel
from hil.receiving.receiver import STAMPS, TROUBLE, ReceiverOrder, received
from hil.recording import Recording

READY_ASKED_S = 0.2


@dataclass(frozen=True)
class ReceivedScan:
    """The result: exposures, numbers skipped between them, and the panel's clock against the loop's, known to `doubt_ppm`."""

    exposures: int
    lost: tuple[int, ...]
    clock_ppm: float
    doubt_ppm: float
    residual_s: float


@contextmanager
def frames_beside(order: ReceiverOrder, panel: PanelOrder | None, say: Callable[[str], None] | None = None) -> Iterator[Callable[[], None]]:
    """Receive while the block runs; leave it when all frames are in.

    Yields a function that raises once frames cannot be received any more.

    Parameters
    ----------
    order : ReceiverOrder
    panel : PanelOrder, optional
        The emulated panel's; without it frames come from elsewhere.
    say : callable, optional
        Told at once, by a thread of its own, when no more images come while the block runs.

    Raises
    ------
    UnusableInputError
        No package for images, the folders cannot be made, or one of them holds an earlier run's frames.
    BusUnavailableError
        No such panel, or another host's.
    BadAnswerError
        A process died.
    """
    extra_package("tifffile", "images")
    if isinstance(order.panel, RemotePanel):
        PanelLink(order.panel.url, order.panel.period_s).close()  # is it there, and nobody else's?
    try:
        for each in (order.folder, *([panel.spool] if panel is not None else [])):
            each.mkdir(parents=True, exist_ok=True)
        (order.folder / TROUBLE).unlink(missing_ok=True)
    except OSError as error:
        raise UnusableInputError(f"{error.filename}: {error.strerror}") from None
    if (order.folder / FRAMES).exists():
        raise UnusableInputError(f"{order.folder}: holds a scan's {FRAMES} already; receive into another folder")
    if isinstance(order.panel, Path):
        _must_be_empty(order.panel)
    if panel is not None:
        panel.truth.unlink(missing_ok=True)  # an earlier run's motion is not to be exposed
    context = multiprocessing.get_context("spawn")
    is_over, is_exposed, is_ready = context.Event(), context.Event(), context.Event()
    niceness = {"niceness": POLITE if order.live is None else PROMPT}
    started = [context.Process(target=politely, args=(receiver.serve, order, is_exposed, is_ready), kwargs=niceness, daemon=True)]
    if panel is not None:
        started.append(context.Process(target=politely, args=(emulated_panel.serve, panel, is_over), daemon=True))
    for process in started:
        process.start()
    is_left = threading.Event()

    def check() -> None:
        if not all(process.is_alive() for process in started):
            raise BadAnswerError(_trouble(order) or f"a process that makes or receives frames ended early; {order.folder} is not whole")

    try:
        while not is_ready.wait(READY_ASKED_S):  # the first run compiles; a loop would not wait for it
            check()
        if say is not None:
            threading.Thread(target=_say_if_one_ends, args=(order, started, is_left, say), daemon=True).start()
        try:
            yield check
        finally:
            is_left.set()
        is_over.set()
        for process in started[1:]:
            process.join()
            if process.exitcode:
                raise BadAnswerError("the emulated panel's process ended before its images were made; its error stands above")
        is_exposed.set()
        started[0].join()
        if started[0].exitcode:
            raise BadAnswerError(f"the process that receives frames ended early; its error stands above, {order.folder} is not whole")
    finally:
        for process in started:
            if process.is_alive():
                process.terminate()


def _say_if_one_ends(order: ReceiverOrder, started: Sequence[BaseProcess], is_left: threading.Event, say: Callable[[str], None]) -> None:
    """Wait for the processes, which should end only once the block is left."""
    wait([process.sentinel for process in started])
    if not is_left.is_set():
        say(f"{_trouble(order) or 'the process that receives frames ended'}: no more images; the run goes on without")


def _must_be_empty(panel: Path) -> None:
    """Refuse a folder that is not empty, before anything moves."""
    if not panel.is_dir():
        raise UnusableInputError(f"{panel}: no folder; the panel's software must write its frames there")
    if any(panel.iterdir()):
        raise UnusableInputError(f"{panel}: is not empty; the panel's folder must be when the run begins")


def _trouble(order: ReceiverOrder) -> str:
    path = order.folder / TROUBLE
    return path.read_text(encoding="utf-8") if path.exists() else ""


def finished_scan(machine: Machine, order: ReceiverOrder, recording: Recording, notes: dict[str, object]) -> ReceivedScan:
    """Make the received frames a scan folder: starts in the loop's time, axis positions from the recording.

    Raises
    ------
    BadAnswerError
        No frames, or the receiver ran into something.
    UnusableInputError
        Frames from outside of the recording.
    ClocksDisagreeError
    """
    period_s = 1.0 / machine.sample_rate_Hz
    numbers, start_s, width_s, clock = received(order.folder, period_s)
    if not isinstance(order.panel, Path):  # one SYNC a row: later than by their count by the ticks that were lost
        start_s = np.interp(start_s, period_s * np.arange(recording.rows), recording.time)
    write_description(order.folder, order.detector, machine.axes, {"machine": machine.name, "machine_hash": machine.hash, **notes})
    positions = positions_at(machine, recording, start_s + 0.5 * width_s)
    write_exposures(order.folder, numbers, start_s, width_s, {axis.axis: axis.position for axis in machine.units}, positions)
    (order.folder / STAMPS).unlink()
    lost = tuple(map(int, np.setdiff1d(np.arange(numbers[0], numbers[-1] + 1), numbers)))
    return ReceivedScan(len(numbers), lost, 1e6 * (1.0 / clock.rate - 1.0), 1e6 * clock.rate_doubt, clock.residual_s)
