"""The emulated panel on a network port: `isocenter emulate --panel SCENE`, a process beside the emulated machine's.

It follows the machine's true motion SYNC by SYNC through shared memory, exposes by its own clock when it is told to, and sends each frame
with the count of the SYNC at which the exposure's pulse was seen. The machine never waits for it: images that take long come late.
"""

from __future__ import annotations

import multiprocessing
import select
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np

from drivers.imaging import PanelError
from drivers.imaging.panel_link import end_bytes, frame_bytes, read_command
from hil.emulated.beam import Beam, beam_of
from hil.emulated.images import Exposures
from hil.emulated.panel import BEYOND_S, PANEL_EPOCH_S
from hil.emulated.pose_board import PoseBoard, PoseSpan
from hil.errors import UnusableInputError
from hil.imaging.nominal import imaging_geometry, nominal_detector
from hil.machine import Machine
from hil.processes.second_in_line import politely
from virtual_bus.xray.motion import PoseTrack, XraySide

LOOKS_EVERY_S = 0.01
"""Time to listen for a command before the machine is checked again."""

AROUND = 8
"""SYNCs on either side of an exposure through which its motion is interpolated."""

STANDS_S = 1.0
"""Time without a SYNC after the command to stop: the machine's time then stands still, and a begun exposure will not end."""

FIRST_AFTER_S = 0.1
"""Time from the command to the first exposure, in which a generator runs its anode up."""

READ_BYTES = 4096
SEED = 0


@dataclass(frozen=True)
class ServedPanel:
    """Arguments of the process: the emulated machine, the board with its poses, and the objects in the beam."""

    machine: Machine
    board: PoseBoard
    beam: Beam


@contextmanager
def panel_beside(machine: Machine, board: PoseBoard, scene_name: str) -> Iterator[str]:
    """Serve the panel while the block runs; yield its URL.

    Raises
    ------
    UnusableInputError
        The machine has no [geometry], the scene does not exist, or the process did not start.
    """
    imaging_geometry(machine)
    order = ServedPanel(machine, board, beam_of(machine, scene_name))
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=politely, args=(serve, order, theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        try:
            port = ours.recv()
        except EOFError:
            raise UnusableInputError("the emulated panel's process did not start; its error stands above") from None
        yield f"tcp:127.0.0.1:{port}"
    finally:
        ours.close()
        process.terminate()
        process.join()


def serve(order: ServedPanel, ready: Connection) -> None:
    """Serve one host after the other without end."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        ready.send(listener.getsockname()[1])
        while True:
            caller, _ = listener.accept()
            with caller:
                try:
                    _Acquisition(order, caller).serve()
                except ConnectionError:
                    continue  # the host is gone
                except (OSError, PanelError, UnusableInputError) as error:
                    print(f"panel: {error}", file=sys.stderr, flush=True)


class _Acquisition:
    """The exposures for one host."""

    def __init__(self, order: ServedPanel, caller: socket.socket) -> None:
        self._order, self._caller = order, caller
        self._geometry = imaging_geometry(order.machine)
        self._said = b""
        self._exposures: Exposures | None = None
        self._made, self._until_s = 0, np.inf
        self._ahead_s = max(BEYOND_S, (AROUND + 1) * order.machine.plant.sample_period_s)
        self._newest_s, self._newest_at_s = -np.inf, time.monotonic()

    def serve(self) -> None:
        """Serve until the host hangs up."""
        self._caller.sendall(end_bytes(0))
        while self._listen(0.0 if self._work() else LOOKS_EVERY_S):
            pass

    def _listen(self, seconds: float) -> bool:
        """Take commands; return whether the host is still connected."""
        if not select.select([self._caller], [], [], seconds)[0]:
            return True
        data = self._caller.recv(READ_BYTES)
        self._said += data
        while b"\n" in self._said:
            line, _, self._said = self._said.partition(b"\n")
            asked = read_command(line)
            now_s = self._order.board.now_s
            if not np.isfinite(now_s):
                raise PanelError("the machine has had no SYNC yet, by which exposures are counted")
            if asked is None:
                self._until_s = now_s
                continue
            self._exposures = Exposures(asked[0], first_s=now_s + FIRST_AFTER_S)
            self._detector = nominal_detector(self._order.machine, asked[1])
            self._made, self._until_s, self._rng = 0, np.inf, np.random.default_rng(SEED)
        return bool(data)

    def _work(self) -> bool:
        """Send the next frame, or the end, if it is due; return whether it was."""
        exposures = self._exposures
        if exposures is None:
            return False
        start_s = exposures.start(self._made)
        end_s = start_s + exposures.width_s
        is_known = end_s + self._ahead_s <= self._order.board.now_s
        if start_s > self._until_s or (not is_known and np.isfinite(self._until_s) and self._stands_still()):
            self._caller.sendall(end_bytes(self._made))
            self._exposures = None
            return True
        if not is_known:
            return False
        span = self._order.board.around(start_s, end_s, AROUND)
        if span is not None:  # otherwise it is too late for this image, which is lost
            self._send(exposures, start_s, span)
        self._made += 1
        return True

    def _stands_still(self) -> bool:
        now_s, at_s = self._order.board.now_s, time.monotonic()
        if now_s != self._newest_s:
            self._newest_s, self._newest_at_s = now_s, at_s
        return at_s - self._newest_at_s > STANDS_S

    def _send(self, exposures: Exposures, start_s: float, span: PoseSpan) -> None:
        side = self._side(span, exposures.first_s)
        image = self._order.beam.image(side, start_s, exposures.width_s, self._detector, self._rng)
        rate = 1.0 + 1e-6 * exposures.clock_ppm
        pulse = int(span.sync[np.searchsorted(span.time_s, start_s)])
        self._caller.sendall(frame_bytes(self._made, pulse, PANEL_EPOCH_S + start_s * rate, exposures.width_s * rate, image))

    def _side(self, span: PoseSpan, hot_since_s: float) -> XraySide:
        geometry = self._geometry

        def track(poses: np.ndarray) -> PoseTrack:
            return PoseTrack(span.time_s, poses[:, :3] - geometry.isocenter_m, poses[:, 3:].reshape(-1, 3, 3))

        ends = geometry.source_position_m, geometry.detector_center_m
        return XraySide(track(span.tube), track(span.panel), *ends, self._order.beam.spot, hot_since_s)
