"""Sec. 4.8 rerun with friction in both joints of the emulated C-arm: what neighbouring poses win, noise and total variance apart.

    python benchmarks/identification_sec48.py [--out benchmarks/results/identification_sec48.json] [--draws 6]

13 roll positions from -90 to 90 degrees, one experiment of ten periods of 30 s each (65 minutes), y = [imu_y, position_roll], jog of 2
degrees at 1/30 Hz with one period to settle, Coulomb friction of 8 Nm, Table 4.1's orders and windows; 30 and 20 dB SNR. Stated per method
pair: the variance's reduction in dB as reported, and over draws of phases and noise, beside what (S^H S) of the windows predicts. The
thesis claims 20 dB. Finished draws are kept beside the result.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy import special

from hil.identification import LocalModel, PoseModel, fast_local, nd_local, periodic_records
from hil.machine import load_machine
from hil.simulation import Inputs, Simulator
from virtual_bus.settings import EffectSetting

OUTPUTS = ("imu_y", "position_roll")
PERIOD, SETTLE, PERIODS, POSES = 7680, 1, 10, 13
LINES = np.arange(15, 1201)  # 0.5 to 40 Hz
EXCITATION_RMS_A = 0.5
JOG_RAD = np.radians(2.0)
SNR_DB = np.array((30.0, 20.0))
FRICTION = tuple(EffectSetting("coulomb_friction", axis, {"Fc": 8.0}) for axis in ("propeller", "roll"))
MODELS = {"LPM": LocalModel(3, 2, 0, plant_window=8), "LRM": LocalModel(3, 2, 1, plant_window=8)}
OVER_POSES = PoseModel((1,), (1,), (2,))


def records(simulator: Simulator, pose: np.ndarray, period: np.ndarray, rng: np.random.Generator):
    rows = (SETTLE + PERIODS) * PERIOD
    excitation = np.tile(period, (SETTLE + PERIODS, 1))
    jog = JOG_RAD * np.sin(2 * np.pi * np.arange(rows) / PERIOD)[:, None] * np.minimum(np.arange(rows) / PERIOD, 1.0)[:, None]
    reference = pose + np.repeat(jog, 2, axis=1)

    def run(noise: np.ndarray):
        return simulator.run(Inputs(reference - noise, excitation, np.zeros((rows, 2)), None, pose))

    clean = run(np.zeros((rows, 2)))
    moving = np.column_stack((clean.imu[:, 1], clean.position[:, 1]))[SETTLE * PERIOD :]
    spectrum = np.fft.rfft(moving[:PERIOD], axis=0)[LINES]
    level = np.sqrt(2.0 * np.sum(np.abs(spectrum) ** 2, axis=0)) / PERIOD * 10.0 ** (-SNR_DB / 20.0)  # of what the multisine moves
    noise = np.zeros((rows, 2))
    noise[:, 1] = level[1] * rng.standard_normal(rows)
    measured = run(noise)
    y = np.column_stack((measured.imu[:, 1] + level[0] * rng.standard_normal(rows), measured.position[:, 1] + noise[:, 1]))
    return periodic_records(
        y[None, None], measured.command[None, None], excitation[None, None], period_samples=PERIOD, sample_rate_Hz=256.0,
        settle_periods=SETTLE, output_names=OUTPUTS, pose=tuple(pose), unexcited_reference_lines=(1,),
    )  # fmt: skip


def draw(simulator: Simulator, seed: int) -> dict[str, np.ndarray]:
    """Responses and reported variances (poses, L, n_y, n_u) of each method."""
    rng = np.random.default_rng(seed)
    spectrum = np.zeros((PERIOD // 2 + 1, 2), complex)
    spectrum[LINES] = np.exp(2j * np.pi * rng.random((len(LINES), 2)))
    period = np.fft.irfft(spectrum, PERIOD, axis=0)
    period *= EXCITATION_RMS_A / period.std(axis=0)
    poses = [np.array([0.0, roll]) for roll in np.radians(np.linspace(-90.0, 90.0, POSES))]
    made = [records(simulator, pose, period, rng) for pose in poses]
    result = {}
    for name, model in MODELS.items():
        for label, responses in ((name, [fast_local(r, model) for r in made]), (f"2D-{name}", nd_local(made, model, OVER_POSES))):
            result[f"{label} G"] = np.stack([r.G for r in responses])
            for kind in ("noise", "total"):
                result[f"{label} {kind}"] = np.stack([r.standard_deviation(kind) ** 2 for r in responses])
    return result


def gain(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """(poses,) dB, mean over lines and elements of the ratio's logarithm."""
    return np.mean(10.0 * np.log10(one / two), axis=tuple(range(1, one.ndim)))


def interval(values: np.ndarray) -> list[float]:
    half = 1.96 * values.std(ddof=1) / np.sqrt(len(values))
    return [round(float(values.mean() - half), 2), round(float(values.mean() + half), 2)]


def summary(draws: list[dict[str, np.ndarray]]) -> dict:
    inner = slice(2, -2)
    report = {}
    for name in MODELS:
        noise, total = (
            np.stack([gain(d[f"{name} {kind}"], d[f"2D-{name} {kind}"]) for d in draws]).mean(axis=0) for kind in ("noise", "total")
        )
        over_draws = gain(*(np.stack([d[f"{label} G"] for d in draws]).var(axis=0, ddof=1) for label in (name, f"2D-{name}")))
        report[f"2D-{name} over {name} [dB]"] = {
            "predicted_by_SHS_and_reported_for_noise_per_pose": noise.round(2).tolist(),
            "reported_total_per_pose": total.round(2).tolist(),
            "over_draws_per_pose": over_draws.round(2).tolist(),
            "inner_poses": {
                "predicted": round(float(noise[inner].mean()), 2),
                "over_draws": round(float(over_draws[inner].mean()), 2),
                "over_draws_interval95": interval(over_draws[inner]),
                "reported_total": round(float(total[inner].mean()), 2),
            },
        }
        report[f"{name}: reported total over noise variance"] = round(
            float(np.median([np.median(d[f"{name} total"] / d[f"{name} noise"]) for d in draws])), 2
        )
        for label in (name, f"2D-{name}"):
            reported = np.mean([d[f"{label} total"] for d in draws], axis=0)[inner]
            spread = np.stack([d[f"{label} G"] for d in draws]).var(axis=0, ddof=1)[inner]
            scatter = np.exp(
                special.digamma(len(draws) - 1) - np.log(len(draws) - 1)
            )  # a sample variance's logarithm lies below its mean's
            report[f"{label}: reported total over variance over draws, inner poses"] = round(
                float(np.exp(np.mean(np.log(reported / spread))) * scatter), 2
            )
    return report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "identification_sec48.json")
    parser.add_argument("--draws", type=int, default=6)
    parser.add_argument("--keep", type=Path, default=None, help="folder of finished draws; beside the result by default")
    parser.add_argument("--machine", default="carm", help="carm, carm-real, or the path of a C-arm's file")
    arguments = parser.parse_args()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    keep = arguments.keep or arguments.out.with_suffix(".draws")
    keep.mkdir(parents=True, exist_ok=True)
    machine = load_machine(arguments.machine)
    simulator = Simulator(machine.with_effects(FRICTION))
    draws = []
    for seed in range(arguments.draws):
        kept = keep / f"{seed}.npz"
        if not kept.exists():
            np.savez(kept, **draw(simulator, seed))
        with np.load(kept) as file:
            draws.append({name: file[name] for name in file.files})
    report = {"draws": len(draws), "friction_Nm": 8.0, **summary(draws)}
    arguments.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
