"""FRF files as MATLAB and universal files: what SciPy, pyuff and the format's own field table read is what was identified."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyuff
import scipy.io
from command_line import Isocenter

from hil.identification import FrequencyResponse, write_frf

LINES = np.array([1, 3, 5, 7, 9])
RATE_Hz, PERIOD = 200.0, 400


def response(lines: np.ndarray = LINES) -> FrequencyResponse:
    random = np.random.default_rng(2)
    shape = (len(lines), 2, 2)
    size = 10.0 ** random.uniform(-12, 3, shape)
    G = size * np.exp(2j * np.pi * random.uniform(size=shape))
    none = np.zeros(len(lines))
    return FrequencyResponse(
        lines=lines, frequencies_Hz=lines * RATE_Hz / PERIOD, G=G, G_wz=np.zeros((len(lines), 4, 2), complex),
        noise_covariance=np.tile(np.eye(4, dtype=complex), (len(lines), 1, 1)), total_covariance=None, nonlinear_covariance=None,
        noise_covariance_z=None, total_covariance_z=None, noise_dof=none + 3, total_dof=none,
        output_names=("position_propeller", "position_roll"), input_names=("command_propeller", "command_roll"),
        output_units=("rad", "rad"), input_units=("A", "Nm"), sample_rate_Hz=RATE_Hz, period_samples=PERIOD, method="robust_bla",
        pose=(0.25, -0.5),
    )  # fmt: skip


def written(isocenter: Isocenter, folder: Path, name: str, frf: FrequencyResponse) -> Path:
    write_frf(frf, folder / "arm.frf.npz")
    done = isocenter("convert", folder / "arm.frf.npz", folder / name, "--json", folder / "answer.json")
    assert done.status == 0, done.err
    assert json.loads((folder / "answer.json").read_text())["lines"] == len(frf.lines)
    return folder / name


def test_matlab_gets_every_array_by_its_name(isocenter: Isocenter, tmp_path: Path) -> None:
    frf = response()
    read = scipy.io.loadmat(written(isocenter, tmp_path, "arm.mat", frf), squeeze_me=True)
    np.testing.assert_array_equal(read["G"], frf.G)
    np.testing.assert_array_equal(read["noise_covariance"], frf.noise_covariance)
    np.testing.assert_array_equal(read["frequencies_Hz"], frf.frequencies_Hz)
    assert list(read["output_names"]) == ["position_propeller", "position_roll"]
    assert (read["method"], read["sample_rate_Hz"]) == ("robust_bla", RATE_Hz)


@pytest.mark.parametrize("lines", [LINES, np.array([1, 3, 5, 11, 13])], ids=["even", "uneven"])
@pytest.mark.parametrize("name", ["arm.uff", "arm.unv"])
def test_a_universal_file_holds_a_data_set_for_each_element(isocenter: Isocenter, tmp_path: Path, lines: np.ndarray, name: str) -> None:
    frf = response(lines)
    sets = pyuff.UFF(str(written(isocenter, tmp_path, name, frf))).read_sets()
    assert [(one["rsp_node"], one["ref_node"]) for one in sets] == [(1, 1), (2, 1), (1, 2), (2, 2)]
    for one in sets:
        i, j = int(one["rsp_node"]) - 1, int(one["ref_node"]) - 1
        assert (one["type"], one["func_type"]) == (58, 4)
        np.testing.assert_allclose(one["x"], frf.frequencies_Hz, rtol=1e-5)
        np.testing.assert_allclose(one["data"], frf.G[:, i, j], rtol=1e-10)
        assert one["id1"] == f"{frf.output_names[i]} / {frf.input_names[j]}"
        assert one["orddenom_axis_units_lab"] == frf.input_units[j]


def test_records_of_a_universal_file_stand_in_their_columns(isocenter: Isocenter, tmp_path: Path) -> None:
    """By the format's field table: records of data set 58, in Fortran's columns."""
    frf = response()
    lines = written(isocenter, tmp_path, "arm.uff", frf).read_text().splitlines()
    assert (lines[0].strip(), lines[1].strip()) == ("-1", "58")
    assert all(line.strip() for line in lines[2:7])  # five ID lines, none of them blank
    assert max(map(len, lines)) <= 80
    degrees, form, abscissa, ordinate, denominator, z = lines[7:13]
    assert (int(degrees[:5]), degrees[31:41].strip(), int(degrees[41:51]), int(degrees[51:55])) == (
        4,
        "NONE",
        1,
        0,
    )  # 2(I5,I10),1X,10A1,I10,I4
    assert (degrees[56:66].strip(), int(degrees[66:76]), int(degrees[76:80])) == ("NONE", 1, 0)
    assert [int(form[at : at + 10]) for at in (0, 10, 20)] == [6, 5, 1]  # complex double, five values, even spacing
    assert [float(form[at : at + 13]) for at in (30, 43, 56)] == [0.5, 1.0, 0.0]  # minimum, increment, z
    assert (int(abscissa[:10]), abscissa[26:46].strip(), abscissa[47:67].strip()) == (18, "frequency", "Hz")  # I10,3I5,2(1X,20A1)
    assert (int(ordinate[:10]), ordinate[26:46].strip(), ordinate[47:67].strip()) == (8, "position_propeller", "rad")
    assert (int(denominator[:10]), denominator[26:46].strip(), denominator[47:67].strip()) == (1, "command_propeller", "A")
    assert int(z[:10]) == 0
    values = [float(line[at : at + 20]) for line in lines[13:16] for at in range(0, len(line.rstrip()), 20)]  # 4E20.12
    np.testing.assert_allclose(np.array(values[::2]) + 1j * np.array(values[1::2]), frf.G[:, 0, 0], rtol=1e-10)


@pytest.mark.parametrize(
    ("name", "says"),
    [("arm.csv", "a frequency response cannot be written as `.csv`; .mat, .uff, .unv can"), ("arm.frf.npz", "write to another file")],
)
def test_other_targets_are_refused(isocenter: Isocenter, tmp_path: Path, name: str, says: str) -> None:
    write_frf(response(), tmp_path / "arm.frf.npz")
    refused = isocenter("convert", tmp_path / "arm.frf.npz", tmp_path / name)
    assert refused.status == 2
    assert says in refused.line


def test_an_archive_that_is_no_frf_is_refused(isocenter: Isocenter, tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", a=1)
    refused = isocenter("convert", tmp_path / "other.npz", tmp_path / "x.mat")
    assert refused.status == 2
    assert "not an FRF file" in refused.line


def test_one_frequency_is_no_universal_file(isocenter: Isocenter, tmp_path: Path) -> None:
    frf = response()
    one = {name: getattr(frf, name)[:1] for name in ("lines", "frequencies_Hz", "G", "G_wz", "noise_covariance", "noise_dof", "total_dof")}
    write_frf(replace(frf, **one), tmp_path / "one.npz")
    assert "two or more" in isocenter("convert", tmp_path / "one.npz", tmp_path / "x.uff").line
