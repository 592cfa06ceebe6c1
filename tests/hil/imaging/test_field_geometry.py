"""Angiographies of the kinds that people bring, which lie beside the repository."""

from __future__ import annotations

import numpy as np
import pytest
from places import DATA, needs_data

from hil.errors import UnusableInputError
from hil.imaging.exchange.dicom_file import read_xa

FIELD = DATA / "field" / "45-dicom-enhanced-xa"
pytestmark = needs_data("field", "inputs as people bring them are")


def test_enhanced_and_classic_objects_are_the_same_thirteen_exposures() -> None:
    pytest.importorskip("pydicom")
    classic, enhanced = (read_xa(FIELD / f"{name}.dcm") for name in ("classic", "enhanced"))
    assert len(classic.beam) == 13
    np.testing.assert_allclose(enhanced.beam.deviation_from(classic.beam), 0.0, atol=1e-9)
    assert enhanced.detector == classic.detector


def test_a_missing_distance_is_named() -> None:
    pytest.importorskip("pydicom")
    with pytest.raises(UnusableInputError, match="no DistanceSourceToPatient in this X-Ray Angiographic Image Storage"):
        read_xa(FIELD / "nodistance.dcm")
