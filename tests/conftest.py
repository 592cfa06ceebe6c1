"""What all tests share: small matrices on one thread, and which files are begun with."""

import gc
import os

import pytest
from browser import browser, console_errors, page  # noqa: F401
from command_line import Isocenter, runner
from compiled_once import compile_once

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")  # several workers' threads spinning against each other cost a hundredfold

LONGEST_FIRST = ("vcan", "diagnosis", "observers", "observing", "effects", "bench", "calibration", "concealed", "identification")
"""Folders in the order in which workers begin with them: what takes minutes in one test must not be left to the end, when the other
workers have nothing to do."""


SHARED = ("with_friction", "hard_design", "design", "machines")
"""Fixtures that take a quarter of a minute and serve several files: with `--dist loadgroup` one worker runs all files that ask for one."""


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config.option, "loadscopereorder"):  # files in their order, not those of many tests first
        config.option.loadscopereorder = False
    compile_once()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if item.get_closest_marker("nightly") is not None:
            item.add_marker(pytest.mark.slow)  # so that -m "not slow" leaves it out, too

    def place(item: pytest.Item) -> int:
        folder = item.path.parent.name
        return LONGEST_FIRST.index(folder) if folder in LONGEST_FIRST else len(LONGEST_FIRST)

    items.sort(key=place)
    if config.pluginmanager.hasplugin("xdist"):
        asked = {item.path: name for item in items for name in SHARED if name in getattr(item, "fixturenames", ())}
        for item in items:  # a file's tests are never apart: they share what is made once for the file
            item.add_marker(pytest.mark.xdist_group(asked.get(item.path, item.nodeid.partition("::")[0])))


def pytest_collection_finish() -> None:
    """What was imported stays: to look through it again for garbage takes a twentieth of the tests' time."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def isocenter(capsys: pytest.CaptureFixture[str]) -> Isocenter:
    """The command line, run in this process."""
    return runner(capsys)
