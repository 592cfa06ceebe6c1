"""Without the packages of the extra `imaging` a command says which one it needs, before anything moves."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from commands import isocenter

from hil.errors import UnusableInputError
from hil.imaging.markers.canny_hough import edges_of
from hil.reconstruction.filtered_backprojection import parallel_projections

PACKAGES = ("tifffile", "skimage", "itk", "pydicom")  # what scikit-image, itk-rtk and pydicom of the extra bring


@pytest.fixture
def without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] in PACKAGES]:
        monkeypatch.delitem(sys.modules, name)
    for name in PACKAGES:
        monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.usefixtures("without_the_extra")
def test_a_run_with_images_says_so_before_it_moves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    static = ["run", "static", "-m", "carm", "-b", "lockstep:", "--seconds", "0.5", "-o", tmp_path / "r.mf4"]
    assert isocenter(*static, "--images", tmp_path / "images") == 2
    error = capsys.readouterr().err
    assert "images need scikit-image: pip install 'isocenter[imaging]'" in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("without_the_extra")
def test_dicom_files_and_image_filters_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.dcm").write_bytes(b"")
    assert isocenter("geometry", "convert", "carm", tmp_path / "a.dcm", tmp_path / "a.csv") == 2
    assert "DICOM files need pydicom: pip install" in capsys.readouterr().err
    image = np.ones((16, 16), dtype=np.float32)
    for use in (lambda: edges_of(image, image), lambda: parallel_projections(image, np.zeros(1), 1e-3)):
        with pytest.raises(UnusableInputError, match="need scikit-image: pip install"):
            use()
