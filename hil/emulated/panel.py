"""The emulated panel as a separate process: it follows the machine's true motion as it happens and writes frames into a spool folder.

It reads the truth file line by line as the emulator writes it: an exposure is made once the motion is known beyond its end. Its clock is
set to another time than the loop's and runs 20 ppm fast.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np

from drivers.imaging import Frame, write_frame
from hil.emulated.beam import Beam
from hil.emulated.images import Exposures, xray_side
from hil.imaging.detector import Detector
from hil.machine import Machine

PANEL_EPOCH_S = 5000.0
"""Time of the panel's clock when the loop's is 0."""

LOOKS_EVERY_S = 0.05
BEYOND_S = 0.05
"""Time after an exposure's end up to which the motion must be known, because it is interpolated between samples."""


@dataclass(frozen=True)
class PanelOrder:
    """Arguments of the process.

    Attributes
    ----------
    machine : Machine
        The emulated machine.
    truth, spool : Path
    exposures : Exposures
    beam : Beam
    detector : Detector
    seed : int
    """

    machine: Machine
    truth: Path
    spool: Path
    exposures: Exposures
    beam: Beam
    detector: Detector
    seed: int


def serve(order: PanelOrder, is_over: Event) -> None:
    """Expose until the run is over and all of its motion has been read."""
    machine = order.machine
    rng, made, seen = np.random.default_rng(order.seed), 0, 0
    period = 1.0 / machine.sample_rate_Hz
    rate = 1.0 + 1e-6 * order.exposures.clock_ppm
    whole = order.spool / "known.csv"
    while True:
        over = is_over.is_set()
        text = order.truth.read_text(encoding="utf-8") if order.truth.exists() else ""
        known = text[: text.rfind("\n") + 1]
        lines = known.count("\n")
        if lines > 10 and (lines > seen or over):
            seen = lines
            whole.write_text(known, encoding="utf-8")
            side = xray_side(machine, whole, order.beam.spot, order.exposures.first_s)
            ahead = 0.0 if over else BEYOND_S
            for start in order.exposures.starts(side.panel.last_s - ahead)[made:]:
                width = order.exposures.width_s
                image = order.beam.image(side, float(start), width, order.detector, rng)
                pulse = period * np.ceil(start / period)
                stamp = PANEL_EPOCH_S + start * rate
                write_frame(order.spool, Frame(made, stamp, width * rate, float(pulse), image))
                made += 1
        elif not over:
            time.sleep(LOOKS_EVERY_S)
        if over:  # the truth file was complete before it was read
            whole.unlink(missing_ok=True)
            return
