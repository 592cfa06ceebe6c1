"""The concealed benchmark as a package, and its machines."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from concealed.truth.plant import Machine

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
pytest.importorskip("mujoco")


@pytest.fixture(scope="session")
def machines(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Machine]:
    """The benchmark's machines, their models exported by the command."""
    from concealed.making import Places, export_models
    from concealed.making import machines as exported

    places = Places(tmp_path_factory.mktemp("concealed"), "development")
    export_models(places)
    return exported(places.models)
