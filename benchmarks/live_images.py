"""Images beside the loop, on the wall clock: the phantom or a plate found and taken in at 30 frames a second beside the loop at 256 Hz.

    python benchmarks/live_images.py --work FOLDER [--json benchmarks/results/live_images.json] [--seconds 8] [--only NAME ...] [--again]

The emulated machine jogs its roll axis, on `udp:`, in a process of its own. Its panel is another, which sends frames that were made
beforehand over one period of the jog, each at the end of its exposure, at three binnings of the panel; a fast panel so. It waits until the
jog repeats itself, and exposes where the frames do. `isocenter run jog --observer --data --images` receives them. Every case without images
beside it is the pair: the same loop with the same observer. Under load two processes compute all the time, with the lowest priority. FOLDER
keeps frames, observer and first calibration. Cases that the result holds already are left out: it goes on where it was ended. Shares in
time are of this machine with what else it does: imaging_speed.py has processor time.

A tick that the loop loses delays the jog by one row, while the panel goes on by the machine's time: from then on the frames show the
machine elsewhere than it is. The phantom's images say so (change), and one whose rows were lost has no place (unplaced).

An image's age is from the middle of its exposure to the row that takes it in. It is in time where it is taken in before the middle of the
next exposure.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import re
import select
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from wall_clock import load

from drivers.bus_url import open_bus
from drivers.imaging.panel_link import HEADER, MARK, end_bytes, read_command
from hil.calibration.data_driven.live_file import SIGHTINGS
from hil.emulated.beam import beam_of
from hil.emulated.card import EmulatorCard, published
from hil.emulated.images import xray_side
from hil.emulated.machine import build_emulated
from hil.emulated.panel import PANEL_EPOCH_S
from hil.emulated.pose_board import PoseBoard
from hil.experiments import Scan, Static
from hil.imaging.nominal import nominal_detector
from hil.imaging.scan_folder import read_scan
from hil.machine import load_machine
from hil.observing import observe, read_design, write_design
from hil.observing.simulated_recordings import emulated_recording
from hil.processes.real_time import real_time
from hil.processes.second_in_line import politely
from hil.processes.workers import end_with_the_parent
from hil.recording import RecordingWarning, read_recording
from hil.verbs.observe import design_observer
from virtual_bus.emulator import Ports, run_emulator

ISOCENTER = [sys.executable, "-m", "hil"]
RESULTS = Path(__file__).parent / "results" / "live_images.json"
BUS = "udp:239.74.163.83"
RATE_Hz, WIDTH_S = 30.0, 0.008
PERIOD_S, FRAMES = 3.0, 90
"""Of the jog, and the frames that one period takes at this rate."""

STARTS, AMPLITUDE_DEG, JOGS = "propeller=0,roll=20", 2.0, "roll"
REPEATS_WITHIN_S = 2e-3
"""The jog has settled where two periods differ by less."""

PATIENT = {"overrun_ticks": "10000", "stale_ticks": "10000"}
BUSY, LOWEST = 2, 19
LOOKS_EVERY_S = 5e-4
PANEL_PRIORITY = 10


@dataclass(frozen=True)
class Case:
    """A run: what is in the beam (nothing: no images), how the panel is read, and whether others compute beside it."""

    scene: str = ""
    binning: int = 2
    loaded: bool = False

    @property
    def name(self) -> str:
        """As in the result."""
        where = ", loaded" if self.loaded else ""
        return f"{self.scene}, binning {self.binning}{where}" if self.scene else f"no images{where}"


SCENES = ("dodecahedron", "clinical", "experimental")
CASES = (
    Case(),
    *(Case(scene) for scene in SCENES),
    Case(loaded=True),
    *(Case(scene, loaded=True) for scene in SCENES),
    *(Case(scene, binning) for binning in (4, 1) for scene in SCENES),
)


def command(*words: object) -> None:
    """Run a command of the project; its own error stands above where it fails."""
    if subprocess.run([*ISOCENTER, *map(str, words)], check=False, stdout=subprocess.DEVNULL).returncode:
        raise SystemExit(f"isocenter {' '.join(map(str, words))}: failed")


def prepared(work: Path) -> tuple[Path, Path, Path]:
    """Return machine file, observer and a first calibration."""
    file, observer, known = work / "carm.toml", work / "observer.npz", work / "known.npz"
    machine = load_machine("carm")
    if not observer.exists():
        scan = emulated_recording(machine, Scan("roll", -0.5, 0.5, 0.5).plans(machine)[0], 60)
        write_design(design_observer(machine, tuned_on=[scan]), observer)
    observe(emulated_recording(machine, Static(2.0).plans(machine)[0], 1), read_design(observer).observer())  # compiled
    if not known.exists():
        sweep = ["--axis", "roll", "--from", 10, "--to", 30, "--speed", 5, "--dwell", "0.5", "--image-rate", 2, "--image-binning", 8]
        shutil.rmtree(work / "tour", ignore_errors=True)
        command("run", "scan", "-m", "carm", "-b", "lockstep:", *sweep, "--images", work / "tour", "-o", work / "tour.mf4")
        command("calibrate", "data", "carm", work / "tour.mf4", work / "tour", "--design", observer, "-o", known)
    text = machine.text
    for key, value in PATIENT.items():
        text = re.sub(rf"(?m)^{key} = \d+", f"{key} = {value}", text)
    file.write_text(text, encoding="utf-8")
    return file, observer, known


def made(work: Path, scene: str, binning: int) -> Path:
    """Return the file of frames (FRAMES, rows, columns) over one period of the jog, and of the tube's places (FRAMES, 3)."""
    file, truth = work / f"{scene}_{binning}.npz", work / "jog.truth.csv"
    if file.exists():
        return file
    machine = load_machine("carm")
    if not truth.exists():
        command("run", "jog", "-m", "carm", "-b", "lockstep:", *jogging(3 * PERIOD_S), "--truth", truth, "-o", work / "jog.mf4")
    beam, rng, detector = beam_of(machine, scene), np.random.default_rng(0), nominal_detector(machine, binning)
    side = xray_side(machine, truth, beam.spot, 0.1)
    middle_s = PERIOD_S + np.arange(FRAMES) / RATE_Hz
    frames = [beam.image(side, middle - 0.5 * WIDTH_S, WIDTH_S, detector, rng) for middle in middle_s]
    np.savez(file, frames=np.array(frames), tube_m=side.tube(middle_s)[0])
    return file


def jogging(seconds: float) -> list[object]:
    """Return the words that make the machine jog so long."""
    how = ["--axes", JOGS, "--amplitude", AMPLITUDE_DEG, "--period", PERIOD_S, "--periods", round(seconds / PERIOD_S)]
    return ["--pose", STARTS, *how]


class Passage:
    """When the tube passes the first frame's place, going as it went there."""

    def __init__(self, board: PoseBoard, tube_m: np.ndarray) -> None:
        self._board, self._place_m = board, tube_m[0]
        self._forward = (tube_m[1] - tube_m[-1]) / np.linalg.norm(tube_m[1] - tube_m[-1])

    def settled_s(self) -> float | None:
        """Return the last time, where the time before was a period earlier; None where the jog has not settled."""
        now_s = self._board.now_s
        span = self._board.around(now_s - 1.2 * PERIOD_S, now_s, 0) if np.isfinite(now_s) else None
        if span is None or len(span.time_s) < 2:
            return None
        ahead = (span.tube[:, :3] - self._place_m) @ self._forward
        passed = np.flatnonzero((ahead[:-1] < 0.0) & (ahead[1:] >= 0.0))
        if len(passed) < 2:
            return None
        share = ahead[passed] / (ahead[passed] - ahead[passed + 1])
        times = span.time_s[passed] + share * np.diff(span.time_s)[passed]
        return float(times[-1]) if abs(times[-1] - times[-2] - PERIOD_S) < REPEATS_WITHIN_S else None


def _panel(board: PoseBoard, file: str, ready: Connection) -> None:
    """Serve the frames of a file to one host: each at the end of its exposure."""
    with np.load(file) as made_before:
        frames, passage = made_before["frames"].astype("<u2"), Passage(board, made_before["tube_m"])
    with contextlib.suppress(PermissionError):  # a device of its own: punctual, but after the loop
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PANEL_PRIORITY))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        ready.send(listener.getsockname()[1])
        while True:
            caller, _ = listener.accept()
            with caller, contextlib.suppress(ConnectionError):
                caller.sendall(end_bytes(0))
                _exposures(caller, board, frames, passage)


def _exposures(caller: socket.socket, board: PoseBoard, frames: np.ndarray, passage: Passage) -> None:
    first_s, count, said, is_asked = np.inf, 0, b"", False
    while True:
        if is_asked and np.isinf(first_s) and (passed_s := passage.settled_s()) is not None:
            first_s = passed_s + PERIOD_S - 0.5 * WIDTH_S
        start_s = first_s + count / RATE_Hz
        if board.now_s >= start_s + WIDTH_S and (span := board.around(start_s, start_s + WIDTH_S, 0)) is not None:
            sync = int(span.sync[np.searchsorted(span.time_s, start_s)])
            frame = frames[count % len(frames)]
            caller.sendall(HEADER.pack(MARK, count, *frame.shape, sync, PANEL_EPOCH_S + start_s, WIDTH_S))
            caller.sendall(frame.data.cast("B"))
            count += 1
        if not select.select([caller], [], [], LOOKS_EVERY_S)[0]:
            continue
        data = caller.recv(4096)
        if not data:
            return
        said += data
        while b"\n" in said:
            line, _, said = said.partition(b"\n")
            if read_command(line) is None:
                caller.sendall(end_bytes(count))
                is_asked = False
            else:
                is_asked, count = True, 0
            first_s = np.inf


def _emulate(machine_file: str, file: str, scene: str, ready: Connection) -> None:
    """Emulate machine and panel, until this process is ended."""
    end_with_the_parent()
    machine = load_machine(machine_file)
    context = multiprocessing.get_context("spawn")
    board = PoseBoard(context)
    url = ""
    if file:
        ours, theirs = context.Pipe(duplex=False)
        context.Process(target=politely, args=(_panel, board, file, theirs), daemon=True).start()
        url = f"tcp:127.0.0.1:{ours.recv()}"
    pose = dict(part.split("=") for part in STARTS.split(","))
    start = np.radians([float(pose[axis]) for axis in machine.axes])
    assert machine.bus is not None
    with contextlib.ExitStack() as stack, open_bus(BUS, machine.bus.bitrate_bit_s) as bus:

        def tell(ports: Ports) -> None:
            stack.enter_context(published(EmulatorCard(BUS, os.getpid(), ports.imu_url, ports.io_url, url, scene if url else "")))
            ready.send("ready")

        emulated = build_emulated(machine, start, seed=3, board=board)
        with real_time():
            run_emulator(bus, emulated, tell)


@contextlib.contextmanager
def emulated(machine_file: Path, file: Path | None, scene: str) -> Iterator[None]:
    """Emulate machine and panel beside the block."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_emulate, args=(str(machine_file), "" if file is None else str(file), scene, theirs))
    process.start()
    try:
        ours.recv()
        yield
    finally:
        process.terminate()
        process.join()


def measure(case: Case, work: Path, seconds: float) -> dict[str, object]:
    """Run one case."""
    machine_file, observer, known = prepared(work)
    file = made(work, case.scene, case.binning) if case.scene else None
    busy = load(BUSY if case.loaded else 0, LOWEST)
    with tempfile.TemporaryDirectory(dir=work) as scratch, busy, emulated(machine_file, file, case.scene):
        images, recorded, told = (Path(scratch) / name for name in ("images", "run.mf4", "run.json"))
        words = ["run", "jog", "-m", machine_file, "-b", BUS, *jogging(seconds), "--observer", observer]
        if case.scene:
            words += ["--data", known, "--images", images, "--scene", case.scene]
            words += ["--image-rate", RATE_Hz, "--image-binning", case.binning]
        command(*words, "-o", recorded, "--json", told)
        answer = json.loads(told.read_text(encoding="utf-8"))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)  # missed ticks are counted
            recording = read_recording(recorded)
        sightings = dict(np.load(images / SIGHTINGS)) if case.scene else None
        exposures = int(read_scan(images).exposure_id[-1]) + 1 if case.scene else 0
    whole = recording["sync_lateness"] + recording["work_time"]
    p50, p99, p999 = np.percentile(whole[np.isfinite(whole)] * 1e6, [50.0, 99.0, 99.9])
    ticks = {"ticks": recording.rows, "missed": answer["recordings"][0]["timing"]["missed"], "p50_us": p50, "p99_us": p99, "p99.9_us": p999}
    result: dict[str, object] = {"scheduler": answer["scheduler"], "processors": os.cpu_count(), "tick": ticks}
    if sightings is not None:
        age_s = sightings["row"] / load_machine("carm").sample_rate_Hz - sightings["time_s"]
        taken = np.isin(sightings["fate"], ["used", "change"])
        fates = {name: answer["calibration"][name] for name in ("used", "change", "refused", "late", "skipped", "unplaced", "lost")}
        in_time = float(np.sum(age_s[taken] < 1.0 / RATE_Hz)) / exposures
        age_ms = (
            dict(zip(("p50", "p95", "max"), np.percentile(1e3 * age_s[taken], [50.0, 95.0, 100.0]), strict=True)) if taken.any() else {}
        )
        result["images"] = {"exposures": exposures, **fates, "in_time": in_time, "age_ms": age_ms}
    return result


def main() -> None:
    """Run the cases that are missing, and write the result after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", metavar="FOLDER", type=Path, required=True, help="keeps what is made beforehand")
    parser.add_argument("--json", metavar="FILE", type=Path, default=RESULTS)
    parser.add_argument("--seconds", type=float, default=8.0, help="of each run")
    parser.add_argument("--only", metavar="NAME", nargs="+", choices=[case.name for case in CASES], help="these cases")
    parser.add_argument("--again", action="store_true", help="the cases that the result holds, too")
    parser.add_argument("--prepare", action="store_true", help="make frames, observer and calibration, and measure nothing")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    cases = [case for case in CASES if options.only is None or case.name in options.only]
    prepared(options.work)
    for case in cases:
        if case.scene:
            made(options.work, case.scene, case.binning)
    if options.prepare:
        return
    results = json.loads(options.json.read_text(encoding="utf-8")) if options.json.exists() else {}
    for case in cases:
        if case.name in results and not options.again:
            continue
        began_s = time.monotonic()
        results[case.name] = {"load_average": os.getloadavg()[0]} | measure(case, options.work, options.seconds)
        options.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        print(f"{case.name} ({time.monotonic() - began_s:.0f} s)", json.dumps(results[case.name]), flush=True)


if __name__ == "__main__":
    main()
