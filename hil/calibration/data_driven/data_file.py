"""The file of a data-driven calibration: the geometry of a recording at every sample, and the parameters to continue from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.calibration.data_driven.observed_beam import ObservedBeam
from hil.calibration.data_driven.quasi_static import QuasiStatic
from hil.calibration.data_driven.values import Calibration, Parameters
from hil.errors import UnusableInputError
from hil.files.arrays import read_arrays, write_arrays
from hil.imaging.geometry import ConeBeam
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine

FORMAT = 1

_ARRAYS = ("time_s", "positions", "live", "final", "sigma", "values", "covariance")


@dataclass(frozen=True)
class DataFile:
    """Geometry over one recording.

    Attributes
    ----------
    machine : str
    axes, names : tuples of str
        Of the machine; of the parameters.
    time_s : (N,) array
    positions : (N, axes) array
        Link sides as used.
    live, final : (N, 9) arrays
        Deviations from the nominal geometry at `positions`: as known at each sample, and with the parameters found at the end.
    sigma : (N, 9) array
        Standard deviations of `live`.
    values, covariance : (p,), (p, p) arrays
        The parameters at the end.
    static : (4, 9) array
        Of the observer that was used, see `ObservedBeam`; zero without one.
    """

    machine: str
    axes: tuple[str, ...]
    names: tuple[str, ...]
    time_s: np.ndarray
    positions: np.ndarray
    live: np.ndarray
    final: np.ndarray
    sigma: np.ndarray
    values: np.ndarray
    covariance: np.ndarray
    static: np.ndarray

    def parameters(self, model: QuasiStatic) -> Parameters:
        """Return the parameters, to start another scan's calibration from.

        Raises
        ------
        UnusableInputError
            Another machine's, or of other parameters.
        """
        if self.machine != model.machine.name or self.names != model.names:
            raise UnusableInputError(
                f"the calibration is of {self.machine} with {len(self.names)} parameters; {model.machine.name} has others"
            )
        return Parameters(self.values, self.covariance)

    def beam(self, machine: Machine, time_s: np.ndarray) -> ConeBeam:
        """Return the geometry at times (M,) of the recording.

        Raises
        ------
        UnusableInputError
            Another machine's, or a time outside of the recording.
        """
        if self.machine != machine.name or self.axes != machine.axes:
            raise UnusableInputError(f"the calibration is of {self.machine} with axes {', '.join(self.axes)}, not of {machine.name}")
        found = ObservedBeam(self.time_s, self.positions, self.final, np.zeros((len(self.time_s), 3)), np.zeros(6))
        positions, deviation, _ = found.at(time_s)
        return nominal_beam(machine, positions).moved(deviation)


def correlation(covariance: np.ndarray) -> np.ndarray:
    """Return correlations (N, 36) of covariances (N, 9, 9), by rows above the diagonal, in single precision.

    They are zero where there is no variance.
    """
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    first, second = np.triu_indices(9, 1)
    product = sigma[:, first] * sigma[:, second]
    shares: np.ndarray = np.divide(covariance[:, first, second], product, out=np.zeros_like(product), where=product > 0.0)
    return shares.astype(np.float32)


def write_data_file(model: QuasiStatic, observed: ObservedBeam, found: Calibration, path: Path) -> None:
    """Write the calibration to its file; raise RecordingError where it cannot be written."""
    arrays = {
        "data_calibration_format": FORMAT,
        "machine": model.machine.name,
        "axes": model.machine.axes,
        "names": model.names,
        "units": model.units,
        "time_s": observed.time_s,
        "positions": observed.positions,
        "live": found.live,
        "final": found.final,
        "sigma": found.sigma,
        "correlation": correlation(found.covariance),
        "values": found.parameters.values,
        "covariance": found.parameters.covariance,
        "static": observed.static,
    }
    write_arrays(path, arrays)


def read_data_file(path: Path) -> DataFile:
    """Read a file of `write_data_file`.

    Raises
    ------
    UnusableInputError
        Missing, or another file.
    """
    arrays = read_arrays(path, "a data-driven calibration")
    if int(arrays.get("data_calibration_format", -1)) != FORMAT:
        raise UnusableInputError(f"{path}: no data-driven calibration of format {FORMAT}; `isocenter calibrate data` writes one")
    absent = [name for name in ("machine", "axes", "names", *_ARRAYS) if name not in arrays]
    if absent:
        raise UnusableInputError(f"{path}: holds no {', '.join(absent)}; `isocenter calibrate data` writes a whole one")
    text = {name: tuple(str(each) for each in arrays[name]) for name in ("axes", "names")}
    static = arrays.get("static", np.zeros((4, 9)))  # absent in some files: then as without an observer
    return DataFile(str(arrays["machine"]), text["axes"], text["names"], *(*(arrays[name] for name in _ARRAYS), static))
