"""Are the covariances true? Monte Carlo over noise draws on a loop inside the local model class: methods, SNRs, numbers of periods.

    python benchmarks/identification_coverage.py --out coverage.json [--draws 500]

Estimated against sample variance averaged over lines and elements, and the share of lines whose truth lies within the 95 % circle and
within Hotelling's ellipsoid. Finished cases are kept in the result file, so that a run may be broken off and taken up again.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hil.identification import FrequencyResponse, LocalModel, PeriodicRecords, fast_local, periodic_records, robust_bla, robust_local

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "identification"))
from simulated_loop import SAMPLE_RATE_HZ, experiment, plant_response, two_mode_loop  # the tests' own simulation, no emulator

PERIOD, LINES, SETTLE = 1024, np.arange(1, 200), 2
LOOP = two_mode_loop(damping=(0.5, 0.5))
NOISE = np.array((0.3, 0.03, 0.03))
LPM = LocalModel(numerator=4, denominator=0, plant_window=8)
LRM = LocalModel(numerator=3)
METHODS: dict[str, tuple[Callable[[PeriodicRecords], FrequencyResponse], int, int]] = {
    "robust BLA": (robust_bla, 4, 2),
    "robust LPM": (lambda r: robust_local(r, LPM), 4, 2),
    "robust LRM": (lambda r: robust_local(r, LRM), 4, 2),
    "fast LPM": (lambda r: fast_local(r, LPM), 1, 1),
    "fast LRM": (lambda r: fast_local(r, LRM), 1, 1),
}
CASES = [(name, scale, periods) for name in METHODS for scale, periods in ((1.0, 8), (0.1, 8), (3.0, 8), (1.0, 5), (1.0, 13))]


def case(name: str, scale: float, periods: int, draws: int) -> dict[str, float]:
    """Ratios and coverages of one method at one noise level and number of periods."""
    estimate, realisations, experiments = METHODS[name]
    rng = np.random.default_rng([CASES.index((name, scale, periods)), draws])
    truth = plant_response(LOOP, LINES * SAMPLE_RATE_HZ / PERIOD)
    settle = SETTLE if name == "robust BLA" else 0
    kinds = ("noise", "total")
    square = np.zeros((len(LINES), 3, 2))
    variance = {kind: np.zeros_like(square) for kind in kinds}
    circle, ellipsoid = {kind: 0.0 for kind in kinds}, {kind: 0.0 for kind in kinds}
    for _ in range(draws):
        data = experiment(
            LOOP, rng, realisations=realisations, experiments=experiments, periods=periods, settle_periods=settle,
            period=PERIOD, lines=LINES, noise=tuple(scale * NOISE),
        )  # fmt: skip
        response = estimate(periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, settle_periods=settle))
        error = np.abs(response.G - truth)
        square += error**2
        for kind in kinds:
            variance[kind] += response.standard_deviation(kind) ** 2
            circle[kind] += np.mean(error <= response.bound(0.95, kind)) / draws
            inside = response.column_distance(truth, kind) <= response.column_distance_bound(0.95, kind)[:, None]
            ellipsoid[kind] += np.mean(inside) / draws
    unbiased = draws / (draws - 1)  # of a ratio whose denominator is a sample variance
    return {
        f"{what} {kind}": float(value)
        for kind in kinds
        for what, value in (
            ("estimated over sample variance,", np.mean(variance[kind] / square) / unbiased),
            ("within 95 % circle,", circle[kind]),
            ("within 95 % ellipsoid,", ellipsoid[kind]),
        )
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--draws", type=int, default=500)
    arguments = parser.parse_args()
    report = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    for name, scale, periods in CASES:
        key = f"{name}, noise x {scale:g}, P = {periods}, {arguments.draws} draws"
        if key not in report:
            report[key] = case(name, scale, periods, arguments.draws)
            arguments.out.write_text(json.dumps(report, indent=1) + "\n")
        print(key, " ".join(f"{value:.3f}" for value in report[key].values()), flush=True)


if __name__ == "__main__":
    main()
