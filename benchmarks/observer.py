"""How long the observer takes: one step of it beside filterpy and NumPy, and whole ticks of a run with feedback, shaper and UKF.

    python benchmarks/observer.py --json -                                  the filters' steps
    python benchmarks/observer.py --design carm.observer.npz --bus udp:     and whole ticks: two processes, and lockstep at 1 kHz

filterpy and NumPy run on a linear model of the same size, whose transition and outputs cost them one product of matrices a sigma point: the
filters' own arithmetic is what is compared. Medians of single calls, and the fastest tenth, on whatever else the machine is doing.

A whole tick is `work_time`: from the SYNC until the loop is ready to wait again, the devices' answers (`answer_time`) included. In lockstep
the emulated machine is computed in the tick, too. The shaper's share is measured apart, and not in the tick: a run shapes its reference
before it starts, with the filter's own steps.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from observed_models import small_model, small_noise

from controllers.damping import DampingSettings, ModalDamping
from controllers.loop_shaping import cascade, gain, lag, lead, notch
from controllers.observers.modal_observer import ModalObserver, filter_rows
from controllers.shapers.filter import ReferenceShaper
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Scan
from hil.machine import Machine, load_machine
from hil.machine.load import machine_from_text
from hil.observing import ObserverDesign, read_design
from hil.observing.live import LiveObserver
from hil.shaping.shaper_file import ShaperFile, read_shaper

STEPS = 4000
ISOCENTER = [sys.executable, "-m", "hil"]
SWEEP_deg = 60.0
SPEED_deg_s = 30.0
FAST_Hz = 1000.0


def timed(call: Callable[[], object], steps: int = STEPS) -> dict[str, float]:
    """Microseconds a call: median, fastest tenth, slowest hundredth."""
    for _ in range(max(20, steps // 20)):
        call()
    seconds = np.zeros(steps)
    for k in range(steps):
        began = time.perf_counter()
        call()
        seconds[k] = time.perf_counter() - began
    p10, p50, p99 = np.percentile(seconds, [10.0, 50.0, 99.0]) * 1e6
    return {"p10_us": float(p10), "p50_us": float(p50), "p99_us": float(p99)}


def compiled(kind: str, adapted: tuple[int, ...] = ()) -> tuple[dict[str, float], dict[str, float]]:
    """The filter alone, and the whole step with everything that is published."""
    observer = ModalObserver(small_model(), small_noise(adapted_walk=1e-4), kind, adapted)  # type: ignore[arg-type]
    z, u = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.81, 0.0, 0.0, 0.0]), np.zeros(2)
    observer.step_measured(z, u)
    inside = observer.constants, observer._scheduled, observer.memory
    acted, measured = u[None], z[None]
    alone = timed(lambda: filter_rows(*inside, observer._kind, False, acted, measured, observer._summary))
    return alone, timed(lambda: observer.step_measured(z, u))


def filterpys(states: int, measurements: int) -> dict[str, float]:
    """filterpy's UKF on a linear model."""
    F, H = _linear(states, measurements)
    ukf = UnscentedKalmanFilter(
        states, measurements, 1.0, hx=lambda x: H @ x, fx=lambda x, _: F @ x, points=JulierSigmaPoints(states, kappa=0.0)
    )
    ukf.Q, ukf.R = 0.1 * np.eye(states), np.eye(measurements)
    z = np.zeros(measurements)

    def step() -> None:
        ukf.predict()
        ukf.update(z)

    return timed(step, 500)


def numpys(states: int, measurements: int) -> dict[str, float]:
    """A UKF of covariances, all sigma points in one array."""
    F, H = _linear(states, measurements)
    Q, R, z = 0.1 * np.eye(states), np.eye(measurements), np.zeros(measurements)
    held = {"x": np.zeros(states), "P": np.eye(states)}

    def step() -> None:
        x, P = held["x"], held["P"]
        root = np.linalg.cholesky(states * P).T
        points = np.concatenate((x + root, x - root)) @ F.T
        x = points.mean(axis=0)
        away = points - x
        P = away.T @ away / len(points) + Q
        root = np.linalg.cholesky(states * P).T
        points = np.concatenate((x + root, x - root))
        seen = points @ H.T
        mean = seen.mean(axis=0)
        away, seen = points - x, seen - mean
        S, C = seen.T @ seen / len(points) + R, away.T @ seen / len(points)
        K = np.linalg.solve(S, C.T).T
        held["x"], held["P"] = x + K @ (z - mean), P - K @ S @ K.T

    return timed(step, 2000)


def _linear(states: int, measurements: int) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(0)
    return 0.99 * np.linalg.qr(generator.normal(size=(states, states)))[0], generator.normal(size=(measurements, states))


def shaper_step(machine: Machine, file: ShaperFile) -> dict[str, float]:
    """One sample of the reference shaper."""
    running = ReferenceShaper(machine.axes, file.shapers, machine.limits, machine.sample_rate_Hz)
    raw, out = np.zeros(len(machine.axes)), np.zeros(len(machine.axes))
    running.start(raw)
    return timed(lambda: running.step(raw, out))


def two_processes(bus: str, sweeps: int, design: Path, shaper: Path, damping: float) -> dict[str, object]:
    """A shaped scan with the observer, emulator and loop in two processes: its timing."""
    with tempfile.TemporaryDirectory() as folder:
        machine = Path(folder) / "carm.toml"  # a stall of the host is counted, not the end of the run
        text = load_machine("carm").text.replace("overrun_ticks = 8 ", "overrun_ticks = 10000 ")
        machine.write_text(text.replace("stale_ticks = 3 ", "stale_ticks = 64 "), encoding="utf-8")
        emulator = subprocess.Popen([*ISOCENTER, "emulate", str(machine), "--bus", bus], stdout=subprocess.PIPE, text=True)
        try:
            assert emulator.stdout is not None and emulator.stdout.readline(), "the emulator did not start"
            answer = Path(folder) / "answer.json"
            sweep = [
                "--axis",
                "roll",
                "--from",
                str(-SWEEP_deg),
                "--to",
                str(SWEEP_deg),
                "--speed",
                str(SPEED_deg_s),
                "--sweeps",
                str(sweeps),
            ]
            watched = ["--shaper", str(shaper), "--observer", str(design), *(["--damping", str(damping)] if damping else [])]
            run = [*ISOCENTER, "run", "scan", "-m", str(machine), "-b", bus, *sweep, *watched, "-o", f"{folder}/scan.mf4"]
            subprocess.run([*run, "--json", str(answer)], check=True, stdout=sys.stderr)
            document = json.loads(answer.read_text())
        finally:
            emulator.terminate()
            emulator.wait()
    timing = document["recordings"][0]["timing"]
    return {"bus": bus, "scheduler": document["scheduler"], "processors": os.cpu_count(), "load_average": os.getloadavg(), "timing": timing}


def fast_machine() -> Machine:
    """The C-arm at 1 kHz, its controllers designed anew for that (docs/explanation/carm.md)."""
    fs = FAST_Hz
    sections = {
        "propeller": cascade(gain(1140), lag(0, 0.1, fs), lead(3.7, 76, fs), notch(9, 0.375, 0.8, fs)),
        "roll": cascade(gain(820), lag(0, 0.12, fs), lead(2.2, 70, fs), notch(22, 0.2, 1.0, fs)),
    }
    text = load_machine("carm").text
    text = text.replace("sample_rate_Hz = 256.0", f"sample_rate_Hz = {fs}").replace("rate_Hz = 256.0", f"rate_Hz = {fs}")
    text = text.replace("answer_timeout_s = 0.0025", "answer_timeout_s = 0.0005").replace("substeps = 4", "substeps = 1")
    for axis, cascaded in sections.items():
        head, rest = text.split(f"[controller.{axis}]\nposition_sections = ", 1)
        text = f"{head}[controller.{axis}]\nposition_sections = {cascaded.tolist()}\n{rest[rest.index('gravity_feedforward') :]}"
    return machine_from_text(text, label="carm at 1 kHz")


def lockstep(machine: Machine, design: ObserverDesign, damping: float) -> dict[str, float]:
    """A scan with observer and damping in lockstep: the work of a tick, the emulated machine's included."""
    fitted = dataclasses.replace(design, model=dataclasses.replace(design.model, sample_rate_Hz=machine.sample_rate_Hz))
    observer = fitted.observer()
    damped = ModalDamping(observer, DampingSettings(damping)) if damping else None
    live = LiveObserver(observer, "", damped, [units.effort for units in machine.units])
    half = np.radians(SWEEP_deg) / 2.0
    plan = Scan("roll", -half, half, np.radians(SPEED_deg_s)).plans(machine)[0]
    with tempfile.TemporaryDirectory() as folder, open_bench(machine, BenchOptions("lockstep:"), plan.start_pose, live) as bench:
        return {"sample_rate_Hz": machine.sample_rate_Hz, **bench.run(plan, Path(folder) / "scan.mf4").summary()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    parser.add_argument("--design", type=Path, metavar="FILE", help="observer design of the C-arm: measure whole ticks as well")
    parser.add_argument("--bus", default="udp:239.74.163.90", help="of the two processes")
    parser.add_argument("--sweeps", type=int, default=20, help="of 120 degrees, 5 s each, in the two processes' run")
    parser.add_argument("--damping", type=float, default=0.1, help="damping ratio asked for in whole ticks; 0 for no damping")
    arguments = parser.parse_args()
    target = arguments.json
    answer: dict = {"states": 24, "measurements": 10}
    for kind in ("kf", "ekf", "ukf"):
        answer[kind], answer[f"{kind}_with_everything_published"] = compiled(kind)
    answer["ukf_25_states_with_an_adapted_mode"], _ = compiled("ukf", (0,))
    answer |= {"filterpy_ukf": filterpys(24, 10), "numpy_ukf": numpys(24, 10)}
    if arguments.design is not None:
        design, damping = read_design(arguments.design), arguments.damping
        with tempfile.TemporaryDirectory() as folder:
            shaper = Path(folder) / "roll.shaper.npz"
            subprocess.run([*ISOCENTER, "shape", "carm", "--axis", "roll", "-o", str(shaper)], check=True, stdout=sys.stderr)
            answer["shaper"] = shaper_step(load_machine("carm"), read_shaper(shaper))
            answer["tick_in_two_processes"] = two_processes(arguments.bus, arguments.sweeps, arguments.design, shaper, damping)
        answer["tick_in_lockstep"] = [lockstep(machine, design, damping) for machine in (load_machine("carm"), fast_machine())]
    text = json.dumps(answer, indent=2)
    if target == "-":
        sys.stdout.write(text + "\n")
    else:
        Path(target).write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
