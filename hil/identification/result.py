"""The result of an identification: a frequency response matrix with its covariances."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from hil.errors import IdentificationError
from hil.identification.covariance import circle_factor, hotelling_bound, variances

EMULATED = "emulated"
"""Key of a response's settings, 1 where a recording of it was made on the emulator."""
if TYPE_CHECKING:
    import control

CovarianceKind = Literal["noise", "total", "nonlinear"]


@dataclass(frozen=True)
class Distortion:
    """Distortion of the outputs on lines that were not excited, averaged over the records.

    Attributes
    ----------
    lines : (K,) unexcited lines inside the excited band.
    frequencies_Hz : (K,)
    level : (K, n_y) mean |y - G u|^2 less the noise's share, not below zero; squared output units, amplitude of the Fourier coefficient.
    noise : (K, n_y) the noise's share of the mean square.
    dof : complex degrees of freedom of `level` before the noise is taken off: records averaged.
    """

    lines: np.ndarray
    frequencies_Hz: np.ndarray
    level: np.ndarray
    noise: np.ndarray
    dof: int

    @property
    def even(self) -> np.ndarray:
        """Lines (K,) bool that even nonlinearities reach when only odd lines are excited."""
        is_even: np.ndarray = self.lines % 2 == 0
        return is_even


@dataclass(frozen=True)
class FrequencyResponse:
    """Frequency response matrix at the excited lines of one pose.

    Attributes
    ----------
    lines, frequencies_Hz : (L,)
    G : (L, n_y, n_u) complex, output unit per input unit, from the inputs to the outputs as sampled (`hil.identification.records`).
    noise_covariance, total_covariance : (L, n_y n_u, n_y n_u) of vec(G), columns stacked; of this estimate, all averaging counted.
        None where the data do not determine it (one period; one realisation without detection lines).
    nonlinear_covariance : the same, of the stochastic nonlinear distortion of one realisation.
    noise_covariance_z, total_covariance_z : (L, n_z, n_z) of one column of the averaged [Y; U] (Y alone in open loop); for fast local
        methods of one line of the compensated outputs.
    noise_dof, total_dof : (L,) complex degrees of freedom behind the covariances; 0 where there is none.
    G_wz : (L, n_z, n_u) closed-loop response from the excitation to [y; u].
    even_odd : distortion on unexcited lines, or None where every line of the band is excited.
    pose : scheduling parameters in rad or m, empty if unknown.
    method, settings, notes : how it was made; what a user should know about it.
    """

    lines: np.ndarray
    frequencies_Hz: np.ndarray
    G: np.ndarray
    G_wz: np.ndarray
    noise_covariance: np.ndarray | None
    total_covariance: np.ndarray | None
    nonlinear_covariance: np.ndarray | None
    noise_covariance_z: np.ndarray | None
    total_covariance_z: np.ndarray | None
    noise_dof: np.ndarray
    total_dof: np.ndarray
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_units: tuple[str, ...]
    sample_rate_Hz: float
    period_samples: int
    method: str
    settings: dict[str, float | int | str] = field(default_factory=dict)
    even_odd: Distortion | None = None
    pose: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def emulated(self) -> bool:
        """Whether a recording that it was identified from was made on the emulator."""
        return self.settings.get(EMULATED) == 1

    def covariance(self, kind: CovarianceKind) -> np.ndarray:
        """Return the covariance of vec(G), (L, n_y n_u, n_y n_u).

        Raises IdentificationError where the data do not determine it.
        """
        chosen = {"noise": self.noise_covariance, "total": self.total_covariance, "nonlinear": self.nonlinear_covariance}[kind]
        if chosen is None:
            needs = {
                "noise": "two periods or more",
                "total": "two realisations, detection lines, or a fast local method",
                "nonlinear": "a noise and a total covariance",
            }
            raise IdentificationError(f"this frequency response ({self.method}) has no {kind} covariance: it takes {needs[kind]}")
        return chosen

    @property
    def control(self) -> control.FRD:
        """The response as an object of python-control, sampled, with the names of inputs and outputs; without covariances."""
        import control  # takes half a second to load, and only this needs it

        data, omega_rad_s = np.moveaxis(self.G, 0, -1), 2.0 * np.pi * self.frequencies_Hz
        return control.FRD(data, omega_rad_s, dt=1.0 / self.sample_rate_Hz, inputs=list(self.input_names), outputs=list(self.output_names))

    def standard_deviation(self, kind: CovarianceKind = "total") -> np.ndarray:
        """Return the standard deviation of each complex element, sqrt(E |error|^2): (L, n_y, n_u)."""
        root: np.ndarray = np.sqrt(np.maximum(variances(self.covariance(kind), *self.G.shape[1:]), 0.0))
        return root

    def bound(self, probability: float = 0.95, kind: Literal["noise", "total"] | None = None) -> np.ndarray:
        """Return the radius of the circle round each element of G that holds the true value with `probability`: (L, n_y, n_u).

        The errors are circular complex normal and their variances are estimates, hence sqrt(F(2, 2 dof)). `kind` None takes the total
        covariance where there is one, else that of the noise.
        """
        if kind is None:
            kind = "noise" if self.total_covariance is None else "total"
        dof = self.noise_dof if kind == "noise" else self.total_dof
        radii: np.ndarray = circle_factor(dof, probability)[:, None, None] * self.standard_deviation(kind)
        return radii

    def column_distance(self, truth: np.ndarray, kind: Literal["noise", "total"] = "total") -> np.ndarray:
        """Return the squared Mahalanobis distance (L, n_u) of each column of G from `truth` (L, n_y, n_u).

        Compare it with `column_distance_bound`. NaN where there are fewer degrees of freedom than outputs: such a covariance has no
        inverse.
        """
        lines, n_y, n_u = self.G.shape
        usable = (self.noise_dof if kind == "noise" else self.total_dof) >= n_y
        covariance = self.covariance(kind)[usable]
        distance = np.full((lines, n_u), np.nan)
        for j in range(n_u):
            block = covariance[:, j * n_y : (j + 1) * n_y, j * n_y : (j + 1) * n_y]
            error = (self.G - truth)[usable, :, j]
            distance[usable, j] = np.real(np.einsum("li,li->l", np.conj(error), np.linalg.solve(block, error[:, :, None])[:, :, 0]))
        return distance

    def column_distance_bound(self, probability: float = 0.95, kind: Literal["noise", "total"] = "total") -> np.ndarray:
        """Return Hotelling's bound on `column_distance`, (L,); NaN where there are fewer degrees of freedom than outputs."""
        return hotelling_bound(self.G.shape[1], self.noise_dof if kind == "noise" else self.total_dof, probability)
