"""What the filter knows beforehand: the machine of (5.37), what is random about it, and one run's measurements."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from controllers.models.flexible_chain import FlexibleChain
from controllers.models.swinging_chain import PanelImu

OF_A_MODE = ("log_frequency", "log_damping", "log_mass")
"""Dynamic parameters of a mode, as logarithms of their ratios to the start: they stay positive."""

TOLERANCE = {"m": 5e-3, "rad": 0.02, "-": 0.01}
"""How far a parameter of the chain may be from its drawing; for a compliance half its value."""


@dataclass(frozen=True)
class SwingingMachine:
    """The machine of (5.37) with certain parameters.

    Attributes
    ----------
    chain : FlexibleChain
        Quasi-static: Denavit-Hartenberg rows with gear ratios, frame angles, focal spot, compliances.
    imu : PanelImu
    gravity_m_s2 : (3,) array
        In the phantom's frame.
    swinging : (m,) tuple of int
        Elastic joints that swing, each a mode.
    frequency_Hz, damping : (m,) arrays
    gain : (m, axes) array
        Acceleration of each mode per unit of an axis's effort, [rad/s^2 or m/s^2]: the row of B_m in (5.30) with its modal mass in it.
    """

    chain: FlexibleChain
    imu: PanelImu
    gravity_m_s2: np.ndarray
    swinging: tuple[int, ...]
    frequency_Hz: np.ndarray
    damping: np.ndarray
    gain: np.ndarray

    @property
    def axes(self) -> int:
        """Number of driven axes."""
        return len(self.chain.driven)

    @property
    def modes(self) -> int:
        """Number of modes m."""
        return len(self.swinging)

    @property
    def dynamic_names(self) -> tuple[str, ...]:
        """Names of the dynamic parameters, kind by kind."""
        return tuple(f"{kind}_{self.chain.elastic[k].name}" for kind in OF_A_MODE for k in self.swinging)

    def swing(self, deflection: np.ndarray) -> np.ndarray:
        """Return the deflections (N, e) of all elastic joints from those of the modes (N, m)."""
        result = np.zeros((len(deflection), len(self.chain.elastic)))
        result[:, list(self.swinging)] = deflection
        return result


@dataclass(frozen=True)
class Randomness:
    """Standard deviations of all that is not known.

    Attributes
    ----------
    encoder : (axes,) array
        [rad]
    imu : (6,) array
        White [m/s^2, rad/s].
    jerk : (axes,) array
        White jerk of an axis's motion [rad/s^3 √s]: what its scan does from sample to sample.
    push : (m,) array
        What else drives each mode [rad/s^2]; first order with `push_s`.
    push_s : float
    bias, bias_walk : (6,) arrays
        Of the sensor at the start, and per √s.
    parameters : (p,) array
        Of the chain's parameters at the start; 0: kept.
    parameter_walk : (p,) array
        Per √s.
    dynamic : (3,) array
        Of the logarithms of frequency, damping and mass at the start.
    dynamic_walk : (3,) array
        Per √s.
    """

    encoder: np.ndarray
    imu: np.ndarray
    jerk: np.ndarray
    push: np.ndarray
    push_s: float
    bias: np.ndarray
    bias_walk: np.ndarray
    parameters: np.ndarray
    parameter_walk: np.ndarray
    dynamic: np.ndarray = field(default_factory=lambda: np.array([0.1, 0.5, 0.2]))
    dynamic_walk: np.ndarray = field(default_factory=lambda: np.zeros(3))


def tolerances(chain: FlexibleChain) -> np.ndarray:
    """Return how far each parameter (p,) of a chain may be from its drawing."""
    first = len(chain.names) - len(chain.elastic)
    return np.array([TOLERANCE[unit] for unit in chain.units[:first]] + [0.5 * value for value in chain.compliance])


@dataclass(frozen=True)
class PoseImage:
    """What one image says: poses of focal spot and phantom, seen from the panel.

    Attributes
    ----------
    time_s, arrives_s : float
        Middle of the exposure, and when the image is there.
    source, phantom : (3,) arrays
        [m]
    rotation : (3, 3) array
        From phantom to detector coordinates.
    covariance : (9, 9) array
        Of source, phantom [m] and rotation [rad, detector coordinates].
    """

    time_s: float
    arrives_s: float
    source: np.ndarray
    phantom: np.ndarray
    rotation: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class Run:
    """Measurements of a run of N samples.

    Attributes
    ----------
    time_s : (N,) array
    encoder : (N, axes) array
    imu : (N, 6) array
        NaN where missing.
    effort : (N, axes) array
        Acts from a sample to the next.
    images : tuple of PoseImage
        In the order of their exposures.
    """

    time_s: np.ndarray
    encoder: np.ndarray
    imu: np.ndarray
    effort: np.ndarray
    images: tuple[PoseImage, ...]


def pose_gap(source: np.ndarray, phantom: np.ndarray, rotation: np.ndarray, of: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
    """Return poses less those of a model, (N, 9): source, phantom [m], rotation vector [rad], in detector coordinates."""
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_matrix(rotation @ np.swapaxes(of[2], 1, 2)).as_rotvec()
    return np.concatenate([source - of[0], phantom - of[1], turned], axis=1)
