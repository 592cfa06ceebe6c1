"""Sec. 3.5 rerun on the emulated C-arm: robust methods on 14 records against fast methods on one, a fourteenth of the measurement time.

    python benchmarks/identification_sec35.py [--out benchmarks/results/identification_sec35.json] [--draws 12]

Roll at 30 degrees, y = three accelerations and both positions, P = 10, M = 7, two experiments, N = 10 s, N_n = N_m = 2, N_d = 1; noise
30 dB below accelerations, 20 dB below encoder signals, fed back. Per method: standard deviation and bias over |G|, and the deviation
beside the robust BLA's, measured over the draws and as the methods' own covariances predict it. Finished draws are kept beside the result.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from hil.identification import LocalModel, fast_local, periodic_records, robust_bla, robust_local
from hil.machine import load_machine
from hil.simulation import Inputs, Simulator
from hil.simulation.linear import sampled_response

OUTPUTS = ("imu_x", "imu_y", "imu_z", "position_propeller", "position_roll")
POSE = np.array([0.0, np.radians(30.0)])
PERIOD, SETTLE, PERIODS, REALISATIONS = 2560, 1, 10, 7
LINES = np.arange(5, 401)  # 0.5 to 40 Hz
EXCITATION_RMS_A = 0.5
SNR_DB = np.array((30.0, 30.0, 30.0, 20.0, 20.0))
LPM, LRM = LocalModel(2, 2, 0), LocalModel(2, 2, 1)
METHODS = {
    "robust BLA": lambda all_records, one: robust_bla(all_records),
    "robust LPM": lambda all_records, one: robust_local(all_records, LPM),
    "robust LRM": lambda all_records, one: robust_local(all_records, LRM),
    "fast LPM": lambda all_records, one: fast_local(one, LPM),
    "fast LRM": lambda all_records, one: fast_local(one, LRM),
}


def orthogonal_period(rng: np.random.Generator) -> np.ndarray:
    """(2 experiments, PERIOD, 2 inputs), flat, random phases."""
    spectrum = np.zeros((2, PERIOD // 2 + 1, 2), complex)
    of_input, of_experiment = rng.uniform(0.0, 2 * np.pi, (2, len(LINES), 2))
    for e, i in np.ndindex(2, 2):
        spectrum[e, LINES, i] = ((1, 1), (1, -1))[i][e] * np.exp(1j * (of_input[:, i] + of_experiment[:, e]))
    period = np.fft.irfft(spectrum, PERIOD, axis=1)
    return period * EXCITATION_RMS_A / period.std()


def record(simulator: Simulator, excitation: np.ndarray, level: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Outputs and commands of one run; noise on an encoder enters the loop as its negative on the reference does."""
    noise = level * rng.standard_normal((len(excitation), len(OUTPUTS)))
    reference = np.tile(POSE, (len(excitation), 1)) - noise[:, 3:]
    run = simulator.run(Inputs(reference, excitation, np.zeros_like(excitation), None, POSE))
    return np.column_stack((run.imu[:, :3], run.position)) + noise, run.command


def draw(simulator: Simulator, seed: int) -> dict[str, np.ndarray]:
    """Estimates and reported variances of every method, (L, n_y, n_u)."""
    rng = np.random.default_rng(seed)
    rows = (SETTLE + PERIODS) * PERIOD
    y, u, w = (np.empty((REALISATIONS, 2, rows, n)) for n in (len(OUTPUTS), 2, 2))
    for m in range(REALISATIONS):
        w[m] = np.tile(orthogonal_period(rng), (1, SETTLE + PERIODS, 1))
        for e in range(2):
            if m == e == 0:
                clean, _ = record(simulator, w[m, e], np.zeros(len(OUTPUTS)), rng)
                level = clean[PERIOD:].std(axis=0) * 10.0 ** (-SNR_DB / 20.0)
            y[m, e], u[m, e] = record(simulator, w[m, e], level, rng)
    options = {"period_samples": PERIOD, "sample_rate_Hz": 256.0, "settle_periods": SETTLE, "output_names": OUTPUTS}
    all_records = periodic_records(y, u, w, **options)
    one = periodic_records(y[:1, :1], u[:1, :1], w[:1, :1], **options)
    result = {}
    for name, estimate in METHODS.items():
        response = estimate(all_records, one)
        result[f"{name} G"] = response.G
        for kind in ("noise", "total"):
            result[f"{name} {kind}"] = response.standard_deviation(kind) ** 2
    return result


def summary(draws: list[dict[str, np.ndarray]], truth: np.ndarray) -> dict:
    """Medians over lines and elements; intervals by resampling the draws."""
    rng = np.random.default_rng(0)
    scale = np.abs(truth) ** 2
    errors = {name: np.stack([d[f"{name} G"] for d in draws]) - truth for name in METHODS}
    reported = {name: np.mean([d[f"{name} noise"] for d in draws], axis=0) for name in METHODS}
    report = {}
    for name, error in errors.items():
        variance = error.var(axis=0, ddof=1)
        bias2 = np.maximum(np.abs(error.mean(axis=0)) ** 2 - variance / len(draws), 0.0)

        def factor(chosen: np.ndarray, of: np.ndarray = error) -> float:
            parts = (e[chosen].var(axis=0, ddof=1) for e in (of, errors["robust BLA"]))
            return float(np.sqrt(np.exp(np.mean(np.log(next(parts) / next(parts))))))

        resampled = [factor(np.unique(rng.integers(0, len(draws), 2 * len(draws)))) for _ in range(50)]
        report[name] = {
            "deviation_over_G": float(np.sqrt(np.median(variance / scale))),
            "bias_over_G": float(np.sqrt(np.median(bias2 / scale))),
            "largest_bias_over_deviation_95_percent_of_elements": float(np.quantile(np.sqrt(bias2 / variance), 0.95)),
            "deviation_over_robust_BLA": factor(np.arange(len(draws))),
            "deviation_over_robust_BLA_interval95": np.quantile(resampled, (0.025, 0.975)).tolist(),
            "predicted_by_the_covariances": float(np.sqrt(np.exp(np.mean(np.log(reported[name] / reported["robust BLA"]))))),
            "reported_total_over_noise_variance": float(np.median(np.mean([d[f"{name} total"] for d in draws], axis=0) / reported[name])),
        }
    return report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "identification_sec35.json")
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--keep", type=Path, default=None, help="folder of finished draws; a temporary place beside the result by default")
    parser.add_argument("--machine", default="carm", help="carm, carm-real, or the path of a C-arm's file")
    arguments = parser.parse_args()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    keep = arguments.keep or arguments.out.with_suffix(".draws")
    keep.mkdir(parents=True, exist_ok=True)
    machine = load_machine(arguments.machine)
    simulator = Simulator(machine)
    draws = []
    for seed in range(arguments.draws):
        kept = keep / f"{seed}.npz"
        if not kept.exists():
            np.savez(kept, **draw(simulator, seed))
        with np.load(kept) as file:
            draws.append({name: file[name] for name in file.files})
    truth = sampled_response(machine, POSE, LINES * 256.0 / PERIOD, OUTPUTS)
    report = {"draws": len(draws), "measurement_time_robust_over_fast": 2 * REALISATIONS, **summary(draws, truth)}
    arguments.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
