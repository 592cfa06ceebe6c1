"""Ticks on the wall clock beside those of a bare python-can loop: emulator and loop in two processes, shaper, observer and damping on.

In each case the doctor predicts first. Then a bare loop, the bench, and a bare loop again exchange frames with the same emulator, the bench
for as long as both bare loops together, so that what else the computer does meets both alike. The bare loop sends SYNC at absolute times,
the same commands and heartbeats, and waits for the same answers; it computes nothing, records nothing and knows neither IMU nor I/O. A
whole tick lasts from when it is due until the loop is ready to wait again. Bench and bare loop have the same scheduler. Where there is a C
compiler, `peers/udp_loop.c` does as the bare loop does after all of them: the floor that kernel and emulator set. The machine file's
limits of lost ticks and stale positions are lifted, so that a stall of the host is counted instead of ending the run.

    python benchmarks/wall_clock.py --case quiet
    python benchmarks/wall_clock.py --case loaded
    python benchmarks/wall_clock.py --case fast

`quiet` and `loaded` run for ten minutes at 256 Hz, `loaded` beside eight processes that only compute, `fast` for a minute at 1 kHz. A case
replaces its own figures in the results only; of repeats they are those of the run with the middle ratio of 99.9 %, and the smallest and
the largest ratio. `stolen_share` is the processor time that the hypervisor gave to others meanwhile.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import can
import numpy as np
from can.interfaces.udp_multicast.utils import pack_message

from drivers.bus_url import open_bus
from drivers.settings import BusSettings
from drivers.ticking_machine import TickingMachine
from drivers.udp_bus import PYTHON_CAN_PORT
from hil.bench.clock import WallClock
from hil.experiments import Scan, Static
from hil.machine import Machine, load_machine, machine_from_text
from hil.machine.convert import converted_text
from hil.observing import observe, write_design
from hil.observing.simulated_recordings import emulated_recording
from hil.processes.real_time import real_time
from hil.recording import RecordingWarning, read_recording
from hil.verbs.observe import design_observer

ISOCENTER = [sys.executable, "-m", "hil"]
RESULTS = Path(__file__).parent / "results" / "wall_clock_udp.json"
BUS = "udp:239.74.163.95"
SPIN_S = 400e-6  # as the bench: before a tick a loop does not sleep
SWEEP = ("--axis", "roll", "--from", "20", "--to", "40", "--speed", "10", "--dwell", "0.5")
SWEEP_S = 3.6  # how long such a sweep takes, roughly
DAMPING = "0.05"
DOCTOR_S = 60.0
ANSWERED_SHARE = 0.95  # least share of ticks of the bare loop in which every node answers


@dataclass(frozen=True)
class Case:
    """One comparison."""

    rate_Hz: float
    seconds: float
    load: int = 0  # processes that compute all the time


CASES = {"quiet": Case(256.0, 600.0), "loaded": Case(256.0, 600.0, 8), "fast": Case(1000.0, 60.0)}


def prepared(rate_Hz: float, folder: Path) -> Path:
    """Return the machine file; beside it stand the observer and the shaper of its roll axis."""
    file = folder / f"carm_{rate_Hz:g}_Hz.toml"
    if file.exists():
        return file
    machine = load_machine("carm")
    if rate_Hz != machine.sample_rate_Hz:
        machine = machine_from_text(converted_text(machine, rate_Hz)[0])
    scan = emulated_recording(machine, Scan("roll", -0.5, 0.5, 0.5).plans(machine)[0], 60)
    design = design_observer(machine, tuned_on=[scan])
    write_design(design, folder / f"observer_{rate_Hz:g}_Hz.npz")
    still = emulated_recording(machine, Static(2.0).plans(machine)[0], 1)
    observe(still, design.observer())  # compiled before anything is timed
    text = re.sub(r"(?m)^(overrun|stale)_ticks = \d+", r"\1_ticks = 10000", machine.text)
    made = folder / "carm.toml"
    made.write_text(text, encoding="utf-8")
    shaper = folder / f"roll_{rate_Hz:g}_Hz.npz"
    subprocess.run([*ISOCENTER, "shape", str(made), "--axis", "roll", "-o", str(shaper)], check=True, capture_output=True)
    return made.rename(file)


@dataclass(frozen=True)
class Frames:
    """What a tick exchanges."""

    sync: can.Message
    beat: can.Message
    every: int  # ticks between heartbeats
    commands: list[can.Message]
    expected: set[int]  # identifiers of the answers to a SYNC


def frames_of(settings: BusSettings) -> Frames:
    """The frames of a bench that holds nothing."""
    return Frames(
        can.Message(arbitration_id=settings.sync_cob_id, is_extended_id=False),
        can.Message(arbitration_id=0x700 + settings.master_node_id, is_extended_id=False, data=[5]),
        max(1, int(settings.master_heartbeat_period_s / settings.sync_period_s)),
        [
            can.Message(arbitration_id=pdo.cob_id, is_extended_id=False, data=bytes(sum(bits for *_, bits in pdo.entries) // 8))
            for node in settings.nodes
            for pdo in node.rpdos
        ],
        {pdo.cob_id for node in settings.nodes for pdo in node.tpdos if pdo.transmission_type == 1},
    )


def c_loop(settings: BusSettings, seconds: float, folder: Path) -> dict[str, object] | None:
    """Have `peers/udp_loop.c` exchange the frames of a bench that holds nothing, for so long; None without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    program, frames = folder / "udp_loop", frames_of(settings)
    subprocess.run([compiler, "-O2", "-D_GNU_SOURCE", "-o", str(program), str(Path(__file__).parent / "peers" / "udp_loop.c")], check=True)
    bus = open_bus(BUS, settings.bitrate_bit_s)
    machine = TickingMachine(settings, bus, WallClock())
    ticks = round(seconds / settings.sync_period_s)
    times = [f"{1e9 * settings.sync_period_s:.0f}", str(ticks), f"{1e9 * settings.answer_timeout_s:.0f}", str(frames.every)]
    datagrams = [pack_message(frame).hex() for frame in (frames.sync, frames.beat, *frames.commands)]
    words = [BUS.removeprefix("udp:"), str(PYTHON_CAN_PORT), *times, ",".join(map(str, sorted(frames.expected))), *datagrams]
    machine.start()
    done = subprocess.run([str(program), *words], check=True, capture_output=True, text=True)
    machine.close()
    bus.shutdown()
    if int(done.stderr.split()[0]) < ANSWERED_SHARE * ticks:
        raise SystemExit(f"the C loop: {done.stderr.strip()}: no comparison")
    found = np.array([line.split() for line in done.stdout.splitlines()], float)
    return {"whole_s": 1e-9 * found[:, 0], "missed": int(found[:, 1].sum())}


def bare_loop(settings: BusSettings, seconds: float) -> dict[str, object]:
    """Exchange the frames of a bench that holds nothing, for so long; return whole ticks [s] and how many were missed."""
    bus = open_bus(BUS, settings.bitrate_bit_s)
    machine = TickingMachine(settings, bus, WallClock())
    frames = frames_of(settings)
    period_s, timeout_s = settings.sync_period_s, settings.answer_timeout_s
    ticks, missed = round(seconds / period_s), 0
    whole = []
    now = time.perf_counter
    answered = 0
    with real_time():
        machine.start()
        began_s, k = now(), 0
        while k < ticks:
            k += 1
            behind = int((now() - began_s) / period_s) - k
            if behind > 0:
                missed += behind
                k += behind
            due_s = began_s + k * period_s
            if (asleep_s := due_s - now() - SPIN_S) > 0.0:
                time.sleep(asleep_s)
            while now() < due_s:
                pass
            while bus.recv(0.0) is not None:
                pass
            bus.send(frames.sync)
            overdue_s, awaited = now() + timeout_s, set(frames.expected)
            while awaited and (message := bus.recv(max(0.0, overdue_s - now()))) is not None:
                awaited.discard(message.arbitration_id)
            answered += not awaited
            for command in frames.commands:
                bus.send(command)
            if k % frames.every == 0:
                bus.send(frames.beat)
            whole.append(now() - due_s)
    machine.close()
    bus.shutdown()
    if answered < ANSWERED_SHARE * len(whole):
        raise SystemExit(f"only {answered} of {len(whole)} SYNCs of the bare loop were answered in time: no comparison")
    return {"whole_s": np.array(whole), "missed": missed}


def bench(file: Path, folder: Path, seconds: float) -> dict[str, object]:
    """Sweep under shaper, observer and damping for so long; return the same of the bench, and its scheduler."""
    recorded, answer = folder / "run.mf4", folder / "answer.json"
    words = ["run", "scan", "-m", str(file), "-b", BUS, "--pose", "roll=20", *SWEEP, "--sweeps", str(max(1, round(seconds / SWEEP_S)))]
    rate = file.stem.removeprefix("carm_")
    words += ["--shaper", str(file.with_name(f"roll_{rate}.npz")), "--observer", str(file.with_name(f"observer_{rate}.npz"))]
    words += ["--damping", DAMPING]
    done = subprocess.run([*ISOCENTER, *words, "-o", str(recorded), "--json", str(answer)], check=False, capture_output=True, text=True)
    if not recorded.exists() or not answer.exists():
        raise SystemExit(done.stderr)
    said = json.loads(answer.read_text())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)  # missed ticks are counted
        recording = read_recording(recorded)
    whole = recording["sync_lateness"] + recording["work_time"]
    timing = said["recordings"][0]["timing"]
    return {"whole_s": whole[np.isfinite(whole)], "missed": timing["missed"], "scheduler": said["scheduler"]}


def doctor(file: Path, seconds: float) -> dict[str, float] | None:
    """Return what the doctor predicts for this machine, None where it says nothing."""
    words = [*ISOCENTER, "doctor", "-m", str(file), "--seconds", str(seconds), "--json", "-"]
    answer = subprocess.run(words, capture_output=True, text=True, check=False).stdout
    return json.loads(answer)["prediction"] if answer else None


def _compute(niceness: int) -> None:
    os.nice(niceness)
    while True:
        sum(range(10_000))


@contextlib.contextmanager
def load(processes: int, niceness: int = 0) -> Iterator[None]:
    """Run so many processes that only compute."""
    burning = [multiprocessing.get_context("spawn").Process(target=_compute, args=(niceness,), daemon=True) for _ in range(processes)]
    for process in burning:
        process.start()
    try:
        yield
    finally:
        for process in burning:
            process.kill()


def processor_times() -> tuple[int, int]:
    """Processor time stolen by the hypervisor, and all there was, since the computer was started; zeros where it does not say."""
    try:
        times = [int(cell) for cell in Path("/proc/stat").read_text().split("\n")[0].split()[1:9]]
    except (OSError, ValueError):
        return 0, 0
    return times[7], sum(times)


def figures(whole_s: np.ndarray, missed: int) -> dict[str, float]:
    """Percentiles [us] of whole ticks, and the ticks missed."""
    p50, p99, p999 = np.percentile(whole_s, [50.0, 99.0, 99.9]) * 1e6
    return {"ticks": len(whole_s), "missed": missed, "p50_us": p50, "p99_us": p99, "p99.9_us": p999, "max_us": whole_s.max() * 1e6}


def measure(case: Case, folder: Path, kept: Path) -> dict[str, object]:
    """Run one case, with machine file, observer and shaper from a folder where they are kept."""
    file = prepared(case.rate_Hz, kept)
    machine: Machine = load_machine(file)
    assert machine.bus is not None
    load_before, (stolen, all_of_it) = os.getloadavg(), processor_times()
    with load(case.load):
        predicted = doctor(file, min(DOCTOR_S, case.seconds))
        emulator = subprocess.Popen([*ISOCENTER, "emulate", str(file), "--bus", BUS], stdout=subprocess.PIPE, text=True)
        try:
            assert emulator.stdout is not None and emulator.stdout.readline(), "the emulator did not start"
            before = bare_loop(machine.bus, case.seconds / 2.0)
            ours = bench(file, folder, case.seconds)
            after = bare_loop(machine.bus, case.seconds / 2.0)
            in_c = c_loop(machine.bus, case.seconds / 2.0, folder)
        finally:
            emulator.terminate()
            emulator.wait()
    stolen, all_of_it = (now - then for now, then in zip(processor_times(), (stolen, all_of_it), strict=True))
    bare = figures(np.concatenate([before["whole_s"], after["whole_s"]]), before["missed"] + after["missed"])
    own = figures(ours["whole_s"], ours["missed"])
    return {
        "rate_Hz": case.rate_Hz,
        "seconds": case.seconds,
        "load_processes": case.load,
        "scheduler": ours["scheduler"],
        "processors": os.cpu_count(),
        "load_average_before": load_before[0],
        "kernel": platform.release(),
        "stolen_share": stolen / max(all_of_it, 1),
        "bench": own,
        "bare": bare,
        "in_c": None if in_c is None else figures(in_c["whole_s"], in_c["missed"]),
        "bare_before_p99.9_us": figures(before["whole_s"], 0)["p99.9_us"],
        "bare_after_p99.9_us": figures(after["whole_s"], 0)["p99.9_us"],
        "ratio_p99.9": own["p99.9_us"] / bare["p99.9_us"],
        "predicted": predicted,
    }


def of_repeats(runs: list[dict[str, object]]) -> dict[str, object]:
    """Return the run with the middle ratio, with the least and the greatest one beside it."""
    ratios = [float(str(run["ratio_p99.9"])) for run in runs]
    middle = runs[ratios.index(sorted(ratios)[(len(runs) - 1) // 2])]
    return {**middle, "repeats": len(runs), "smallest_ratio": min(ratios), "largest_ratio": max(ratios)}


def main() -> None:
    """Run cases and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", choices=CASES, action="append", help="this one; once for each")
    parser.add_argument("--seconds", type=float, help="instead of the case's own")
    parser.add_argument("--repeats", type=int, default=1, metavar="N", help="of each case")
    parser.add_argument("--prepared", type=Path, metavar="DIR", help="keep machine files, observers and shapers there for the next time")
    parser.add_argument("--json", type=Path, default=RESULTS, metavar="FILE")
    arguments = parser.parse_args()
    results = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
    for name in arguments.case or CASES:
        case = CASES[name]
        with tempfile.TemporaryDirectory() as folder:
            kept = arguments.prepared or Path(folder)
            kept.mkdir(parents=True, exist_ok=True)
            case = Case(case.rate_Hz, arguments.seconds or case.seconds, case.load)
            results[name] = of_repeats([measure(case, Path(folder), kept) for _ in range(arguments.repeats)])
        arguments.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
        print(name, json.dumps(results[name], indent=2))


if __name__ == "__main__":
    main()
