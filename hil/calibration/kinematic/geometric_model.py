"""A fitted kinematic model as a calibration: deviations from the nominal geometry for any axis positions, and its file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from controllers.models.flexible_chain import FlexibleChain
from hil.calibration.kinematic.flexible import beam_of
from hil.calibration.kinematic.nominal_chain import nominal_chain
from hil.calibration.use.lookup_table import LookUp, look_up_from
from hil.errors import UnusableInputError
from hil.files.arrays import read_arrays, write_arrays
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine

FORMAT = 1
KIND = "model"


@dataclass(frozen=True)
class GeometricModel:
    """The model-based calibration of a machine (thesis Sec. 2.2.3).

    Attributes
    ----------
    machine : Machine
        Whose file says the nominal geometry.
    chain : FlexibleChain
    covariance : (p, p) array
        Of the chain's values.
    notes : mapping
        Machine, its hash, scans, rank, null combinations, frozen parameters.
    """

    machine: Machine
    chain: FlexibleChain
    covariance: np.ndarray
    notes: Mapping[str, Any]

    def require(self, machine: Machine) -> None:
        """Refuse another machine's positions.

        Raises
        ------
        UnusableInputError
        """
        if machine.name != self.machine.name or machine.axes != self.machine.axes:
            raise UnusableInputError(f"the model is of {self.machine.name}; calibrate {machine.name}")

    def at(self, positions: np.ndarray) -> np.ndarray:
        """Return deviations (M, 9) from the nominal geometry at positions (M, axes), as `ConeBeam.moved` takes them; static poses."""
        positions = np.atleast_2d(positions)
        return beam_of(self.chain, positions).deviation_from(nominal_beam(self.machine, positions))

    def covariance_at(self, positions: np.ndarray) -> np.ndarray:
        """Return the covariance (M, 9, 9) of those deviations, from the parameters' alone, without the model's own error."""
        jacobian = self.chain.jacobian(np.atleast_2d(positions))
        jacobian[:, 6:] *= -1.0
        half = jacobian @ self._root
        covariance: np.ndarray = half @ np.swapaxes(half, 1, 2)
        return covariance

    @cached_property
    def _root(self) -> np.ndarray:
        """Return R (p, p) with R R' the covariance."""
        scale = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        size, turned = np.linalg.eigh(self.covariance / scale / scale[:, None])
        vectors: np.ndarray = scale[:, None] * turned * np.sqrt(np.maximum(size, 0.0))
        return vectors


Calibration = LookUp | GeometricModel


def write_model(model: GeometricModel, path: Path) -> None:
    """Write the model to its file; raise RecordingError where it cannot be written."""
    arrays = {
        "format": FORMAT,
        "kind": KIND,
        "axes": model.machine.axes,
        "names": model.chain.names,
        "units": model.chain.units,
        "values": model.chain.values,
        "covariance": model.covariance,
        "notes": json.dumps(dict(model.notes)),
    }
    write_arrays(path, arrays)


def read_calibration(path: Path, machine: Machine) -> Calibration:
    """Read a look-up table or a model for a machine.

    Raises
    ------
    UnusableInputError
        Missing, neither of the two, or another machine's.
    """
    arrays = read_arrays(path, "a calibration of isocenter calibrate phantom or model")
    is_model = str(arrays.get("kind", "")) == KIND
    result: Calibration = _model(path, machine, arrays) if is_model else look_up_from(path, arrays)
    result.require(machine)
    return result


def _model(path: Path, machine: Machine, arrays: Mapping[str, np.ndarray]) -> GeometricModel:
    chain = nominal_chain(machine)
    size = len(chain.names)
    try:
        if int(arrays["format"]) != FORMAT:
            raise UnusableInputError(f"{path}: format {int(arrays['format'])}; this version reads {FORMAT}")
        notes = json.loads(str(arrays["notes"]))
        made_for, names = notes["machine"], tuple(str(name) for name in arrays["names"])
        values, covariance = arrays["values"], arrays["covariance"]
    except UnusableInputError:
        raise
    except (ValueError, KeyError, TypeError) as error:
        raise UnusableInputError(f"{path}: no model of isocenter calibrate model ({error})") from None
    if made_for != machine.name or names != chain.names:
        raise UnusableInputError(f"{path}: a model of {made_for} with {len(names)} parameters; {machine.name} has {size}")
    if values.shape != (size,) or covariance.shape != (size, size):
        raise UnusableInputError(
            f"{path}: values and covariance must be of {size} parameters; they are {values.shape} and {covariance.shape}"
        )
    return GeometricModel(machine, chain.with_values(values), covariance, notes)
