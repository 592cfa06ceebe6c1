"""`isocenter bench` as a process of its own, and a client of its sockets."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

START_S = 90.0


class BenchPage:
    """A running bench: its address, its folder, and the session that the token in the printed address was exchanged for."""

    def __init__(self, printed: str, folder: Path, process: subprocess.Popen[str]) -> None:
        parts = urlsplit(printed)
        self.address, self.folder, self.process = f"{parts.scheme}://{parts.netloc}", folder, process
        line = http.client.HTTPConnection(parts.netloc)
        line.request("GET", f"{parts.path}?{parts.query}")
        self.cookie = line.getresponse().headers["Set-Cookie"].split(";")[0]
        line.close()

    @property
    def sockets(self) -> str:
        """Address of its WebSockets."""
        return self.address.replace("http://", "ws://")

    @property
    def server(self) -> int:
        """The server's process (Linux)."""
        for child in Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split():
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
        raise AssertionError("the server has no process")

    @property
    def server_bytes(self) -> int:
        """Memory that the server has (Linux)."""
        return 1024 * int(Path(f"/proc/{self.server}/status").read_text().split("VmRSS:")[1].split()[0])

    def post(self, path: str, what: dict[str, Any], client: str = "") -> tuple[int, str]:
        """Status and text of a request as the page makes it."""
        headers = {"Content-Type": "application/json", "Origin": self.address, "X-Client": client, "Cookie": self.cookie}
        request = urllib.request.Request(self.address + path, json.dumps(what).encode(), headers, method="POST")
        try:
            with urllib.request.urlopen(request, timeout=30.0) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as refused:
            return refused.code, refused.read().decode()


@contextlib.contextmanager
def bench_page(folder: Path, machine: str, bus: str, *options: str) -> Iterator[BenchPage]:
    """A bench on a free port, ended as by Ctrl-C."""
    ready, out = folder / "ready.json", folder / "recordings"
    command = [sys.executable, "-m", "hil", "bench", "-m", machine, "--bus", bus, "--port", "0", "-o", str(out), "--json", str(ready)]
    quiet = [] if "--live" in options else ["--no-live"]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [*command, "--no-open", *quiet, *options], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment
    )
    try:
        until(lambda: process.poll() is not None or (ready.is_file() and ready.read_text().endswith("\n")), START_S)
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        yield BenchPage(json.loads(ready.read_text())["address"], out, process)
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(60.0)
        except subprocess.TimeoutExpired:
            process.kill()
            raise


def until(is_so: Callable[[], object], seconds: float) -> None:
    """Wait until something is so; AssertionError where it does not become so."""
    give_up = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < give_up, f"waited for {seconds:g} s"
        time.sleep(0.02)


class Watcher:
    """A client of /control that answers pings, or does not."""

    def __init__(self, bench: BenchPage, client: str = "") -> None:
        from websockets.sync.client import connect

        own = {"Cookie": bench.cookie}
        self._line = connect(f"{bench.sockets}/control?client={client}", origin=bench.address, additional_headers=own)
        self._socket = self._line.__enter__()
        self.client = json.loads(self._socket.recv())["client"]

    def state(self, *, answers: bool = True) -> dict[str, Any]:
        """The next state."""
        while True:
            told: dict[str, Any] = json.loads(self._socket.recv(timeout=20.0))
            if answers:
                self._socket.send("here")
            if told["type"] == "state":
                return told

    def tell(self, text: str) -> None:
        """Send a message."""
        self._socket.send(text)

    def work(self, wanted: Callable[[dict[str, Any]], object], seconds: float, *, answers: bool = True) -> dict[str, Any]:
        """The state of the work, once it is as wanted."""
        give_up = time.monotonic() + seconds
        while True:
            work: dict[str, Any] = self.state(answers=answers)["work"]
            if wanted(work):
                return work
            assert time.monotonic() < give_up, work

    def close(self) -> None:
        """Leave."""
        self._line.__exit__(None, None, None)
