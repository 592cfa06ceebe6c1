"""How long a page of `isocenter plot` takes to open: a minute at 256 Hz with 30 channels, every chart drawn.

python benchmarks/plot_opens.py [--repeats 7]

Headless Chromium opens the page from disk, a fresh browser context each time, 1400 px wide. Counted is the time from the start of the
navigation until the last chart is drawn and shown, by the browser's own clock; folded charts are opened first. A zoom is counted from the
press of the button until the frame after it, in which all charts show the new range.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from browser import chromium, listen

from hil.pages import write_page
from hil.recording import Channel, Recording, write_recording
from hil.reports.plot import Plotted, channels_of, plot_page

SECONDS, RATE_Hz, CHANNELS = 60.0, 256.0, 30
WITHIN_s = 1.0
PRESS = "() => { const begin = performance.now(); document.querySelector('[data-does=in]').click(); return begin; }"
FRAME = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(performance.now()))))"


def recording() -> Recording:
    """Channels of noise about waves: nothing that packs well, and an extreme in every column of pixels."""
    rng = np.random.default_rng(1)
    time = np.arange(round(SECONDS * RATE_Hz)) / RATE_Hz
    waves = {f"signal_{k:02d}": Channel("", np.sin((0.3 + 0.1 * k) * time) + 0.2 * rng.standard_normal(time.size)) for k in range(CHANNELS)}
    return Recording({"time": Channel("s", time), **waves}, {})


def main() -> None:
    """Measure and write benchmarks/results/plot_opens.json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    with tempfile.TemporaryDirectory() as folder:
        path, page = Path(folder) / "minute.mf4", Path(folder) / "minute.html"
        write_recording(recording(), path)
        plotted = [Plotted(path, recording())]
        write_page(plot_page(plotted, channels_of(plotted)), page)
        opened, zoomed, errors = [], [], []
        with chromium() as browser:
            for _ in range(repeats):
                context = browser.new_context(viewport={"width": 1400, "height": 900})
                tab = context.new_page()
                listen(tab, errors)
                tab.goto(page.as_uri())
                tab.wait_for_selector("html[data-drawn]", state="attached")
                assert tab.locator("figure.chart canvas").count() == CHANNELS
                opened.append(1e-3 * float(tab.evaluate("performance.getEntriesByName('drawn')[0].startTime")))
                begin = float(tab.evaluate(PRESS))
                zoomed.append(1e-3 * (float(tab.evaluate(FRAME)) - begin))
                context.close()
        result = {
            "seconds": SECONDS,
            "rate_Hz": RATE_Hz,
            "channels": CHANNELS,
            "page_MB": round(page.stat().st_size / 1e6, 2),
            "opens_s": {"median": round(statistics.median(opened), 3), "largest": round(max(opened), 3)},
            "zooms_s": {"median": round(statistics.median(zoomed), 3), "largest": round(max(zoomed), 3)},
            "repeats": repeats,
            "console_errors": len(errors),
        }
    out = Path(__file__).parent / "results" / "plot_opens.json"
    out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))
    if statistics.median(opened) > WITHIN_s or errors:
        sys.exit(f"opens in {statistics.median(opened):.2f} s, {WITHIN_s:g} s are asked for; {len(errors)} errors")


if __name__ == "__main__":
    main()
