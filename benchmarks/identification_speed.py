"""How long the estimators take on one core: one pose, 14 records, 1279 lines, 7 closed-loop outputs, 2 inputs, 10 periods of 2560.

OMP_NUM_THREADS=1 python benchmarks/identification_speed.py
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hil.identification import LocalModel, PeriodicRecords, PoseModel, fast_local, nd_local, periodic_records, robust_bla, robust_local

PERIOD, PERIODS, REALISATIONS, OUTPUTS = 2560, 10, 7, 5
REPEATS = 5
POSES = 13


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
    """Shortest processor time of a few runs [s], after one that compiles: other work on the machine does not count."""
    work()
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def long_measurement() -> dict[str, float]:
    """65 minutes of nine channels by 2D-LRM; peak resident memory [GB] and processor time [s], compiling included."""
    rng = np.random.default_rng(0)
    period, periods = 7680, 10
    spectrum = np.zeros((period // 2 + 1, 2), complex)
    spectrum[15:1201] = np.exp(2j * np.pi * rng.random((1186, 2)))
    excitation = np.tile(np.fft.irfft(spectrum, period, axis=0), (periods, 1))[None, None]
    shape = (1, 1, period * periods)
    poses = [
        periodic_records(
            rng.standard_normal((*shape, OUTPUTS)),
            rng.standard_normal((*shape, 2)),
            excitation,
            period_samples=period,
            sample_rate_Hz=256.0,
            pose=(0.0, float(pose)),
        )
        for pose in range(POSES)
    ]
    start = time.process_time()
    nd_local(poses, LocalModel(3, 2, 1), PoseModel((1,), (1,), (2,)))
    seconds = time.process_time() - start
    return {"long_measurement_peak_GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6, "long_measurement_s": seconds}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "identification_speed.json")
    parser.add_argument("--long-measurement", action="store_true", help="only that, in this process")
    arguments = parser.parse_args()
    if arguments.long_measurement:
        print(json.dumps(long_measurement()))
        return
    many, two = records(REALISATIONS), records(1)
    lrm, lpm = LocalModel(), LocalModel(denominator=0)
    report = {
        "robust_bla_s": best_of(lambda: robust_bla(many)),
        "robust_lrm_s": best_of(lambda: robust_local(many, lrm)),
        "robust_lrm_13_poses_s": best_of(lambda: [robust_local(many, lrm) for _ in range(POSES)]),
        "robust_lpm_two_experiments_s": best_of(lambda: robust_local(two, lpm)),
        "fast_lpm_two_experiments_s": best_of(lambda: fast_local(two, lpm)),
        "fast_lrm_two_experiments_s": best_of(lambda: fast_local(two, lrm)),
    }
    alone = subprocess.run([sys.executable, __file__, "--long-measurement"], check=True, capture_output=True, text=True)
    report |= json.loads(alone.stdout)
    report = {name: round(value, 4) for name, value in report.items()}
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
