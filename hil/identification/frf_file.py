"""FRF files: NumPy .npz archives, laid out in docs/generated/file-formats.md."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import IdentificationError
from hil.files.arrays import read_arrays, write_arrays
from hil.identification.result import Distortion, FrequencyResponse

FORMAT = 1
_OPTIONAL = ("noise_covariance", "total_covariance", "nonlinear_covariance", "noise_covariance_z", "total_covariance_z")
_ARRAYS = ("lines", "frequencies_Hz", "G", "G_wz", "noise_dof", "total_dof")
_NAMES = ("output_names", "input_names", "output_units", "input_units", "notes")


def write_frf(response: FrequencyResponse, path: str | Path) -> None:
    """Write an FRF file; covariances that do not exist are left out."""
    arrays: dict[str, np.ndarray] = {
        "format": np.array(FORMAT),
        "method": np.array(response.method),
        "settings": np.array(json.dumps(response.settings)),
    }
    arrays |= {name: np.asarray(getattr(response, name)) for name in _ARRAYS}
    arrays |= {name: np.asarray(getattr(response, name), dtype=np.str_) for name in _NAMES}
    arrays |= {name: value for name in _OPTIONAL if (value := getattr(response, name)) is not None}
    arrays |= {
        "sample_rate_Hz": np.array(response.sample_rate_Hz),
        "period_samples": np.array(response.period_samples),
        "pose": np.asarray(response.pose, float),
    }
    if response.even_odd is not None:
        arrays |= {
            "distortion_lines": response.even_odd.lines,
            "distortion_frequencies_Hz": response.even_odd.frequencies_Hz,
            "distortion_level": response.even_odd.level,
            "distortion_noise": response.even_odd.noise,
            "distortion_dof": np.array(response.even_odd.dof),
        }
    write_arrays(path, arrays)


def read_frf(path: str | Path) -> FrequencyResponse:
    """Read an FRF file.

    Raises
    ------
    IdentificationError
        The file is missing, is no .npz archive, or lacks an array.
    """
    arrays = read_arrays(path, "an FRF file", IdentificationError)
    missing = [
        name
        for name in (*_ARRAYS, *_NAMES, "format", "method", "settings", "sample_rate_Hz", "period_samples", "pose")
        if name not in arrays
    ]
    if missing:
        raise IdentificationError(f"{path}: not an FRF file: the array {missing[0]} is missing")
    if int(arrays["format"]) != FORMAT:
        raise IdentificationError(f"{path}: FRF format {int(arrays['format'])}; this version reads {FORMAT}")
    even_odd = None
    if "distortion_lines" in arrays:
        even_odd = Distortion(
            lines=arrays["distortion_lines"],
            frequencies_Hz=arrays["distortion_frequencies_Hz"],
            level=arrays["distortion_level"],
            noise=arrays["distortion_noise"],
            dof=int(arrays["distortion_dof"]),
        )
    fields: dict[str, Any] = {name: arrays[name] for name in _ARRAYS}
    fields |= {name: arrays.get(name) for name in _OPTIONAL}
    fields |= {name: tuple(str(text) for text in arrays[name]) for name in _NAMES}
    return FrequencyResponse(
        **fields,
        sample_rate_Hz=float(arrays["sample_rate_Hz"]),
        period_samples=int(arrays["period_samples"]),
        pose=tuple(float(value) for value in arrays["pose"]),
        method=str(arrays["method"]),
        settings=json.loads(str(arrays["settings"])),
        even_odd=even_odd,
    )
