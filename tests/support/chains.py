"""Tables 2.1 and 2.2 of the thesis, and poses of the latter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from controllers.models.denavit_hartenberg import DenavitHartenberg

JOINTS = ("j1", "j2", "j3", "j4")
HALF = np.pi / 2

NOMINAL = DenavitHartenberg(
    JOINTS,
    np.array([[0.0, HALF, -HALF, -0.385, 1.0], [0.0, HALF, HALF, 0.0, 1.0], [0.0, HALF, -HALF, 0.0, 1.0], [0.0, np.pi, 0.0, 0.0, 1.0]]),
    np.zeros(4),
)
"""Table 2.1."""

IDENTIFIED = DenavitHartenberg(
    JOINTS,
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


def poses(
    moving: Sequence[int], count: int, seed: int, position_m: float = 0.05e-3, angle_rad: float = 0.2e-3
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles of random poses in which only `moving` joints (1 to 4) move, and noisy measurements of Table 2.2's chain."""
    rng = np.random.default_rng(seed)
    angles = np.zeros((count, 4))
    for joint in moving:
        angles[:, joint - 1] = rng.uniform(-1.0, 1.0, count)
    position, rotation = IDENTIFIED.poses(angles)
    turned = Rotation.from_rotvec(rng.normal(0.0, angle_rad, (count, 3))).as_matrix()
    return angles, position + rng.normal(0.0, position_m, (count, 3)), turned @ rotation
