"""What a user waits for before anything happens: heavy libraries are not imported by commands that do not need them."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("asammdf", "can", "canopen", "control", "matplotlib", "numba", "pandas", "scipy")
IMPORTED = """
import sys
from hil.cli.app import main
try:
    main(sys.argv[1:])
except SystemExit as left:
    assert left.code in (0, None), left.code
print(",".join(name for name in {names!r} if name in sys.modules), file=sys.stderr)
"""


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (("--help",), (*HEAVY, "numpy", "pydantic", "rich.console", "multiprocessing")),
        (("run", "--help"), (*HEAVY, "numpy")),
        (("--version",), (*HEAVY, "numpy")),
        (("machine", "show", "carm"), HEAVY),
        (("machine", "show", "turntable", "--toml"), HEAVY),
    ],
    ids=" ".join,
)
def test_what_is_not_needed_is_not_imported(words: tuple[str, ...], names: tuple[str, ...]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", IMPORTED.format(names=names), *words], capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stdout
    assert done.stderr.strip().splitlines()[-1:] in ([], [""]), done.stderr
