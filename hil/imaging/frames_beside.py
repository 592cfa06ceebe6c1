"""Images beside a run: the receiving process, on the emulator the panel's too, and the scan folder they become."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.synchronize import Event

import numpy as np

from hil.errors import UnusableInput
from hil.imaging import emulated_panel, receiver
from hil.imaging.emulated import positions_at
from hil.imaging.emulated_panel import PanelOrder
from hil.imaging.extra import imaging_package
from hil.imaging.receiver import STAMPS, TROUBLE, ReceiverOrder, received
from hil.imaging.scan_folder import FRAMES, write_description, write_exposures
from hil.machine import Machine
from hil.recording import Recording

POLITE = 10
"""Niceness of both processes: the loop comes first."""


@dataclass(frozen=True)
class ReceivedScan:
    """What came: exposures, the numbers skipped between them, and the panel's clock against the loop's, known to `doubt_ppm`."""

    exposures: int
    lost: tuple[int, ...]
    clock_ppm: float
    doubt_ppm: float
    residual_s: float


@contextmanager
def frames_beside(order: ReceiverOrder, panel: PanelOrder | None) -> Iterator[Callable[[], None]]:
    """Receive while the block runs; leave it when all frames are in. Yields what raises once frames cannot be received any more.

    Parameters
    ----------
    order : ReceiverOrder
    panel : PanelOrder, optional
        The emulated panel's; without it frames come from elsewhere.

    Raises
    ------
    UnusableInput
        No package for images, the folders cannot be made, one of them holds an earlier run's frames, or a process died.
    """
    imaging_package("tifffile", "images")
    try:
        for folder in (order.folder, *([panel.spool] if panel is not None else [])):
            folder.mkdir(parents=True, exist_ok=True)
        (order.folder / TROUBLE).unlink(missing_ok=True)
    except OSError as error:
        raise UnusableInput(f"{error.filename}: {error.strerror}") from None
    if (order.folder / FRAMES).exists():
        raise UnusableInput(f"{order.folder}: holds a scan's {FRAMES} already; receive into another folder")
    if not order.spool.is_dir():
        raise UnusableInput(f"{order.spool}: no folder; the panel's software must write its frames there")
    if any(order.spool.iterdir()):
        raise UnusableInput(f"{order.spool}: is not empty; the panel's folder must be when the run begins")
    if panel is not None:
        panel.truth.unlink(missing_ok=True)  # an earlier run's motion is not to be exposed
    context = multiprocessing.get_context("spawn")
    is_over, is_exposed = context.Event(), context.Event()
    started = [context.Process(target=_politely, args=(receiver.serve, order, is_exposed), daemon=True)]
    if panel is not None:
        started.append(context.Process(target=_politely, args=(emulated_panel.serve, panel, is_over), daemon=True))
    for process in started:
        process.start()

    def check() -> None:
        if not all(process.is_alive() for process in started):
            raise UnusableInput(_trouble(order) or f"a process that makes or receives frames ended early; {order.folder} is not whole")

    try:
        yield check
        is_over.set()
        for process in started[1:]:
            process.join()
            if process.exitcode:
                raise UnusableInput("the emulated panel's process ended before its images were made; its error stands above")
        is_exposed.set()
        started[0].join()
        if started[0].exitcode:
            raise UnusableInput(f"the process that receives frames ended early; its error stands above, {order.folder} is not whole")
    finally:
        for process in started:
            if process.is_alive():
                process.terminate()


def _trouble(order: ReceiverOrder) -> str:
    path = order.folder / TROUBLE
    return path.read_text(encoding="utf-8") if path.exists() else ""


def _politely(serve: Callable[..., None], order: object, is_over: Event) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what stops the run at the keyboard: the bench ends this process
    threading.Thread(target=_end_with_the_bench, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(POLITE)
    serve(order, is_over)


def _end_with_the_bench() -> None:
    """A bench that was killed says nothing more, and nobody else ends this process."""
    bench = multiprocessing.parent_process()
    if bench is not None:
        bench.join()
        os._exit(1)


def finished_scan(machine: Machine, order: ReceiverOrder, recording: Recording, notes: dict[str, object]) -> ReceivedScan:
    """Make the received frames a scan folder: starts in the loop's time, axis positions from the recording.

    Raises
    ------
    UnusableInput
        No frames, or frames from outside of the recording.
    ClocksDisagree
    """
    numbers, start_s, width_s, clock = received(order.folder, 1.0 / machine.sample_rate_Hz)
    write_description(order.folder, order.detector, machine.axes, {"machine": machine.name, "machine_hash": machine.hash, **notes})
    positions = positions_at(machine, recording, start_s + 0.5 * width_s)
    write_exposures(order.folder, numbers, start_s, width_s, {axis.axis: axis.position for axis in machine.units}, positions)
    (order.folder / STAMPS).unlink()
    lost = tuple(map(int, np.setdiff1d(np.arange(numbers[0], numbers[-1] + 1), numbers)))
    return ReceivedScan(len(numbers), lost, 1e6 * (1.0 / clock.rate - 1.0), 1e6 * clock.rate_doubt, clock.residual_s)
