"""Observer designs as NumPy .npz archives, laid out in docs/generated/file-formats.md."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import numpy as np

from controllers.errors import DesignError
from controllers.models.chain import Chain
from controllers.models.modal import InertialSensor, ModalModel
from controllers.observers.settings import ObserverNoise
from hil.errors import UnusableInputError
from hil.files.arrays import read_arrays, write_arrays
from hil.observing.observer_design import ObserverDesign
from hil.observing.unseen import Unseen

FORMAT, WITHOUT_COUPLING = 3, 2
"""The format that is written, and an older one that can be read: without coupling, steps of drives, places and low passes."""

_UNSEEN: dict[str, type] = {field.name: np.str_ if field.type == "str" else float for field in fields(Unseen)}
_CHAIN = ("axes", "points", "revolute", "gravity_m_s2")
_SENSOR = ("body_end_m", "sensor_end_m", "rotation", "lag_s", "channels")


def write_design(design: ObserverDesign, path: str | Path) -> None:
    """Write a design."""
    model, noise = design.model, design.noise
    arrays: dict[str, Any] = {"observer_format": FORMAT}
    arrays |= {f"chain_{name}": getattr(model.chain, name) for name in _CHAIN}
    arrays |= {f"sensor_{name}": np.array([getattr(sensor, name) for sensor in model.sensors]) for name in _SENSOR}
    for name in ("axes", "source_end_m", "harmonics", "coefficients", "sample_rate_Hz", "effort_limit", "effort_step", "position_unit"):
        arrays[name] = np.array(getattr(model, name))
    if model.directions is not None:
        arrays["directions"] = model.directions
    if model.turning is not None:
        arrays["turning"] = model.turning
    if model.coupling is not None:
        arrays["coupling"] = model.coupling
    arrays["places"] = np.array(model.places, dtype=np.str_)
    arrays |= {f"noise_{field.name}": np.array(getattr(noise, field.name)) for field in fields(noise)}
    arrays |= {"isocenter_m": design.isocenter_m, "machine": design.machine, "machine_hash": design.machine_hash}
    arrays["poses"] = design.poses
    arrays["notes"] = np.array(design.notes, dtype=np.str_)
    for name in _UNSEEN if design.unseen else ():
        arrays[f"unseen_{name}"] = np.array([getattr(each, name) for each in design.unseen], dtype=_UNSEEN[name])
    write_arrays(path, arrays)


def read_design(path: str | Path) -> ObserverDesign:
    """Read a design.

    Raises
    ------
    UnusableInputError
        The file is missing, is no design, or does not fit together.
    """
    arrays = read_arrays(path, "an observer design, which `isocenter observe --save-design` writes")
    if str(arrays.get("observer_format")) not in (str(FORMAT), str(WITHOUT_COUPLING)):
        raise UnusableInputError(
            f"{path}: not an observer design of format {FORMAT} or {WITHOUT_COUPLING}; `isocenter observe --save-design` writes one"
        )
    try:
        design = _design(arrays)
        design.observer()
    except KeyError as missing:
        raise UnusableInputError(f"{path}: not an observer design: the array {missing} is missing") from None
    except DesignError as error:
        raise UnusableInputError(f"{path}: {' '.join(str(error).split())}") from None
    except (TypeError, ValueError, IndexError) as error:
        raise UnusableInputError(
            f"{path}: not an observer design: its arrays do not fit together ({' '.join(str(error).split())})"
        ) from None
    return design


def _design(arrays: dict[str, np.ndarray]) -> ObserverDesign:
    sensors = tuple(
        InertialSensor(
            body_end_m=arrays["sensor_body_end_m"][s],
            sensor_end_m=arrays["sensor_sensor_end_m"][s],
            rotation=arrays["sensor_rotation"][s],
            lag_s=float(arrays["sensor_lag_s"][s]),
            channels=tuple(str(name) for name in arrays["sensor_channels"][s]),
        )
        for s in range(len(arrays["sensor_lag_s"]))
    )
    model = ModalModel(
        axes=tuple(str(axis) for axis in arrays["axes"]),
        chain=Chain(*(arrays[f"chain_{name}"] for name in _CHAIN)),
        sensors=sensors,
        source_end_m=arrays["source_end_m"],
        harmonics=tuple(int(order) for order in arrays["harmonics"]),
        coefficients=arrays["coefficients"],
        sample_rate_Hz=float(arrays["sample_rate_Hz"]),
        effort_limit=arrays["effort_limit"],
        position_unit=tuple(str(unit) for unit in arrays["position_unit"]),
        directions=arrays.get("directions"),
        turning=arrays.get("turning"),
        coupling=arrays.get("coupling"),
        places=tuple(str(place) for place in arrays.get("places", ())),
        effort_step=arrays.get("effort_step", np.zeros(0)),
    )
    optional = {field.name for field in fields(ObserverNoise) if field.default is not MISSING or field.default_factory is not MISSING}
    given = [field.name for field in fields(ObserverNoise) if field.name not in optional or f"noise_{field.name}" in arrays]
    noise: dict[str, Any] = {name: _plain(arrays[f"noise_{name}"]) for name in given}
    return ObserverDesign(
        model,
        ObserverNoise(**noise),
        arrays["isocenter_m"],
        str(arrays["machine"]),
        str(arrays["machine_hash"]),
        tuple(str(note) for note in arrays["notes"]),
        arrays.get("poses", np.zeros((0, 0))),
        _unseen(arrays),
    )


def _unseen(arrays: dict[str, np.ndarray]) -> tuple[Unseen, ...]:
    """Return what the alarm does not see; nothing of a design from before it was found."""
    if "unseen_what" not in arrays:
        return ()
    columns = [arrays[f"unseen_{name}"].tolist() for name in _UNSEEN if name != "tried" or "unseen_tried" in arrays]
    return tuple(Unseen(*row) for row in zip(*columns, strict=True))


def _plain(value: np.ndarray) -> float | np.ndarray:
    return float(value) if value.ndim == 0 else value
