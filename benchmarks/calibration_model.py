"""Kinematics identified from poses: from Table 2.1 of the thesis to a machine of Table 2.2, four joints.

    python benchmarks/calibration_model.py [--out benchmarks/results/calibration_model.json] [--poses 1200] [--draws 100] [--starts 100]

Joints turn within +-1 rad at random; poses carry 0.05 mm and 0.2 mrad of noise. `held_out`: 500 other poses without noise, rms of the
distance and of the angle. `parameters`: the fit's error over sigma, sigma from as many draws of the noise as `--draws`; worst and second
worst, and how many of the parameters are within 3. `combinations`: rank with these joints moving, and what is not seen. `starts`: from
Table 2.1 with every length off by up to 5 mm, angles by 50 mrad, twists and frame angles by 20 mrad, ratios by 1 %.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from on_engine import add_scheduler, answers
from scipy.spatial.transform import Rotation

from controllers.models.denavit_hartenberg import DenavitHartenberg
from hil.calibration.kinematic.identify_denavit_hartenberg import Identified, PoseNoise, identify_kinematics, pose_difference

HALF = np.pi / 2
NOMINAL = DenavitHartenberg(
    ("j1", "j2", "j3", "j4"),
    np.array([[0.0, HALF, -HALF, -0.385, 1.0], [0.0, HALF, HALF, 0.0, 1.0], [0.0, HALF, -HALF, 0.0, 1.0], [0.0, np.pi, 0.0, 0.0, 1.0]]),
    np.zeros(4),
)
"""Table 2.1."""
TRUE = DenavitHartenberg(
    NOMINAL.joints,
    np.array(
        [
            [-0.6888e-3, 1.5789, -1.5668, -390.0287e-3, 0.9995],
            [0.8832e-3, 1.5786, 1.5769, -0.2988e-3, 0.9978],
            [-0.3489e-3, 1.5655, -1.5774, 5.4242e-3, 0.9981],
            [3.7129e-3, 3.1908, 0.0129, 1.6914e-3, 0.9876],
        ]
    ),
    np.array([2e-4, 1.5e-4, 11e-4, 14e-4]),
)
"""Table 2.2."""
NOISE = PoseNoise(0.05e-3, 0.2e-3)
SPREAD = np.array([*([5e-3, 0.05, 0.02, 5e-3, 0.01] * 4), 0.02, 0.02, 0.02, 0.02])
MOVING = {"1234": 24, "234": 21, "123": 19, "124": 19, "134": 19, "23": 16, "12": 14, "34": 16, "2": 11, "3": 11, "1": 9}
"""Combinations that must be seen with these joints moving."""


def angles(moving: str, count: int, seed: int) -> np.ndarray:
    """(N, 4)"""
    values = np.zeros((count, 4))
    columns = [int(joint) - 1 for joint in moving]
    values[:, columns] = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(columns)))
    return values


def fitted(q: np.ndarray, seed: int, start: DenavitHartenberg = NOMINAL) -> Identified:
    """From one draw of the noise."""
    rng = np.random.default_rng(seed)
    position, rotation = TRUE.poses(q)
    turned = Rotation.from_rotvec(rng.normal(0.0, NOISE.angle_rad, (len(q), 3))).as_matrix() @ rotation
    return identify_kinematics(start, q, position + rng.normal(0.0, NOISE.position_m, (len(q), 3)), turned, NOISE)


def held_out(model: DenavitHartenberg, moving: str = "1234") -> tuple[float, float]:
    """Rms of position [m] and angle [rad] at 500 other poses."""
    q = angles(moving, 500, 99)
    difference = pose_difference(*TRUE.poses(q), *model.poses(q))
    return float(np.sqrt(np.mean(np.sum(difference[:, :3] ** 2, axis=1)))), float(np.sqrt(np.mean(np.sum(difference[:, 3:] ** 2, axis=1))))


def values_of(poses: int, seed: int) -> list[float]:
    """Parameters of a fit that begins at the true ones, by one draw of the noise."""
    return [float(each) for each in fitted(angles("1234", poses, 1), seed, TRUE).model.values]


def reached_from(poses: int, start: list[float]) -> tuple[float, float]:
    """Where a fit from other parameters ends, as held-out rms."""
    return held_out(fitted(angles("1234", poses, 1), 2, NOMINAL.with_values(np.array(start))).model)


def measure(poses: int, draws: int, starts: int, scheduler: str | None) -> dict[str, object]:
    """All of it."""
    q = angles("1234", poses, 1)
    began = time.process_time()
    one = fitted(q, 2)
    seconds = time.process_time() - began
    position, angle = held_out(one.model)
    drawn = answers(values_of, [{"poses": poses, "seed": 1000 + k} for k in range(draws)], scheduler)
    scatter = np.array(drawn) - TRUE.values
    sigma = np.sqrt(np.mean(scatter**2, axis=0))
    ratio = np.abs(one.model.values - TRUE.values) / sigma
    reported = np.sqrt(np.diag(one.covariance))
    combinations = {}
    for moving, rank in MOVING.items():
        result = fitted(angles(moving, 300, 3), 4)
        rms = held_out(result.model, moving)
        combinations[moving] = {
            "rank": result.rank,
            "expected": rank,
            "held_out_m": rms[0],
            "held_out_rad": rms[1],
            "not_seen": [str(each) for each in result.null],
            "frozen": result.frozen,
        }
    exact = angles("1234", 300, 5)
    at_nominal = identify_kinematics(NOMINAL, exact, *NOMINAL.poses(exact), NOISE)
    rng = np.random.default_rng(6)
    begun = [{"poses": poses, "start": (NOMINAL.values + SPREAD * rng.uniform(-1.0, 1.0, 24)).tolist()} for _ in range(starts)]
    reached = answers(reached_from, begun, scheduler)
    return {
        "poses": poses,
        "held_out": {"position_m": position, "angle_rad": angle},
        "processor_s": seconds,
        "parameters": {
            "draws": draws,
            "within_3_sigma": int(np.sum(ratio < 3.0)),
            "of": len(ratio),
            "error_over_sigma": dict(zip(NOMINAL.names, ratio.round(3).tolist(), strict=True)),
            "sigma": dict(zip(NOMINAL.names, sigma.tolist(), strict=True)),
            "reported_over_sigma": dict(zip(NOMINAL.names, (reported / sigma).round(3).tolist(), strict=True)),
        },
        "combinations": combinations,
        "rank_at_table_2_1": {"rank": at_nominal.rank, "not_seen": [str(each) for each in at_nominal.null]},
        "starts": {
            "count": starts,
            "worst_position_m": max(each[0] for each in reached),
            "worst_angle_rad": max(each[1] for each in reached),
        },
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "calibration_model.json")
    parser.add_argument("--poses", type=int, default=1200)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--starts", type=int, default=100)
    add_scheduler(parser)
    given = parser.parse_args()
    text = json.dumps(measure(given.poses, given.draws, given.starts, given.scheduler), indent=2)
    given.out.write_text(text + "\n")
    print(text)
