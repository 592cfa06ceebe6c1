"""What watching costs the sample loop: whole tick and missed ticks with no client of `isocenter bench` and with ten, over UDP.

The emulated C-arm stands under control at 256 Hz, in short runs in pairs: one that nobody watches, and one with a headless browser on the
scope and nine WebSocket readers at full rate in one process of low priority. The order turns from pair to pair, so that what else the
computer does meets both alike. The bench's server runs in both, and all runs are started by it. A whole tick lasts from the SYNC until the
loop is ready to wait again. The machine file's limits of lost ticks are lifted, so that a stall of the host is counted.

    python benchmarks/bench_clients.py

Without Playwright and Chromium a tenth reader takes the browser's place, and the results say so.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import numpy as np

BUS = "udp:239.74.163.205"
ISOCENTER = [sys.executable, "-m", "hil"]
WITH, WITHOUT = "ten clients", "no client"
READERS = 9
SHARES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
HEADER = struct.Struct("<IIIId")
NICENESS = 10


class Entered(NamedTuple):
    """The page's address, and the session that the token in the printed one was exchanged for."""

    address: str
    cookie: str

    @property
    def headers(self) -> dict[str, str]:
        return {"Cookie": self.cookie}


def enter(printed: str) -> Entered:
    """Exchange the token."""
    parts = urlsplit(printed)
    line = http.client.HTTPConnection(parts.hostname, parts.port)
    line.request("GET", f"{parts.path}?{parts.query}")
    cookie = line.getresponse().headers["Set-Cookie"].split(";")[0]
    line.close()
    return Entered(f"{parts.scheme}://{parts.netloc}/", cookie)


def read_rows(page: Entered, readers: int) -> None:
    """Read rows at full rate on so many lines until standard input ends; print how many came and were lost."""
    from websockets.sync.client import connect

    os.nice(NICENESS)
    rows, lost = [0] * readers, [0] * readers

    def read(place: int) -> None:
        where, own = page.address.replace("http", "ws") + "rows", page.address.rstrip("/")
        with contextlib.suppress(Exception), connect(where, origin=own, additional_headers=page.headers) as line:
            for message in line:
                if isinstance(message, bytes):
                    _, count, _, lost[place], _ = HEADER.unpack(message[: HEADER.size])
                    rows[place] += count

    for place in range(readers):
        threading.Thread(target=read, args=(place,), daemon=True).start()
    print("reading", flush=True)
    sys.stdin.read()
    print(json.dumps({"rows": rows, "lost": lost}), flush=True)


@contextlib.contextmanager
def watched(page: Entered) -> Iterator[dict[str, object]]:
    """Ten clients for the length of the block; the answer is complete behind it."""
    found: dict[str, object] = {"browser": False}
    chromium = shutil.which("chromium")
    with contextlib.ExitStack() as stack:
        try:
            from playwright.sync_api import sync_playwright
        except ImportError:
            chromium = None
        if chromium:
            playwright = stack.enter_context(sync_playwright())
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-dev-shm-usage"])
            stack.callback(browser.close)
            opened = browser.new_page()
            name, _, value = page.cookie.partition("=")
            opened.context.add_cookies([{"name": name, "value": value, "url": page.address}])
            opened.goto(f"{page.address}#scope")
            found["browser"] = True
        words = [sys.executable, __file__, "--read", *page, str(READERS if chromium else READERS + 1)]
        reader = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert reader.stdout is not None and reader.stdout.readline(), "the readers did not start"
        yield found
        found |= json.loads(reader.communicate("")[0])


class Controller:
    """A client that starts runs and answers pings, of which none is a reader."""

    def __init__(self, page: Entered) -> None:
        from websockets.sync.client import connect

        self._page, self._address = page, page.address.rstrip("/")
        self._line = connect(page.address.replace("http", "ws") + "control", origin=self._address, additional_headers=page.headers)
        self._socket = self._line.__enter__()
        self._client = json.loads(self._socket.recv())["client"]
        self._work: dict[str, object] = {"state": "idle"}
        threading.Thread(target=self._answer, daemon=True).start()

    def _answer(self) -> None:
        """Answer pings, also while nothing runs, and keep the newest state of the work."""
        for text in self._socket:
            self._socket.send("here")
            self._work = json.loads(text)["work"]

    def run(self, seconds: float) -> dict[str, object]:
        """Run a recording at rest; return the state of the work at its end."""
        body = json.dumps({"kind": "static", "values": {"seconds": seconds}}).encode()
        headers = {"Content-Type": "application/json", "Origin": self._address, "X-Client": self._client, **self._page.headers}
        said = json.load(urllib.request.urlopen(urllib.request.Request(f"{self._address}/api/run", body, headers, method="POST")))
        assert not said, said
        while self._work["state"] != "running":
            time.sleep(0.05)
        while self._work["state"] == "running":
            time.sleep(0.2)
        return self._work

    def close(self) -> None:
        self._line.__exit__(None, None, None)


@contextlib.contextmanager
def process(ready: Path, *words: str) -> Iterator[dict[str, object]]:
    """A command of isocenter that says in a file when it is ready."""
    ready.unlink(missing_ok=True)
    running = subprocess.Popen([*ISOCENTER, *words, "--json", str(ready)], stdout=subprocess.DEVNULL)
    try:
        while not (ready.is_file() and ready.read_text().endswith("\n")):
            assert running.poll() is None, words
            time.sleep(0.1)
        yield json.loads(ready.read_text())
    finally:
        running.send_signal(signal.SIGINT)
        running.wait()


def one(how: str, controller: Controller, page: Entered, seconds: float, folder: Path) -> dict[str, object]:
    """Return timing and whole ticks [s] of one run."""
    from hil.recording import RecordingWarning, read_recording

    warnings.simplefilter("ignore", RecordingWarning)  # missed ticks are counted
    with watched(page) if how == WITH else contextlib.nullcontext({}) as clients:
        work = controller.run(seconds)
    answer = max(folder.glob("static-*.json"), key=lambda path: path.stat().st_mtime)
    said = json.loads(answer.read_text())
    whole = read_recording(said["recordings"][0]["recording"])["work_time"]
    timing = said["recordings"][0]["timing"]
    return {
        "scheduler": said["scheduler"],
        "missed": timing["missed"],
        "clients": clients,
        "whole_tick_s": whole[np.isfinite(whole)],
        **work,
    }


def percentiles(whole_tick_s: np.ndarray) -> dict[str, float]:
    """Of whole ticks, in microseconds."""
    return {f"{name}_us": round(float(np.percentile(whole_tick_s, share)) * 1e6, 1) for name, share in SHARES.items()}


def spread(values: list[float]) -> dict[str, float]:
    """The median, the smallest and the largest."""
    return {"median": round(float(np.median(values)), 3), "smallest": round(min(values), 3), "largest": round(max(values), 3)}


def measure(pairs: int, seconds: float, results: Path) -> None:
    """Run the pairs, and keep what is known after each."""
    from hil.machine import load_machine

    rows, ticks = [], {WITH: [], WITHOUT: []}
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        machine = folder / "carm.toml"
        machine.write_text(re.sub(r"(?m)^(overrun|stale)_ticks = \d+", r"\1_ticks = 10000", load_machine("carm").text), encoding="utf-8")
        stack.enter_context(process(folder / "emulator", "emulate", str(machine), "--bus", BUS))
        out = ["-o", str(folder / "out"), "--port", "0"]
        bench = stack.enter_context(process(folder / "bench", "bench", str(machine), "--bus", BUS, *out))
        page = enter(str(bench["address"]))
        controller = Controller(page)
        stack.callback(controller.close)
        for pair in range(pairs):
            row: dict[str, object] = {"load_average": Path("/proc/loadavg").read_text().strip()}
            for how in (WITH, WITHOUT) if pair % 2 == 0 else (WITHOUT, WITH):
                made = one(how, controller, page, seconds, folder / "out")
                ticks[how].append(made["whole_tick_s"])
                row[how] = {"ticks": len(made["whole_tick_s"]), "missed": made["missed"], **percentiles(made["whole_tick_s"])}
                if how == WITH:
                    row["clients"] = made["clients"]
            rows.append(row)
            print(json.dumps(row), flush=True)
            head = {"seconds": seconds, "scheduler": made["scheduler"], "processors": os.cpu_count()}
            results.write_text(json.dumps(head | summary(rows, ticks) | {"pairs": rows}, indent=1) + "\n", encoding="utf-8")


def summary(rows: list[dict], ticks: dict[str, list[np.ndarray]]) -> dict[str, object]:
    """All runs together, and what the pairs differ by."""
    together = {
        how: {
            "ticks": sum(map(len, ticks[how])),
            "missed": sum(row[how]["missed"] for row in rows),
            **percentiles(np.concatenate(ticks[how])),
        }
        for how in (WITH, WITHOUT)
    }
    added = {each: spread([row[WITH][f"{each}_us"] - row[WITHOUT][f"{each}_us"] for row in rows]) for each in SHARES}
    missed = spread([float(row[WITH]["missed"] - row[WITHOUT]["missed"]) for row in rows])
    return {"together": together, "added_us": added, "added_missed": missed}


def main() -> None:
    """Write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each run")
    parser.add_argument("--results", type=Path, default=Path(__file__).parent / "results" / "bench_clients.json")
    parser.add_argument("--read", nargs=3, metavar=("ADDRESS", "COOKIE", "READERS"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.read:
        read_rows(Entered(*arguments.read[:2]), int(arguments.read[2]))
    else:
        measure(arguments.pairs, arguments.seconds, arguments.results)


if __name__ == "__main__":
    main()
