"""What a user waits for before anything happens: heavy libraries are not imported by commands that do not need them."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

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


STANDARD_FILES = 60
"""Modules that `stop` may import beside those that Python's own start does: sockets, hashes, paths, dataclasses and what these need."""
OWN_FILES = 16
"""Of Isocenter itself: its command, its question, the bus's name, its folder, and errors of four packages."""
STOPPED = """
import sys
before = set(sys.modules)
from hil.cli import main
try:
    main(["stop", "--bus", "socketcan:vcan0"])
except SystemExit as left:
    print(left.code, *sorted(set(sys.modules) - before))
"""


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A folder whose name leaves room for a socket's: a Unix socket's path has 107 characters at most."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no Unix sockets here")
def test_a_stop_imports_the_standard_library_and_a_dozen_files_of_its_own(short_path: Path) -> None:
    """Where a bench runs, whose supervisor was killed: nothing is left out that a stop needs."""
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(short_path)}
    folder = short_path / f"isocenter-{os.getuid()}"
    folder.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as killed:
        killed.bind(str(folder / socket_name(environment)))
    done = subprocess.run([sys.executable, "-c", STOPPED], capture_output=True, text=True, timeout=60, check=True, env=environment)
    status, *imported = done.stdout.split()
    assert status == "1"
    assert "the supervisor does not answer" in done.stderr
    own = [name for name in imported if name.partition(".")[0] in ("hil", "drivers", "controllers", "virtual_bus")]
    foreign = [name for name in imported if name not in own and name.partition(".")[0] not in sys.stdlib_module_names]
    assert foreign == []
    assert len(own) <= OWN_FILES, own
    assert len(imported) - len(own) <= STANDARD_FILES, imported


def socket_name(environment: dict[str, str]) -> str:
    asked = "from hil.bench.asking import stop_socket; print(stop_socket('socketcan:vcan0').name)"
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, timeout=60, check=True, env=environment)
    return done.stdout.strip()
