"""The bus tests pass over a real SocketCAN vcan0: in place where this kernel has one, in a user-mode kernel elsewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from places import ROOT
from prepared import prepare_beside, run_in_lockstep
from user_mode_kernel import PACKAGES, Outcome, kernel_missing, run_in_user_mode_kernel, vcan_here

TOLD = "told.txt"
INSIDE = Path(__file__).parent / "inside"
TIMEOUT_S = 2400.0
DAILY, NIGHTLY = "vcan and not nightly", "vcan and nightly"


@pytest.mark.slow
def test_two_processes_over_vcan0(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, record_property: Callable[[str, object], None]) -> None:
    """Emulator and loop talk over vcan0, candump is the witness, slcan crosses a pty; nothing in there may be skipped.

    What no bus changes is shown in lockstep for every change, and over vcan0 at night.
    """
    monkeypatch.chdir(ROOT)
    over_vcan0(DAILY, tmp_path, record_property)


@pytest.mark.nightly
def test_what_lockstep_proves_holds_over_vcan0(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    """Answers byte for byte, and the observer in a multisine with jog and in a shaped scan.

    The most dangerous faults, one after the other, each with the time that a machine takes: a quarter of an hour.
    """
    monkeypatch.chdir(ROOT)
    over_vcan0(NIGHTLY, tmp_path, record_property)


def over_vcan0(marked: str, folder: Path, record_property: Callable[[str, object], None]) -> None:
    """Run the tests inside that are marked so, in place or in a user-mode kernel.

    What they need computed goes to the folder.
    """
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-m",
        marked,
        "-p",
        "no:cacheprovider",
        "-o",
        "addopts=",
        "-v",
        str(INSIDE),
    ]
    environment = {"ISOCENTER_VCAN": "vcan0", "PATH": os.environ["PATH"], "HOME": os.environ.get("HOME", "/root"), "LANG": "C.UTF-8"}
    environment["ISOCENTER_PREPARED"] = str(folder)
    environment["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # the tests inside use none
    handed = ("ISOCENTER_CACHE", "ISOCENTER_COMPILING")  # what is compiled once, outside; where CI notes what is compiled
    environment |= {name: os.environ[name] for name in handed if name in os.environ}
    here, kernel = vcan_here(), ""
    if here:
        kernel = kernel_missing()
        if kernel:
            line = (
                f"not proven: the stack over a real vcan0 ({here}; {kernel}). "
                f"To prove it: sudo apt-get install {PACKAGES}, then run the tests as root."
            )
            if os.environ.get("CI"):
                pytest.fail(line)
            pytest.skip(line)
    run_in_lockstep(folder)
    with ThreadPoolExecutor(1) as beside:
        preparing = beside.submit(prepare_beside if marked == NIGHTLY else lambda _: None, folder)
        if here:
            outcome = run_in_user_mode_kernel(command, environment, TIMEOUT_S)
        else:
            done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
            outcome = Outcome(done.returncode, done.stdout + done.stderr, "")
        preparing.result()
    where = "in a user-mode kernel" if here else "in place"
    assert outcome.status is not None, f"the user-mode kernel did not finish:\n{outcome.console}\n{outcome.output}"
    assert outcome.status == 0, f"bus tests over vcan0 ({where}):\n{outcome.output}"
    passed = re.search(r"(\d+) passed", outcome.output)
    assert passed, f"no bus test ran:\n{outcome.output}"
    assert int(passed[1]) > 0, f"no bus test ran:\n{outcome.output}"
    assert "skipped" not in outcome.output.splitlines()[-1], f"a bus test was skipped:\n{outcome.output}"
    told = folder / TOLD
    for line in told.read_text().splitlines() if told.exists() else ():
        record_property("over vcan0", f"{where}: {line}")
