"""What damping feedback from the observer brings on the emulated C-arm, over the lockstep bus.

    python benchmarks/damping.py --design carm.observer.npz --json -

Ring-down of the 8 Hz mode after a pulse of the propeller's drive, with and without, and what the linear loop says of it; vibration of the
detector while the propeller's gear is shaken by 10 Nm at 8.4 Hz: rms of what the accelerometer reads between 4 and 20 Hz, the design
tuned on another recording of that shaking. `--over-poses` adds the linear loop's ratios and margins over 25 poses.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy import signal

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from ring_down import rung_ratio

from controllers.damping import DampingSettings, ModalDamping
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import UnusableInputError
from hil.experiments import Static
from hil.machine import Machine, load_machine
from hil.observing import ObserverDesign, read_design, tune
from hil.observing.damping import DampedLoop, accept_damping, examine_damping
from hil.observing.live import LiveObserver
from hil.observing.simulated_recordings import emulated_recording
from hil.recording import read_recording
from hil.terminal.output import Answer
from virtual_bus.physics import Physics
from virtual_bus.settings import EffectSetting

RATIOS = (0.05, 0.1)
SHAKING = EffectSetting("base_motion", "sleeve", {"A": 10.0, "f": 8.4, "phi": 0.0})
BAND_Hz = (4.0, 20.0)
SECONDS, SETTLED_S = 12.0, 4.0
TUNING_EVALUATIONS = 120


def watching(design: ObserverDesign, machine: Machine, ratio: float) -> LiveObserver:
    """The observer, with damping where a ratio is wanted."""
    observer = design.observer()
    law = ModalDamping(observer, DampingSettings(ratio)) if ratio else None
    return LiveObserver(observer, "", law, [units.effort for units in machine.units] if ratio else ())


def vibration(machine: Machine, design: ObserverDesign, ratio: float) -> dict[str, float]:
    """Held still while the machine is shaken."""
    plan = Static(SECONDS).plans(machine)[0]
    shaken = machine.with_effects((SHAKING,))
    live = watching(design, machine, ratio)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shaken.mf4"
        with open_bench(machine, BenchOptions("lockstep:", seed=9, emulated=shaken), plan.start_pose, live) as bench:
            bench.run(plan, path)
        recording = read_recording(path)
    sections = signal.butter(4, BAND_Hz, "bandpass", fs=machine.sample_rate_Hz, output="sos")
    seen = signal.sosfiltfilt(sections, recording.matrix(["imu_x", "imu_y", "imu_z"]), axis=0)
    kept = slice(round(SETTLED_S * machine.sample_rate_Hz), -round(machine.sample_rate_Hz))
    found = {"acceleration_rms_m_s2": float(np.sqrt(np.mean(np.sum(seen[kept] ** 2, axis=1))))}
    found["alarm_share"] = float(recording["estimate_alarm"][kept].mean())
    if ratio:
        found["least_share_of_damping_in_force"] = float(recording["damping_share"][kept].min())
        found["largest_damping_A"] = float(np.abs(recording["damping_propeller"]).max())
    return found


def measure(machine: Machine, design: ObserverDesign, over_poses: bool) -> dict[str, object]:
    """Everything, by the ratio asked for."""
    physics, rest = Physics(machine.plant, noise=False), np.zeros(len(machine.axes))
    plan = Static(SECONDS).plans(machine)[0]
    tuned_on = emulated_recording(machine.with_effects((SHAKING,)), plan, 3)
    shaken = dataclasses.replace(design, noise=tune(design.model, design.noise, [tuned_on], evaluations=TUNING_EVALUATIONS).noise)
    answer: dict[str, object] = {}
    for ratio in (0.0, *RATIOS):
        live = watching(design, machine, ratio)
        with tempfile.TemporaryDirectory() as folder:
            rung = rung_ratio(machine, live, Path(folder))
        linear = DampedLoop(machine, physics, live.observer, live.damping, rest).damping_ratio(8.0)
        answer[f"asked for {ratio:g}"] = {"ring_down_ratio": rung, "linear_ratio": linear, "shaken": vibration(machine, shaken, ratio)}
        if over_poses and live.damping is not None:
            try:
                verdict = accept_damping(machine, examine_damping(machine, live.damping, live.observer))
            except UnusableInputError as refusal:
                verdict = str(refusal)
            answer[f"over poses, {ratio:g}"] = verdict
    return answer


def main() -> None:
    """Print or write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--design", type=Path, required=True, metavar="FILE", help="observer design of the C-arm")
    parser.add_argument("--over-poses", action="store_true", help="the linear loop over 25 poses as well")
    parser.add_argument("--json", default="-", metavar="FILE", help="- for standard output")
    parser.add_argument("--machine", default="carm", help="carm, carm-real, or the path of a C-arm's file")
    arguments = parser.parse_args()
    to = Answer(arguments.json)
    to.write(measure(load_machine(arguments.machine), read_design(arguments.design), arguments.over_poses))


if __name__ == "__main__":
    main()
