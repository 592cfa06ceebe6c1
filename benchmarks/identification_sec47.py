"""Sec. 4.7 rerun on the emulated C-arm: LPM, 2D-LPM, LRM and 2D-LRM over 25 frozen roll positions, bias and variance apart.

    python benchmarks/identification_sec47.py --out sec47.json [--draws 8]

y = [imu_y, position_roll], n_z = 4; 6 periods of 10 s; noise 30 dB below the acceleration and 20 dB below the encoder signal, fed back
where the encoder is; Table 4.1's orders and windows for LPM and 2D-LPM. Error is (4.55) against the plant's linearisation; bias is the
error of the mean over the draws less its own variance. Finished draws are kept beside the result: a run broken off is taken up again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from hil.identification import LocalModel, PoseModel, fast_local, nd_local, periodic_records
from hil.identification.lpm_lrm.order_selection import Candidate, default_candidates, select_local_model
from hil.machine import load_machine
from hil.simulation import Inputs, Simulator
from hil.simulation.linear import sampled_response

OUTPUTS = ("imu_y", "position_roll")
PERIOD, PERIODS, POSES = 2560, 6, 25
LINES = np.arange(5, 401)  # 0.5 to 40 Hz, flat: what matters for imaging (Sec. 3.5.1)
EXCITATION_RMS_A = 0.5
SNR_DB = (30.0, 20.0)
METHODS = {
    "LPM": Candidate(LocalModel(numerator=3, transient=2, denominator=0, plant_window=8)),
    "2D-LPM": Candidate(LocalModel(numerator=3, transient=2, denominator=0, plant_window=8), PoseModel((1,), (0,), (2,))),
    "LRM": Candidate(LocalModel(numerator=3, transient=2, denominator=1, plant_window=8)),
    "2D-LRM": Candidate(LocalModel(numerator=3, transient=2, denominator=1, plant_window=8), PoseModel((1,), (1,), (2,))),
}


class Experiment:
    """Poses, truths, and noisy records of one multisine per draw."""

    def __init__(self, machine: str) -> None:
        self.machine = load_machine(machine)
        self.simulator = Simulator(self.machine)
        self.poses = [(0.0, roll) for roll in np.radians(np.linspace(-90.0, 90.0, POSES))]
        self.frequencies_Hz = LINES * self.machine.sample_rate_Hz / PERIOD
        self.truth = np.stack([sampled_response(self.machine, np.array(pose), self.frequencies_Hz, OUTPUTS) for pose in self.poses])

    def records(self, seed: int, noisy: bool = True):
        rng = np.random.default_rng(seed)
        spectrum = np.zeros((PERIOD // 2 + 1, 2), complex)
        spectrum[LINES] = np.exp(2j * np.pi * rng.random((len(LINES), 2)))
        period = np.fft.irfft(spectrum, PERIOD, axis=0)
        excitation = np.tile(period * EXCITATION_RMS_A / period.std(axis=0), (PERIODS, 1))
        return [self._record(np.array(pose), excitation, rng if noisy else None) for pose in self.poses]

    def _record(self, pose: np.ndarray, excitation: np.ndarray, rng: np.random.Generator | None):
        rows = len(excitation)

        def run(position_noise: np.ndarray):
            """Noise on the encoder enters the loop as its negative on the reference does."""
            inputs = Inputs(np.tile(pose, (rows, 1)) - position_noise, excitation, np.zeros((rows, 2)), None, pose)
            return self.simulator.run(inputs)

        noise = np.zeros((rows, 2))
        clean = run(noise)
        if rng is None:
            y = np.column_stack((clean.imu[:, 1], clean.position[:, 1]))
        else:
            level = [clean.imu[PERIOD:, 1].std(), clean.position[PERIOD:, 1].std()] * 10.0 ** (-np.array(SNR_DB) / 20.0)
            noise[:, 1] = level[1] * rng.standard_normal(rows)
            clean = run(noise)
            y = np.column_stack((clean.imu[:, 1] + level[0] * rng.standard_normal(rows), clean.position[:, 1] + noise[:, 1]))
        return periodic_records(
            y[None, None],
            clean.command[None, None],
            excitation[None, None],
            period_samples=PERIOD,
            sample_rate_Hz=self.machine.sample_rate_Hz,
            output_names=OUTPUTS,
            pose=tuple(pose),
        )


def estimate(candidate: Candidate, records: list):
    """One response per pose."""
    if candidate.over_poses.windows:
        return nd_local(records, candidate.model, candidate.over_poses)
    return tuple(fast_local(record, candidate.model) for record in records)


def draw(experiment: Experiment, seed: int) -> dict[str, np.ndarray]:
    """Errors (poses, L, n_y, n_u) and reported variances of every method."""
    records = experiment.records(seed)
    result = {}
    for name, candidate in METHODS.items():
        responses = estimate(candidate, records)
        result[f"{name} error"] = np.stack([r.G for r in responses]) - experiment.truth
        result[f"{name} noise variance"] = np.stack([r.standard_deviation("noise") ** 2 for r in responses])
        result[f"{name} total variance"] = np.stack([r.standard_deviation("total") ** 2 for r in responses])
    return result


def relative_error(error: np.ndarray, truth: np.ndarray) -> float:
    """Root of (4.55)'s diagonal over that of the truth, median over lines: a share of the response."""
    return float(
        np.sqrt(np.median(np.mean(np.sum(np.abs(error) ** 2, axis=3), axis=0) / np.mean(np.sum(np.abs(truth) ** 2, axis=3), axis=0)))
    )


def summary(draws: list[dict[str, np.ndarray]], truth: np.ndarray) -> dict:
    """Per method: error, bias, variance, and the variance it reported; per output-input element medians over lines and poses."""
    report = {}
    for name in METHODS:
        errors = np.stack([d[f"{name} error"] for d in draws])
        variance = errors.var(axis=0, ddof=1)
        bias2 = np.maximum(np.abs(errors.mean(axis=0)) ** 2 - variance / len(draws), 0.0)
        noise, total = (np.mean([d[f"{name} {kind} variance"] for d in draws], axis=0) for kind in ("noise", "total"))
        scale = np.abs(truth) ** 2
        report[name] = {
            "error_4_55_relative": relative_error(errors[0], truth),
            "bias_over_G": np.sqrt(np.median(bias2 / scale, axis=(0, 1))).tolist(),
            "deviation_over_G": np.sqrt(np.median(variance / scale, axis=(0, 1))).tolist(),
            "share_of_lines_biased_above_0.1_sigma": float(np.mean(bias2 > 0.01 * variance)),
            "reported_over_sample_noise_variance": float(np.exp(np.mean(np.log(noise / variance)))),
            "reported_over_sample_total_variance": float(np.exp(np.mean(np.log(total / variance)))),
            "median_noise_variance_dB": (10 * np.log10(np.median(noise / scale, axis=(0, 1)))).tolist(),
            "mean_square_error_over_G": np.mean(np.mean(np.abs(errors) ** 2, axis=0) / scale, axis=(0, 1)).tolist(),
        }
    for rational in ("PM", "RM"):
        one, two = (np.mean([d[f"{kind}L{rational} noise variance"] for d in draws], axis=0) for kind in ("", "2D-"))
        sample = [np.stack([d[f"{kind}L{rational} error"] for d in draws]).var(axis=0, ddof=1) for kind in ("", "2D-")]
        gain = 10 * np.log10(np.median(sample[0] / sample[1], axis=(1, 2, 3)))
        report[f"gain of 2D-L{rational} over L{rational} [dB]"] = {
            "measured_per_pose": gain.round(2).tolist(),
            "measured_inner_poses": float(np.mean(gain[2:-2])),
            "interval95": (np.mean(gain[2:-2]) + 1.96 * np.std(gain[2:-2]) / np.sqrt(len(gain) - 4) * np.array([-1, 1])).tolist(),
            "predicted_inner_poses_from_SHS": float(np.mean(10 * np.log10(np.median(one / two, axis=(1, 2, 3)))[2:-2])),
        }
    return report


EVERY = 3
"""Of the default candidates every third is judged: orders, windows and poses vary in turn, and all of them would take half an hour."""


def selection(experiment: Experiment) -> dict:
    """Score of every candidate on one draw beside its true error on another: does the criterion choose well?"""
    chosen_on, judged_on = experiment.records(1000), experiment.records(1001)
    candidates = default_candidates(chosen_on[0], len(chosen_on))[::EVERY]
    found = select_local_model(chosen_on, candidates)
    table = []
    for candidate, score in zip(found.candidates, found.scores, strict=True):
        responses = estimate(candidate, judged_on)
        error = np.stack([r.G for r in responses]) - experiment.truth
        whitened = np.mean(np.abs(error) ** 2 / noise_scale(judged_on, experiment))
        m, o = candidate.model, candidate.over_poses
        orders = {"N_n": m.numerator, "N_d": m.denominator, "n": m.plant_window, "Q_z": list(o.numerator), "p": list(o.windows)}
        table.append(
            {**orders, "score": float(score), "true_error": float(whitened), "error_4_55_relative": relative_error(error, experiment.truth)}
        )
    best, chosen = min(row["true_error"] for row in table), table[int(found.scores.argmin())]
    return {
        "chosen": chosen,
        "best_true_error": best,
        "chosen_over_best": chosen["true_error"] / best,
        "rank_correlation": rank_correlation([row["score"] for row in table], [row["true_error"] for row in table]),
        "table": sorted(table, key=lambda row: row["score"]),
    }


_SCALE: dict[int, np.ndarray] = {}


def noise_scale(records: list, experiment: Experiment) -> np.ndarray:
    """(poses, L, n_y, n_u) noise variance a single line's response has: what a true error is measured in."""
    if id(records) not in _SCALE:
        _SCALE[id(records)] = np.stack([fast_local(r, METHODS["LRM"].model).standard_deviation("noise") ** 2 for r in records])
    return _SCALE[id(records)]


def rank_correlation(a: list[float], b: list[float]) -> float:
    ranks = [np.argsort(np.argsort(values)) for values in (a, b)]
    return float(np.corrcoef(*ranks)[0, 1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--no-selection", action="store_true")
    parser.add_argument("--machine", default="carm", help="carm, carm-real, or the path of a C-arm's file")
    arguments = parser.parse_args()
    experiment = Experiment(arguments.machine)
    draws = []
    for seed in range(arguments.draws):
        kept = arguments.out.with_suffix(f".draw{seed}.npz")
        if not kept.exists():
            np.savez(kept, **draw(experiment, seed))
        with np.load(kept) as file:
            draws.append({name: file[name] for name in file.files})
    report = {"draws": len(draws), **summary(draws, experiment.truth)}
    if not arguments.no_selection:
        report["selection"] = selection(experiment)
    arguments.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps({key: value for key, value in report.items() if key != "selection"}, indent=1))
    if "selection" in report:
        print(json.dumps({key: value for key, value in report["selection"].items() if key != "table"}, indent=1))


if __name__ == "__main__":
    main()
