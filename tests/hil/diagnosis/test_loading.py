"""What a diagnosis loads before it begins: libraries that take as long as all others together are left out until something needs them."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.slow
def test_a_diagnosis_loads_no_library_of_controls_and_no_figures() -> None:
    loaded = "import sys, hil.diagnosis.diagnose, hil.emulated.machine; print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True).stdout
    assert not {"control", "matplotlib"} & set(said.split())
