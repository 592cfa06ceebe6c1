"""How long the estimators take on one core: one pose, 14 records, 1279 lines, 7 closed-loop outputs, 2 inputs, 10 periods of 2560.

    OMP_NUM_THREADS=1 python benchmarks/identification_speed.py
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np

from hil.identification import LocalModel, PeriodicRecords, fast_local, periodic_records, robust_bla, robust_local

PERIOD, PERIODS, REALISATIONS, OUTPUTS = 2560, 10, 7, 5
REPEATS = 5


def records(realisations: int) -> PeriodicRecords:
    """Noise in the right shape: the estimators' work does not depend on the values."""
    rng = np.random.default_rng(0)
    T, lines = PERIOD * PERIODS, np.arange(1, PERIOD // 2)
    excitation = np.empty((realisations, 2, PERIOD, 2))
    for m in range(realisations):
        phase = np.exp(2j * np.pi * rng.random((2, len(lines), 2)))
        for e in range(2):
            spectrum = np.zeros((PERIOD // 2 + 1, 2), complex)
            spectrum[lines] = phase[0] * phase[1][:, e : e + 1] * ((1, 1), (1, -1))[e]
            excitation[m, e] = np.fft.irfft(spectrum, PERIOD, axis=0)
    shape = (realisations, 2, T)
    return periodic_records(
        rng.standard_normal((*shape, OUTPUTS)),
        rng.standard_normal((*shape, 2)),
        np.tile(excitation, (1, 1, PERIODS, 1)),
        period_samples=PERIOD,
        sample_rate_Hz=256.0,
    )


def best_of(work: Callable[[], object]) -> float:
    """Shortest of a few runs [s], after one that compiles."""
    work()
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    many, two = records(REALISATIONS), records(1)
    print(
        json.dumps(
            {
                "robust_bla_s": best_of(lambda: robust_bla(many)),
                "robust_lrm_s": best_of(lambda: robust_local(many, LocalModel())),
                "robust_lpm_two_experiments_s": best_of(lambda: robust_local(two, LocalModel(denominator=0))),
                "fast_lpm_two_experiments_s": best_of(lambda: fast_local(two, LocalModel(denominator=0))),
                "fast_lrm_two_experiments_s": best_of(lambda: fast_local(two, LocalModel())),
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    main()
