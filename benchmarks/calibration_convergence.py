"""Kinematic parameters as states (thesis Sec. 5.5, Fig. 5.8): how many images they take, poses interleaved and one axis after the other.

    python benchmarks/calibration_convergence.py --json benchmarks/results/calibration_convergence.json

The 24 parameters of a chain of four joints are the states of an iterated extended Kalman filter; each image gives the pose of one exposure
with 0.05 mm and 0.2 mrad of noise. From Table 2.1 to a machine of Table 2.2, judged after every image on 300 other poses within +-1 rad,
without noise: rms of the distance [mm] and of the angle [mrad]. Medians of twenty draws.
"""

from __future__ import annotations

import argparse

import numpy as np
from calibration_model import NOISE, NOMINAL, SPREAD, TRUE, angles
from scipy.spatial.transform import Rotation

from controllers.models.denavit_hartenberg import DenavitHartenberg
from hil.calibration.kinematic.identify_denavit_hartenberg import pose_difference
from hil.terminal.output import Answer

IMAGES, DRAWS, INNER = 40, 20, 6


class ParameterFilter:
    """Parameters that stay, corrected by one pose at a time."""

    def __init__(self) -> None:
        self.chain, self.covariance = NOMINAL, np.diag(SPREAD**2)
        self.noise = np.diag(np.repeat([NOISE.position_m**2, NOISE.angle_rad**2], 3))

    def take(self, q: np.ndarray, position: np.ndarray, rotation: np.ndarray) -> None:
        """Iterated update: linearised anew about each estimate, the prior kept."""
        prior, now = self.chain.values, self.chain
        for _ in range(INNER):
            model_position, model_rotation = now.poses(q)
            rest = pose_difference(position, rotation, model_position, model_rotation)[0]
            slope = now.jacobian(q)[0]
            gain = np.linalg.solve(slope @ self.covariance @ slope.T + self.noise, slope @ self.covariance).T
            now = now.with_values(prior + gain @ (rest - slope @ (prior - now.values)))
        left = np.eye(len(prior)) - gain @ slope
        self.chain, self.covariance = now, left @ self.covariance @ left.T + gain @ self.noise @ gain.T


def error(chain: DenavitHartenberg, q: np.ndarray) -> tuple[float, float]:
    """Rms distance [mm] and angle [mrad]."""
    difference = 1e3 * pose_difference(*TRUE.poses(q), *chain.poses(q))
    return float(np.sqrt(np.mean(np.sum(difference[:, :3] ** 2, 1)))), float(np.sqrt(np.mean(np.sum(difference[:, 3:] ** 2, 1))))


def order(kind: str, seed: int) -> np.ndarray:
    """Joint angles (IMAGES, 4) of the images."""
    if kind == "interleaved":
        return angles("1234", IMAGES, seed)
    each = IMAGES // 4
    return np.concatenate(
        [angles(joint, each, seed + k) for k, joint in enumerate("2314" if kind == "one axis after the other" else "2222")]
    )


def curve(kind: str) -> list[dict[str, float]]:
    """Held-out error after every image."""
    everywhere, second = angles("1234", 300, 9000), angles("2", 300, 9001)
    table = np.zeros((DRAWS, IMAGES, 3))
    for draw in range(DRAWS):
        rng, q = np.random.default_rng(draw), order(kind, 100 * draw)
        position, rotation = TRUE.poses(q)
        position = position + rng.normal(0.0, NOISE.position_m, position.shape)
        rotation = Rotation.from_rotvec(rng.normal(0.0, NOISE.angle_rad, (IMAGES, 3))).as_matrix() @ rotation
        work = ParameterFilter()
        for k in range(IMAGES):
            work.take(q[k : k + 1], position[k : k + 1], rotation[k : k + 1])
            table[draw, k] = *error(work.chain, everywhere), error(work.chain, second)[0]
    found = np.median(table, axis=0)
    return [
        {"images": k + 1, "held_out_mm": float(a), "held_out_mrad": float(b), "joint_2_alone_mm": float(c)}
        for k, (a, b, c) in enumerate(found)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    options = parser.parse_args()
    to = Answer(options.json)
    answer = {kind: curve(kind) for kind in ("interleaved", "one axis after the other", "joint 2 alone")}
    to.write(answer)


if __name__ == "__main__":
    main()
