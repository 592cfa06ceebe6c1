"""Frequency responses for other programs: MATLAB (`.mat`) and Universal File Format, data set 58 (`.uff`, `.unv`)."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

import numpy as np
import scipy.io

from hil.errors import IdentificationError, UnusableInputError
from hil.extras import extra_package
from hil.files.arrays import read_arrays
from hil.files.atomic import write_atomically
from hil.identification.frf_file import read_frf
from hil.identification.result import FrequencyResponse

WRITABLE = (".mat", ".uff", ".unv")

# Universal data set 58: field 1 of record 6, and "specific data types" of records 8 to 10
_FREQUENCY_RESPONSE = 4
_FREQUENCY, _GENERAL = 18, 1
_DATA_TYPES = {"rad": 8, "m": 8, "rad/s": 11, "m/s": 11, "rad/s^2": 12, "m/s^2": 12, "N": 13, "Nm": 13}
_COMPLEX_DOUBLE = 6
_SCALAR = 0

_LINE, _LABEL = 80, 20
"""Longest ID line, and longest label of an axis or its unit."""

EVEN = 1e-9
"""Departure of a frequency from an even grid, in steps, below which the grid is even."""


def convert_frf(source: Path, target: Path) -> FrequencyResponse:
    """Write an FRF file for another program; return what was read.

    Raises
    ------
    IdentificationError
        The source is no FRF file.
    UnusableInputError
        The target's suffix is none of `WRITABLE`, or pyuff is not installed.
    """
    suffix = target.suffix.lower()
    if suffix not in WRITABLE:
        raise UnusableInputError(f"{target}: a frequency response cannot be written as `{target.suffix}`; {', '.join(WRITABLE)} can")
    response = read_frf(source)
    write_atomically({target: _mat(source) if suffix == ".mat" else _universal(response, source.name)})
    return response


def _mat(source: Path) -> bytes:
    """Return every array of the file under its own name; lists of texts as cell arrays."""
    arrays = read_arrays(source, "an FRF file", IdentificationError)
    kept: dict[str, object] = {}
    for name, array in arrays.items():
        if array.dtype.kind == "U":
            kept[name] = str(array) if array.ndim == 0 else np.array([str(text) for text in array], dtype=object)
        else:
            kept[name] = array
    content = io.BytesIO()
    scipy.io.savemat(content, kept, do_compression=True, oned_as="column", long_field_names=True)
    return content.getvalue()


def _universal(response: FrequencyResponse, name: str) -> bytes:
    """Return a data set 58 for each element of the matrix, column by column.

    Response node i + 1 is output i, reference node j + 1 input j, each a scalar. Frequencies on an even grid are written as such, others
    one by one with six digits, as the format has them.
    """
    pyuff = extra_package("pyuff", "universal files (UFF)")
    if len(response.frequencies_Hz) < 2:
        raise IdentificationError(f"{name}: one frequency; a universal file takes two or more")
    steps = np.diff(response.frequencies_Hz)
    is_even = bool(np.all(np.abs(steps - steps[0]) <= EVEN * steps[0]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frf.uff"
        sets = pyuff.UFF(str(path))
        for j, reference in enumerate(response.input_names):
            for i, output in enumerate(response.output_names):
                of_output, of_input = response.output_units[i], response.input_units[j]
                sets.write_sets(
                    {
                        "type": 58,
                        "binary": 0,
                        "id1": f"{output} / {reference}"[:_LINE],
                        "id2": name[:_LINE],
                        "id3": "NONE",
                        "id4": _pose(response)[:_LINE],
                        "id5": f"{response.method} at {response.sample_rate_Hz:g} Hz"[:_LINE],
                        "func_type": _FREQUENCY_RESPONSE,
                        "rsp_node": i + 1,
                        "rsp_dir": _SCALAR,
                        "ref_node": j + 1,
                        "ref_dir": _SCALAR,
                        "ord_data_type": _COMPLEX_DOUBLE,
                        "num_pts": len(response.frequencies_Hz),
                        "abscissa_spacing": int(is_even),
                        "abscissa_spec_data_type": _FREQUENCY,
                        "abscissa_axis_lab": "frequency",
                        "abscissa_axis_units_lab": "Hz",
                        "ordinate_spec_data_type": _DATA_TYPES.get(of_output, _GENERAL),
                        "ordinate_axis_lab": output[:_LABEL],
                        "ordinate_axis_units_lab": of_output[:_LABEL],
                        "orddenom_spec_data_type": _DATA_TYPES.get(of_input, _GENERAL),
                        "orddenom_axis_lab": reference[:_LABEL],
                        "orddenom_axis_units_lab": of_input[:_LABEL],
                        "x": response.frequencies_Hz,
                        "data": response.G[:, i, j],
                    },
                    "add",
                )
        return path.read_bytes()


def _pose(response: FrequencyResponse) -> str:
    return "pose " + " ".join(f"{value:.6g}" for value in response.pose) if response.pose else "NONE"
