"""Are the covariances true? Monte Carlo over noise draws on a loop inside the local model class: methods, SNRs, numbers of periods.

    python benchmarks/identification_coverage.py [--out benchmarks/results/identification_coverage.json] [--draws 500]

Per case: estimated over sample variance averaged over lines and elements, the share of elements whose truth lies within the 95 % circle,
and of columns within Hotelling's ellipsoid. Elements whose bias, measured without noise, exceeds 0.1 of the noise's standard deviation are
counted apart. Finished cases are kept in the result file, so that a run may be broken off and taken up again.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from on_engine import add_scheduler, each

from hil.identification import (
    ArbitraryRecords,
    FrequencyResponse,
    LocalModel,
    PoseModel,
    arbitrary_local,
    fast_bla,
    fast_local,
    nd_local,
    periodic_records,
    robust_bla,
    robust_local,
)

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from simulated_loop import SAMPLE_RATE_HZ, experiment, plant_response, simulate, two_mode_loop  # the tests' own simulation, no emulator

PERIOD, LINES, SETTLE = 1024, np.arange(1, 129), 2
NOISE = np.array((0.3, 0.03, 0.03))
POSES = (-1.0, 0.0, 1.0)
BIAS_DRAWS = 8  # phases drawn without noise
BIASED = 0.1  # of the noise's standard deviation
LPM = LocalModel(numerator=6, denominator=0, plant_window=9)  # order 4 is biased by 0.3 sigma at a tenth of the noise
LRM = LocalModel(numerator=3)
LOWEST_HZ = 0.5  # of the arbitrary methods' band
Conditions = tuple[float, int]
CONDITIONS: tuple[Conditions, ...] = ((1.0, 8), (0.25, 8), (0.6, 8), (2.5, 8), (1.0, 11))
"""Noise scale and number of periods; the first is what the tests use, the others were not used while the estimators were written."""


def loop_at(pose: float):
    return two_mode_loop(frequencies_Hz=(3.0 + 0.003 * pose, 7.0), damping=(0.5, 0.5), lag=0.5)


@dataclass(frozen=True)
class Method:
    """One estimator with the experiment it takes."""

    draw: Callable[[np.random.Generator, np.ndarray, int], FrequencyResponse]  # generator, noise, periods
    kinds: tuple[str, ...] = ("noise", "total")


def periodic(estimate: Callable, realisations: int, experiments: int, settle: int = 0, lines: np.ndarray = LINES) -> Method:
    def records(rng: np.random.Generator, noise: np.ndarray, periods: int, pose: float):
        data = experiment(
            loop_at(pose), rng, realisations=realisations, experiments=experiments, periods=periods, settle_periods=settle,
            period=PERIOD, lines=lines, noise=tuple(noise),
        )  # fmt: skip
        return periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, settle_periods=settle, pose=(pose,))

    return Method(lambda rng, noise, periods: estimate(records(rng, noise, periods, 0.0)))


def over_poses(model: LocalModel) -> Method:
    def draw(rng: np.random.Generator, noise: np.ndarray, periods: int) -> FrequencyResponse:
        records = []
        for pose in POSES:
            data = experiment(loop_at(pose), rng, realisations=1, periods=periods, period=PERIOD, lines=LINES, noise=tuple(noise),
                              experiments=1)  # fmt: skip
            records.append(periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, pose=(pose,)))
        return nd_local(records, model, PoseModel((1,), (1,), (1,)))[1]

    return Method(draw)


def arbitrary(model: LocalModel) -> Method:
    def draw(rng: np.random.Generator, noise: np.ndarray, periods: int) -> FrequencyResponse:
        w = rng.standard_normal((1, 256 * periods, 2))
        y, u = simulate(loop_at(0.0), w[0], rng.standard_normal((256 * periods, 3)) * noise, initial=rng.standard_normal(6))
        records = ArbitraryRecords(y[None], u[None], w, SAMPLE_RATE_HZ, ("a", "b", "c"), ("u", "v"), ("",) * 3, ("",) * 2)
        return arbitrary_local([records], (LOWEST_HZ, LINES[-1] * SAMPLE_RATE_HZ / PERIOD), model)[0]

    return Method(draw, ("total",))


METHODS = {
    "fast LPM": periodic(lambda r: fast_local(r, LPM), 1, 1),
    "fast LRM": periodic(lambda r: fast_local(r, LRM), 1, 1),
    "robust BLA": periodic(robust_bla, 4, 2, SETTLE),
    "fast BLA": Method(periodic(fast_bla, 1, 2, SETTLE, np.arange(1, 129, 2)).draw, ("noise",)),
    "2D-LPM": over_poses(LPM),
    "2D-LRM": over_poses(LRM),
    "arbitrary LPM": arbitrary(replace(LPM, plant_window=12)),
    "arbitrary LRM": arbitrary(LRM),
    "robust LPM": periodic(lambda r: robust_local(r, LPM), 3, 2),
    "robust LRM": periodic(lambda r: robust_local(r, LRM), 3, 2),
}


def case(name: str, scale: float, periods: int, draws: int) -> dict[str, float]:
    """Ratios and coverages of one method at one noise level and number of periods."""
    method = METHODS[name]
    rng = np.random.default_rng(zlib.crc32(f"{name} {scale} {periods}".encode()))
    first = method.draw(rng, scale * NOISE, periods)
    truth = plant_response(loop_at(0.0), first.frequencies_Hz)
    bias = np.sqrt(np.mean([np.abs(method.draw(rng, 0.0 * NOISE, periods).G - truth) ** 2 for _ in range(BIAS_DRAWS)], axis=0))
    square = np.zeros(truth.shape)
    variance = {kind: np.zeros(truth.shape) for kind in method.kinds}
    circle = {kind: np.zeros(truth.shape) for kind in method.kinds}
    ellipsoid = {kind: np.zeros((truth.shape[0], truth.shape[2])) for kind in method.kinds}
    for _ in range(draws):
        response = method.draw(rng, scale * NOISE, periods)
        error = np.abs(response.G - truth)
        square += error**2 / draws
        for kind in method.kinds:
            variance[kind] += response.standard_deviation(kind) ** 2 / draws
            circle[kind] += (error <= response.bound(0.95, kind)) / draws
            ellipsoid[kind] += (response.column_distance(truth, kind) <= response.column_distance_bound(0.95, kind)[:, None]) / draws
    true = bias <= BIASED * np.sqrt(square)
    columns = true.all(axis=1)
    result = {"share of elements biased above 0.1 sigma": float(1.0 - true.mean())}
    for kind in method.kinds:
        result |= {
            f"{kind}: estimated over sample variance": float(np.mean((variance[kind] / square)[true])),
            f"{kind}: within 95 % circle": float(np.mean(circle[kind][true])),
            f"{kind}: within 95 % ellipsoid": float(np.mean(ellipsoid[kind][columns])) if columns.any() else float("nan"),
        }
    return {key: round(value, 4) for key, value in result.items()}


def key(name: str, scale: float, periods: int, draws: int) -> str:
    """Return what a case is called in the report."""
    return f"{name}, noise x {scale:g}, P = {periods}, {draws} draws"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "identification_coverage.json")
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--methods", default=",".join(METHODS), help="those to run, separated by commas")
    add_scheduler(parser)
    arguments = parser.parse_args()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    report = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    cases = [
        {"name": name, "scale": scale, "periods": periods, "draws": arguments.draws}
        for name in arguments.methods.split(",")
        for scale, periods in CONDITIONS
    ]
    for one, answer in each(case, [one for one in cases if key(**one) not in report], arguments.scheduler, named=lambda one: key(**one)):
        report[key(**one)] = answer
        arguments.out.write_text(json.dumps(report, indent=1) + "\n")
        print(key(**one), " ".join(f"{value:.3f}" for value in answer.values()), flush=True)
    first = {key(**one): report[key(**one)] for one in cases if key(**one) in report}
    arguments.out.write_text(json.dumps(first | report, indent=1) + "\n")


if __name__ == "__main__":
    main()
