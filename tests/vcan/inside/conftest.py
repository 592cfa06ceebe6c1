"""Witnesses for the tests on vcan0: candump from can-utils, and the kernel's own slcan driver behind a pty."""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from at_rest import FRAMES, SHIPPED
from conversation import since_the_bench_came
from processes import Done, Started, start, start_until_ready
from witnesses import DEADLINE_S, POLL_S, START, Candump, SlcanAdapter

from hil.cli import main

PREPARED_S = 600.0
ON_ONE_PROCESSOR = ("--no-real-time",)


@pytest.fixture
def interface() -> str:
    """The SocketCAN interface under test."""
    return os.environ["ISOCENTER_VCAN"]


@pytest.fixture(scope="session")
def folder() -> Path:
    """Where `tests/vcan/prepared.py` puts its files, on the host."""
    return Path(os.environ["ISOCENTER_PREPARED"])


@pytest.fixture
def prepared(folder: Path) -> Path:
    """The folder, when its files are there."""
    ready = folder / "ready"
    deadline = time.monotonic() + PREPARED_S
    while not ready.exists():
        assert time.monotonic() < deadline, f"{ready} did not come"
        time.sleep(POLL_S)
    assert not ready.read_text(), ready.read_text()
    return folder


@pytest.fixture
def candump(tmp_path: Path) -> Iterator[Callable[[str], Candump]]:
    """Start candump on an interface; it is known to listen when this returns."""
    running: list[Candump] = []

    def start(interface: str) -> Candump:
        log = tmp_path / f"candump_{len(running)}.log"
        with log.open("wb") as output:
            process = subprocess.Popen(["candump", "-L", interface], stdout=output)
        witness = Candump(process, interface, log)
        running.append(witness)
        witness.wait_for(START)
        return witness

    yield start
    for witness in running:
        witness.process.kill()
        witness.process.wait(DEADLINE_S)


@pytest.fixture
def slcan_adapter() -> Iterator[SlcanAdapter]:
    """The kernel's slcan driver behind a pair of ptys. Needs the slcan module and root, as the user-mode kernel has."""
    laptop_master, laptop_slave = os.openpty()
    kernel_master, kernel_slave = os.openpty()
    for terminal in (laptop_slave, kernel_slave, laptop_master, kernel_master):
        with contextlib.suppress(OSError):
            tty.setraw(terminal)
    attach = subprocess.Popen(
        ["slcand", "-F", os.ttyname(kernel_slave), "slcan0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    stop_read, stop_write = os.pipe()

    def bridge() -> None:
        other = {laptop_master: kernel_master, kernel_master: laptop_master}
        while True:
            ready = select.select([laptop_master, kernel_master, stop_read], [], [])[0]
            if stop_read in ready:
                return
            for terminal in ready:
                with contextlib.suppress(OSError):
                    os.write(other[terminal], os.read(terminal, 4096))

    worker = threading.Thread(target=bridge, daemon=True)
    worker.start()
    try:
        for _ in range(int(DEADLINE_S / 0.05)):
            if subprocess.run(["ip", "link", "set", "slcan0", "up"], capture_output=True, check=False).returncode == 0:
                break
            select.select([], [], [], 0.05)
        else:
            pytest.fail(
                "slcan0 did not appear: " + (attach.stdout.read() if attach.stdout and attach.poll() is not None else "slcand is silent")
            )
        yield SlcanAdapter(os.ttyname(laptop_slave), "slcan0")
    finally:
        attach.terminate()
        os.write(stop_write, b"x")
        worker.join(DEADLINE_S)
        attach.wait(DEADLINE_S)
        for descriptor in (laptop_master, laptop_slave, kernel_master, kernel_slave, stop_read, stop_write):
            os.close(descriptor)


@pytest.fixture
def emulate(tmp_path: Path, loaded: None) -> Iterator[Callable[..., dict[str, str]]]:
    """Start `isocenter emulate` with these arguments; it is ready when this returns its ready line."""
    running: list[Started] = []

    def begin(*arguments: str) -> dict[str, str]:
        while running:
            running.pop().end()
        started, line = start_until_ready(tmp_path, "emulate", "--no-real-time", "--json", "-", *arguments)
        running.append(started)
        return json.loads(line)

    yield begin
    while running:
        running.pop().end()


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., Done]:
    """`isocenter run ...` to its end."""
    return lambda *arguments: start(tmp_path, "run", *arguments, *ON_ONE_PROCESSOR).wait()


@pytest.fixture(scope="session")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What processes are forked with: a tenth of a second in lockstep has loaded it."""
    out = str(tmp_path_factory.mktemp("lockstep") / "run.mf4")
    with pytest.raises(SystemExit) as left:
        main(["run", "static", "--seconds", "0.1", "-m", SHIPPED, "-b", "lockstep:", "-o", out])
    assert left.value.code == 0


@pytest.fixture(scope="session")
def lockstep_as_shipped(folder: Path) -> list[str]:
    """The frames of the shipped machine, at rest for a second in lockstep, at its own rate."""
    return since_the_bench_came([line.split()[2] for line in (folder / FRAMES).read_text().splitlines()])
