"""`isocenter bench` as the first thing that a user types."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from bench_page import START_S, until
from command_line import Isocenter


def test_bench_alone_opens_the_page_of_an_emulated_arm(tmp_path: Path) -> None:
    """The browser here is a script that writes down what it was asked to open, and opens it."""
    opened, browser = tmp_path / "opened", tmp_path / "browser"
    browser.write_text(f"#!/bin/sh\necho $1 > {opened}.part && mv {opened}.part {opened}\n")
    browser.chmod(0o700)
    environment = {**os.environ, "BROWSER": f"{browser} %s"}
    bench = subprocess.Popen(
        [sys.executable, "-m", "hil", "bench", "--port", "0", "--json", "ready.json"], cwd=tmp_path, env=environment, stdout=subprocess.PIPE
    )
    try:
        until(lambda: bench.poll() is not None or opened.is_file(), START_S)
        ready = json.loads((tmp_path / "ready.json").read_text())
        assert (ready["machine"], ready["bus"]) == ("carm", "lockstep:")
        assert opened.read_text().strip() == ready["address"]
        with urllib.request.build_opener(urllib.request.HTTPCookieProcessor()).open(ready["address"]) as page:
            assert "<title>Isocenter bench" in page.read().decode()
    finally:
        bench.send_signal(signal.SIGINT)
        said = bench.communicate(timeout=60.0)[0].decode()
    assert bench.returncode == 0
    assert "carm, EMULATED" in said


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        (("-b", "udp:"), "which machine is on this bus"),
        (("carm", "-m", "turntable"), "name one"),
        (("-m", "nosuch"), "nosuch"),
    ],
)
def test_bench_says_what_it_lacks(isocenter: Isocenter, tmp_path: Path, words: tuple[str, ...], wrong: str) -> None:
    told = isocenter("bench", *words, "-o", tmp_path / "out", "--no-open")
    assert told.status == 2
    assert wrong in told.line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("desktop", [True, False])
def test_the_page_opens_on_a_desktop_alone(isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, desktop: bool) -> None:
    """A browser in the terminal would take it from the bench, which is stopped there."""
    address = "http://127.0.0.1:1/enter?token=x"
    opened: list[str] = []
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    if desktop:
        monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("hil.console.serve.serve", lambda facts, folder, place, ready: ready(address))
    assert isocenter("bench", "-o", tmp_path / "out").status == 0
    assert opened == ([address] if desktop else [])
    for words in (("--no-open",), ("-m", "carm", "-b", "udp:")):
        assert isocenter("bench", *words, "-o", tmp_path / "out").status == 0
    assert opened == ([address] if desktop else [])
