"""How long one step of the observer takes: the square-root UKF with 24 states and 10 measurements, beside filterpy and vectorised NumPy.

    python benchmarks/observer.py --json -

filterpy and NumPy run on a linear model of the same size, whose transition and outputs cost them one product of matrices a sigma point: the
filters' own arithmetic is what is compared. Medians of single calls, and the fastest tenth, on whatever else the machine is doing.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "observers"))

from observed_models import small_model, small_noise

from controllers.observers.modal_observer import ModalObserver, filter_step

STEPS = 4000


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
    alone = timed(lambda: filter_step(*inside, observer._kind, False, u, z, observer._summary))
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    target = parser.parse_args().json
    answer: dict = {"states": 24, "measurements": 10}
    for kind in ("kf", "ekf", "ukf"):
        answer[kind], answer[f"{kind}_with_everything_published"] = compiled(kind)
    answer["ukf_25_states_with_an_adapted_mode"], _ = compiled("ukf", (0,))
    answer |= {"filterpy_ukf": filterpys(24, 10), "numpy_ukf": numpys(24, 10)}
    text = json.dumps(answer, indent=2)
    if target == "-":
        sys.stdout.write(text + "\n")
    else:
        Path(target).write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
